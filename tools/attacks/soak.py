"""Ask a service a great many things, good and bad, while all goes wrong around it; every answer is counted and judged.

Usage: tools/attack soak [--requests N] [--seconds S] [--clients C] [--workers W] [--seed K] [--patience P]
                  [--disk MIB] [--judge-memory]

Requests of all kinds, malformed ones among them, are spread over the time; five users ask them. In the first half
workers, and what renders recordings, are killed at random, clients that asked for large answers are stopped, the link
of one client is cut, and the disk fills up and is freed again. In the second half nothing of that happens, and memory
is judged: first each worker answers everything once while the others are stopped, then the rest of that half's first
fifth passes, and what each process grows after that is told. Right is an answer that equals the one of an engine in
this process (the path of a plan bit for bit, other numbers within rounding); a plan may also be cut short by its
time, if it says so, and whatever was asked while a worker was killed may be answered CRASH. What isn't answered
within the patience is wrong, and where the service's threads stand is shown. A run that isn't kept must be one whose
reply said so, and with a free disk every run is kept. No recording may be lost. Exit code 0: every request had
exactly one answer, none wrong, no run was lost, and memory grew by at most 2 % (judged in runs of ten minutes, or
where it is asked for). The disk is a small one in memory, which takes root; without that nothing fills up, and it is
said.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import psutil
import zenoh
from tests.journeys.links import Link

from attacks.isolation import asking_client
from guidefield import Client, GuidefieldError, NoService, ServerBusy, WorkerCrashed, answer
from guidefield.cli.demonstration import REQUESTS
from guidefield.cli.serving import TRACE_SIGNAL, ChildService, service_in_child
from guidefield.messages import codec
from guidefield.messages.values import Reply
from guidefield.planner.optimized_motion import HURRIED

LOWEST_PRIORITY = 19
RECORDINGS_FETCHED = 5
"""Number of recordings that are fetched for each user in the end."""
GROWTH = 0.02
JUDGED_FROM = 600.0
"""Memory is judged in runs that take at least so long [s], unless they are told to; shorter ones still warm up."""
WARMED_WITHIN = 60.0
"""Time within which workers are there again after the last kill, and for which others stand still [s]."""
CUT_EVERY = 3.0, 20.0
"""Between which times the link is cut, at random [s]."""
KILLED_AFTER = 20.0
"""After which time a worker is killed at the latest [s]."""
STARTS = 3.0
"""The same as a multiple of the time that the service took to start, where that is more."""
PULSE_S, STARVED_S, UNNOTICED_S = 0.1, 1.0, 20.0
"""Period at which this process looks if it gets the processor; a delay that excuses a lost link, and for how long."""
ROUNDING = 1e-9
TIME_IS_UP = b"Timeout"
"""Zenoh's own answer to a query that nobody answered within its time-out."""
USERS = tuple(f"user{number}" for number in range(5))
"""A client that asks for large answers, some MB each."""
POSE = {"position": [0.4, 0.0, 0.5], "quaternion_xyzw": [1, 0, 0, 0]}
BALL = {"name": "ball", "obstacles": [{"type": "sphere", "name": "s", "radius": 0.1}]}


@dataclass
class Case:
    """Something to ask, and what is right: a reply's bytes without what differs from run to run, or an error's name."""

    key: str
    payload: bytes | None
    right: object = None
    weight: int = 1


@dataclass
class Tally:
    """The outcomes of the requests.

    Attributes:
        answers: By what they were.
        wrong: What was wrong, in words.
        kills: When workers were killed, by `time.monotonic()` [s].
        full: From when until when the disk was full, by the same clock [s].
        kept: Runs that must be kept, with their users.
        unkept: How many replies said that their run isn't.
        stopped: How many clients were stopped.
        cuts: How often the link was cut.
        again: How many plans were answered over that link.
        starved: When this process got no processor for `STARVED_S`, by the same clock [s].
    """

    answers: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    kills: list[float] = field(default_factory=list)
    full: list[tuple[float, float]] = field(default_factory=list)
    kept: set[tuple[str, str]] = field(default_factory=set)
    unkept: int = 0
    stopped: int = 0
    cuts: int = 0
    again: int = 0
    starved: list[float] = field(default_factory=list)

    def was_full(self, begun: float) -> bool:
        """Return whether the disk was full since a time, or little before [s]."""
        return any(until > begun - 1.0 for _, until in self.full)


def cases() -> list[Case]:
    """All kinds of requests, with what an engine in this process answers."""
    asked = [
        ("kinematics", {"type": "potential", "scene": BALL, "points": [[0, 0, z] for z in range(1, 20)]}, 8),
        ("kinematics", {"type": "potential", "scene": "bookshelf", "robot": "panda", "configurations": [{}]}, 2),
        ("kinematics", {"type": "clearance", "robot": "panda", "scene": "bookshelf", "configurations": [{}] * 5}, 4),
        ("kinematics", {"type": "forward_kinematics", "robot": "ur5", "frames": ["tool0"], "configurations": [{}]}, 4),
        ("kinematics", {"type": "inverse_kinematics", "robot": "panda", "poses": [POSE], "solutions": 2}, 2),
        ("kinematics", {"type": "potential", "scene": "nowhere", "points": [[0, 0, 0]]}, 1),
        ("kinematics", {"type": "forward_kinematics", "robot": "r2d2", "frames": ["a"], "configurations": []}, 1),
        ("plan", {"robot": "panda", "scene": "bookshelf", "goal": {"type": "guide_plane"}, "tip": "nose"}, 1),
        *(("plan", msgspec.to_builtins(request), 2) for _, request in REQUESTS.values()),
    ]
    found = [Case(key, json.dumps(request).encode(), _right(request), weight) for key, request, weight in asked]
    malformed = [b"", b"{", b"\xff\xfe", b"[1, 2]", b'{"robot": "panda"}', b'{"speed": 1}', b"NaN", b"9" * 10_000]
    found += [Case(key, junk, "MALFORMED_REQUEST") for junk in malformed for key in ("plan", "kinematics")]
    found += [Case(key, None, "MALFORMED_REQUEST") for key in ("nothing", "runs/a/b/c", "robots?delete", "info?x=1")]
    found += [
        Case(key, None, None, 2) for key in ("info", "info?brief", "scenes", "scenes/bookshelf", "robots/panda", "runs")
    ]
    found += [Case(key, None, "INVALID_OBJECT_NAME") for key in ("runs/nowhere", "runs/nowhere/recording")]
    return found


def _right(request: dict[str, object]) -> object:
    try:
        return _lasting(json.loads(codec.encode(answer(request))))
    except GuidefieldError as error:
        return error.code.name


def _lasting(reply: dict[str, object] | Reply) -> object:
    """Keep what is the same in every run: of a plan its path, of anything else all."""
    return [reply["path"], reply["status"]["name"]] if "path" in reply else reply


def ask(session: zenoh.Session, user: str, case: Case, tally: Tally, service: ChildService, patience: float) -> None:
    """Ask once as a user, and judge what comes within a time [s]."""
    begun = time.monotonic()
    answers = list(
        session.get(
            f"guidefield/local/as/{user}/{case.key}",
            payload=case.payload,
            timeout=patience,
            consolidation=zenoh.ConsolidationMode.NONE,
        )
    )
    if not answers and any(starved >= begun - UNNOTICED_S for starved in tally.starved):
        time.sleep(1.0)  # the link is gone, and comes back
        ask(session, user, case, tally, service, patience)
        return
    is_late = len(answers) == 1 and answers[0].err is not None and answers[0].err.payload.to_bytes() == TIME_IS_UP
    if len(answers) != 1 or is_late:
        count = 0 if is_late else len(answers)
        tally.answers[f"{count} answers"] += 1
        _wrong(tally, f"{case.key} had {count} answers after {time.monotonic() - begun:.1f} s")
        service.process.send_signal(TRACE_SIGNAL)
        return
    reply = answers[0]
    body = json.loads((reply.ok or reply.err).payload.to_bytes())
    got = body["name"] if reply.ok is None else _lasting(body)
    outcome = body["status"]["name"] if "path" in body else got if reply.ok is None else "reply"
    tally.answers[str(outcome)] += 1
    excused = outcome == "CRASH" and any(killed >= begun - 1.0 for killed in tally.kills)
    excused |= outcome in ("TIMED_OUT", "SERVER_BUSY") or (outcome == "DISK_REFUSED" and tally.was_full(begun))
    excused |= "path" in body and cut_short(body)
    equal = got == case.right if case.key == "plan" else same(got, case.right)
    right = reply.ok is not None if case.right is None else equal
    if "path" in body:
        note_kept(tally, user, body, begun)
    if not right and not excused:
        _wrong(tally, f"{case.key} {case.payload!r:.200}: {str(body)[:300]}, not {str(case.right)[:200]}")


def cut_short(reply: dict[str, Any]) -> bool:
    """Return whether a plan says that its time was up before it was as good as it gets."""
    return HURRIED in reply["warnings"] or reply["status"]["name"] == "TIMED_OUT"


def note_kept(tally: Tally, user: str, reply: dict[str, Any], begun: float) -> None:
    """Note whether a run must be kept, by its reply: that tells where it isn't, which only a full disk excuses."""
    lost = [text for text in reply["warnings"] if "not kept" in text]
    if not lost:
        tally.kept.add((user, reply["run_id"]))
    elif lost:
        tally.unkept += 1
        if not tally.was_full(begun):
            _wrong(tally, f"run {reply['run_id']} of {user}, while the disk had room: {lost[0]}")


def _wrong(tally: Tally, what: str) -> None:
    tally.wrong.append(what)
    print(time.strftime("%H:%M:%S"), "wrong:", what, flush=True)


def same(a: object, b: object) -> bool:
    """Return whether two values are the same, numbers within `ROUNDING`: a search for a distance begins anywhere."""
    if isinstance(a, float) and isinstance(b, float):
        return abs(a - b) <= ROUNDING * max(1.0, abs(b))
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    return a == b


def processes(front: int) -> dict[int, int]:
    """Resident memory of the service's processes [KiB], without the one that renders recordings."""
    return {pid: memory for pid, (memory, renders) in every_process(front).items() if not renders}


def every_process(front: int) -> dict[int, tuple[int, bool]]:
    """Resident memory of each process of the service [KiB], and if it is the one at low priority, which renders."""
    found = {}
    for one in [psutil.Process(front), *psutil.Process(front).children()]:
        with contextlib.suppress(psutil.Error):  # it may end meanwhile
            if one.pid == front or any("spawn_main" in word for word in one.cmdline()):
                found[one.pid] = one.memory_info().rss // 1024, one.nice() == LOWEST_PRIORITY
    return found


def disturb(
    front: int,
    seconds: float,
    started_within: float,
    tally: Tally,
    rng: random.Random,
    over: threading.Event,
    warm_up: Callable[[], set[int]] | None,
) -> dict[int, list[int]]:
    """Kill workers in the first half of the time; have the others warm up, and watch memory in the second.

    Between two kills there is time for a worker to start, by how long the service took for that [s]: on a busy machine
    there would be none otherwise.
    """
    begin = time.monotonic()
    longest = max(min(KILLED_AFTER, 0.05 * seconds + 0.5), min(STARTS * started_within, seconds / 8))
    memory: dict[int, list[int]] = {}
    warmed: set[int] = set()
    while not over.is_set():
        passed = (time.monotonic() - begin) / seconds
        if passed < 0.5:
            over.wait(rng.uniform(0.2, longest))
            workers = [pid for pid in every_process(front) if pid != front]
            if workers and time.monotonic() - begin < 0.5 * seconds:
                tally.kills.append(time.monotonic())
                with contextlib.suppress(ProcessLookupError):
                    os.kill(rng.choice(workers), signal.SIGKILL)
                tally.kills.append(time.monotonic())
        else:
            if warm_up is not None and not warmed:
                warmed = warm_up()
            over.wait(max(0.5, seconds / 500))
            if passed > 0.6:
                for pid, kibibytes in processes(front).items():
                    memory.setdefault(pid, []).append(kibibytes)
    if warmed and memory and warmed != memory.keys():
        _wrong(tally, f"after the last kill there were processes {sorted(warmed)}, in the end {sorted(memory)}")
    return memory


def warm_up_workers(
    session: zenoh.Session, service: ChildService, workers: int, kinds: list[Case], tally: Tally, patience: float
) -> set[int]:
    """Have each worker answer everything once, while the others stand still; the service's processes.

    One of the users gets all its answers from the worker that runs: each of the others takes one request of one user.
    """
    front = service.process.pid
    until = time.monotonic() + WARMED_WITHIN
    while len(found := processes(front)) != 2 + workers and time.monotonic() < until:
        time.sleep(1.0)  # a worker is being replaced
    own = Tally(kills=tally.kills, full=tally.full, wrong=tally.wrong, kept=tally.kept)
    answered = [case for case in kinds if not isinstance(case.right, str)]

    def ask_all(user: str) -> None:
        for case in answered:
            ask(session, user, case, own, service, patience)

    each = found.keys() - {front}
    for worker in each:
        begun = time.monotonic()
        for other in each - {worker}:
            os.kill(other, signal.SIGSTOP)
        try:
            with ThreadPoolExecutor(len(USERS)) as threads:
                asked = [threads.submit(ask_all, user) for user in USERS]
                done = wait(asked, WARMED_WITHIN, FIRST_COMPLETED).done
                for other in each - {worker}:
                    os.kill(other, signal.SIGCONT)
        finally:
            for other in each - {worker}:
                os.kill(other, signal.SIGCONT)
        if not done:
            _wrong(tally, f"worker {worker} did not answer everything within {WARMED_WITHIN:g} s")
        print(f"worker {worker} is warm after {time.monotonic() - begun:.1f} s", flush=True)
    return set(found)


def fill(disk: Path, seconds: float, tally: Tally, over: threading.Event) -> None:
    """Fill a disk up for a while [s], and free it again."""
    ballast, begun = disk / "ballast", time.monotonic()
    tally.full.append((begun, float("inf")))
    with ballast.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(1 << 20))
    with ballast.open("ab", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(1 << 10))
    over.wait(seconds)
    ballast.unlink()
    tally.full[-1] = begun, time.monotonic()


def fill_at_times(disk: Path, seconds: float, tally: Tally, over: threading.Event) -> None:
    """Fill the disk up three times in the first half of the time."""
    for _ in range(3):
        if over.wait(0.12 * seconds):
            return
        fill(disk, 0.03 * seconds, tally, over)


def stop_clients(endpoint: str, seconds: float, tally: Tally, over: threading.Event) -> None:
    """In the first half of the time have clients ask for large answers, stop them, and end them later."""
    begin = time.monotonic()
    while not over.is_set() and time.monotonic() - begin < 0.5 * seconds:
        user = USERS[tally.stopped % len(USERS)]
        with asking_client(endpoint, user) as process:
            process.send_signal(signal.SIGSTOP)
            tally.stopped += 1
            over.wait(0.05 * seconds)


def plan_over_a_bad_link(
    endpoint: str, seconds: float, tally: Tally, rng: random.Random, over: threading.Event
) -> None:
    """In the first half of the time ask for plans over a link that is cut meanwhile; each must be answered once."""
    request, begin, link = REQUESTS["demo-guide-planes"][1], time.monotonic(), Link(endpoint)
    right, ended = _right(msgspec.to_builtins(request)), threading.Event()

    def cut_often() -> None:
        while not ended.wait(rng.uniform(*CUT_EVERY)):
            link.cut()
            tally.cuts += 1

    cutter = threading.Thread(target=cut_often, daemon=True)
    with Client.connect(link.endpoint, user=USERS[0], wait=60.0) as client:
        cutter.start()
        while not over.is_set() and time.monotonic() - begin < 0.5 * seconds:
            asked = time.monotonic()
            try:
                reply = client.plan(request)
            except (WorkerCrashed, ServerBusy, NoService) as error:
                excuses = tally.kills if isinstance(error, WorkerCrashed) else tally.starved
                if not any(excuse >= asked - 1.0 for excuse in excuses):
                    _wrong(tally, f"a plan over a link that was cut: {error}")
                continue
            tally.again += 1
            body = json.loads(codec.encode(reply))
            if not cut_short(body) and not same(_lasting(body), right):
                told = f"{reply.status}, {reply.warnings}, {reply.timing}"
                _wrong(tally, f"a plan over a link that was cut, after {time.monotonic() - asked:.1f} s: {told}")
            note_kept(tally, USERS[0], body, asked)
            over.wait(0.2)
        ended.set()
        cutter.join()
    link.close()


def feel_pulse(tally: Tally, over: threading.Event) -> None:
    """Note when this process gets no processor: then links, which it attends to, come back too late for clients."""
    due = time.monotonic() + PULSE_S
    while not over.wait(PULSE_S):
        if (now := time.monotonic()) - due > STARVED_S:
            tally.starved.append(now)
        due = now + PULSE_S


def growth(samples: list[int]) -> float:
    """Return the growth from the first tenth of samples to the last, as a share."""
    tenth = max(1, len(samples) // 10)
    return max(samples[-tenth:]) / max(samples[:tenth]) - 1.0


def run(arguments: list[str]) -> int:
    """Soak a service, and say how it went."""
    parser = argparse.ArgumentParser(prog="tools/attack soak", description=__doc__.partition("\n")[0])
    parser.add_argument("--requests", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--clients", type=int, default=8)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--patience", type=float, default=300.0, help="how long an answer may take [s]")
    parser.add_argument("--disk", type=int, default=1024, help="how large the disk is that fills up [MiB]")
    parser.add_argument("--judge-memory", action="store_true", help="in a run of less than ten minutes, too")
    options = parser.parse_args(arguments)
    options.judge_memory |= options.seconds >= JUDGED_FROM
    rng = random.Random(options.seed)  # noqa: S311 - no secret
    kinds = cases()
    order = rng.choices(kinds, [case.weight for case in kinds], k=options.requests)
    keep, begun = ("--keep-runs", str(100_000), "--keep-gib", "100"), time.monotonic()
    with (
        small_disk(options.disk) as disk,
        service_in_child(print, workers=options.workers, options=keep, within=disk) as service,
    ):
        tally, memory = soak(service, order, disk, time.monotonic() - begun, options)
    return report(tally, memory, options, service.process.returncode)


@contextlib.contextmanager
def small_disk(mebibytes: int) -> Iterator[Path | None]:
    """A disk of a size [MiB]; None where it can't be had, which is said."""
    with tempfile.TemporaryDirectory(prefix="guidefield-disk-") as folder:
        mount = ["mount", "-t", "tmpfs", "-o", f"size={mebibytes}m", "tmpfs", folder]
        if shutil.which("mount") is None or subprocess.run(mount, check=False, capture_output=True).returncode != 0:
            print("the disk isn't filled up: a small one can't be mounted here")
            yield None
            return
        try:
            yield Path(folder)
        finally:
            subprocess.run(["umount", folder], check=True)


def fetch_recording(client: Client, run_id: str, tally: Tally) -> bytes:
    """Fetch a recording, once more over a link that was lost where nothing got the processor."""
    begun = time.monotonic()
    try:
        return client.recording(run_id)
    except NoService:
        if not any(starved >= begun - UNNOTICED_S for starved in tally.starved):
            raise
    time.sleep(UNNOTICED_S)  # the link comes back
    return client.recording(run_id)


def require_kept(endpoint: str, tally: Tally) -> None:
    """Every run that must be kept is listed as ended, and no recording is lost."""
    for user in USERS:
        with Client.connect(endpoint, user=user, wait=60.0) as client:
            runs = client.runs().runs
            for run_id in [run.run_id for run in runs if run.recording in ("owed", "rendered")][:RECORDINGS_FETCHED]:
                if not fetch_recording(client, run_id, tally).startswith(b"RRF"):
                    _wrong(tally, f"the recording of run {run_id} of {user} is none")
        for run in runs:
            if run.recording == "lost":
                _wrong(tally, f"the recording of run {run.run_id} of {user} is lost")
        listed = {run.run_id: run.status for run in runs}
        lost = [
            run for owner, run in tally.kept if owner == user and listed.get(run) in (None, "RUNNING", "UNREADABLE")
        ]
        for run in lost:
            _wrong(tally, f"run {run} of {user} was answered and is {listed.get(run, 'lost')}")
        for run in (run for run, status in listed.items() if status == "RUNNING"):
            _wrong(tally, f"run {run} of {user} is told to be under way")


def soak(
    service: ChildService, order: list[Case], disk: Path | None, started_within: float, options: argparse.Namespace
) -> tuple[Tally, dict[int, list[int]]]:
    """Ask a service that took some time to start [s] in that order, spread over the time."""
    tally, over = Tally(), threading.Event()
    connect, scouting = {"endpoints": [service.endpoint]}, {"multicast": {"enabled": False}}
    config = zenoh.Config.from_json5(json.dumps({"mode": "client", "connect": connect, "scouting": scouting}))
    with zenoh.open(config) as session, ThreadPoolExecutor(options.clients + 5) as threads:
        rng = random.Random(options.seed)  # noqa: S311 - no secret
        others = [
            threads.submit(feel_pulse, tally, over),
            threads.submit(stop_clients, service.endpoint, options.seconds, tally, over),
            threads.submit(plan_over_a_bad_link, service.endpoint, options.seconds, tally, random.Random(1), over),  # noqa: S311
        ]
        if disk is not None:
            others.append(threads.submit(fill_at_times, disk, options.seconds, tally, over))
        kinds = list({(case.key, case.payload): case for case in order}.values())
        warming = partial(warm_up_workers, session, service, options.workers, kinds, tally, options.patience)
        watch = (rng, over, warming if options.judge_memory else None)
        disturbance = threads.submit(disturb, service.process.pid, options.seconds, started_within, tally, *watch)
        try:
            begin, asked = time.monotonic(), []
            for number, case in enumerate(order):
                ahead = begin + options.seconds * number / len(order) - time.monotonic()
                if ahead > 0.0:
                    time.sleep(ahead)
                asked.append(threads.submit(ask, session, rng.choice(USERS), case, tally, service, options.patience))
                if number % 500 == 499:
                    answered = sum(tally.answers.values())
                    print(f"{number + 1} asked, {answered} answered, {len(tally.wrong)} wrong", flush=True)
            for future in asked:
                future.result()
            time.sleep(max(0.0, begin + options.seconds - time.monotonic()))
        finally:  # the disturbance must end, or its thread is waited for without end
            over.set()
        for other in others:
            other.result()
        memory = disturbance.result()
        require_kept(service.endpoint, tally)
        return tally, memory


def report(tally: Tally, memory: dict[int, list[int]], options: argparse.Namespace, code: int) -> int:
    """Say how it went; the exit code."""
    answers = sum(tally.answers.values())
    print(f"\n{options.requests} requests, {answers} answers, {len(tally.wrong)} wrong, {len(tally.kills) // 2} kills")
    print(f"{tally.stopped} clients were stopped; a link was cut {tally.cuts} times, {tally.again} plans came over it;")
    print(f"the disk was full {len(tally.full)} times: {tally.unkept} replies said that their run isn't kept,")
    print(f"{len(tally.kept)} runs are kept; this process got no processor for a second {len(tally.starved)} times")
    for outcome, count in tally.answers.most_common():
        print(f"  {outcome:24s} {count}")
    grown = {pid: growth(samples) for pid, samples in memory.items() if len(samples) > 10}
    for pid, share in grown.items():
        history = ", ".join(str(memory[pid][len(memory[pid]) * part // 5] // 1024) for part in range(5))
        print(
            f"  process {pid}: {history}, {memory[pid][-1] // 1024} MiB; grown by {100 * share:.1f} % after warming up"
        )
    print(f"  the service ended with exit code {code}")
    heavy = options.judge_memory and any(share > GROWTH for share in grown.values())
    return int(answers != options.requests or bool(tally.wrong) or heavy or code != 0)
