"""Whole answers through the public doors, by the clock: plans, refusals, over the wire, first answers, many answers.

Usage: tools/bench whole [<folder>] [--robots panda,ur5,fetch,baxter] [--every N] [--repeats N] [--cpu]
       [--only plans,requests,refusals,wire,first,batch]

The folder is described in problems.py; without it the rows about the public problems are left out. Each request is
answered once before it is measured, by `guidefield.answer` or `Client.plan`; a row has the median over the requests of
the best of N repetitions, and the 95th percentile. Columns are the stages of a reply's `timing`; *unaccounted* is what
the clock says beyond their sum, in percent of the whole. With --cpu it is the CPU time of this process that counts, for
a machine with other work: the stages, always by the clock, don't add up to it then.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from benchmarks.problems import Problems, problems_parser, public_requests
from guidefield import Box, Client, JointsGoal, PlanRequest, PoseGoal, Scene, answer
from guidefield.cli.serving import service_in_child
from guidefield.messages import codec

STAGES = ("load", "ends", "guide", "connect", "relax", "parameterize", "certify", "measure")
REQUESTS = Path(__file__).parents[1] / "examples" / "requests"
SECONDS = 30.0
"""Budget of one plan."""

WIRE_REPEATS = 30
WRITTEN = 0.3
"""A recording is written by then [s]."""

_FIRST_ANSWER = """
import sys, time
began = time.perf_counter()
import guidefield
reply = guidefield.answer(sys.stdin.buffer.read())
print(reply.status.name, time.perf_counter() - began, time.process_time())
"""


@dataclass(frozen=True)
class Answer:
    """One request's answer: how it ended, and the times of the best repetition [s]."""

    name: str
    status: str
    whole: float
    stages: dict[str, float]

    @property
    def unaccounted(self) -> float:
        """Share of the whole that no stage accounts for."""
        return 1.0 - sum(self.stages.values()) / self.whole


def run(arguments: list[str]) -> None:
    """Print a table for each subject."""
    parts: dict[str, Callable[[argparse.Namespace], None]] = {
        "plans": _plans,
        "requests": _requests,
        "refusals": _refusals,
        "wire": _wire,
        "first": _first,
        "batch": _batch,
    }
    parser = problems_parser("whole", __doc__, every=10, nargs="?")
    parser.add_argument("--repeats", type=int, default=3, help="how often each is answered; the best counts")
    parser.add_argument("--cpu", action="store_true", help="the CPU time of this process, not the clock")
    parser.add_argument("--only", default=",".join(parts), help="which tables, between commas")
    options = parser.parse_args(arguments)
    print(f"load of the machine: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores; times in ms unless said otherwise")
    for name in options.only.split(","):
        parts[name](options)


def _plans(options: argparse.Namespace) -> None:
    """The public problems, robot by robot: joint goals, pose goals, and the plainest answer."""
    for robot in options.robots.split(",") if options.folder else ():
        joints, poses = public_requests(Problems.load(options.folder, robot, options.every))
        plain = [msgspec.structs.replace(request, optimization_iterations=0) for request in joints]
        for title, requests in (("joint goals", joints), ("pose goals", poses), ("nothing optimised", plain)):
            answers = [_best(request.run_id or "", _anonymous(request), options) for request in requests]
            _print(f"{robot}, {title}", answers)


def _requests(options: argparse.Namespace) -> None:
    """The example requests that are in files: the thesis' scenes, the door, the conveyor."""
    answers = []
    for path in sorted(REQUESTS.glob("*.json")):
        request = json.loads(path.read_bytes())
        request = {**request, "recording": "off", "allowed_planning_time": SECONDS}
        answers.append(_best(path.stem, codec.decode_request(request), options))
    for one in answers:
        _print(one.name, [one])
    _print("thesis' scenes", [one for one in answers if one.name.startswith("seed_")])


def _refusals(options: argparse.Namespace) -> None:
    for name, request in refused_requests().items():
        _print(name, [_best(name, request, options)])


def _wire(_options: argparse.Namespace) -> None:
    """The same plan and the same refusal over a service on loopback, without a recording, with one, and right after it.

    Before the first two the service has time to write what it owes.
    """
    refusals = refused_requests()
    plan = PlanRequest("panda", "bookshelf", JointsGoal({"panda_joint1": 0.8}), guide_planes=[], recording="off")
    with service_in_child(lambda _: None) as service, Client.connect(service.endpoint, wait=20.0) as client:
        for name, request in {"a plan": plan, "goal in collision": refusals["goal in collision"]}.items():
            without, recorded = request, msgspec.structs.replace(request, recording="full")
            turns = (("off", without, WRITTEN), ("full", recorded, WRITTEN), ("off, right after one", without, 0.0))
            times: dict[str, list[float]] = {recording: [] for recording, *_ in turns}
            for _ in range(WIRE_REPEATS + 3):
                for recording, asked, pause in turns:
                    time.sleep(pause)
                    times[recording].append(_seconds(lambda asked=asked: client.plan(asked))[0])
            for recording, found in times.items():
                p50, p95 = np.quantile(1e3 * np.array(found[3:]), (0.5, 0.95))
                print(f"over the wire, {name}, recording {recording}: {p50:.1f} / {p95:.1f}")


def _first(options: argparse.Namespace) -> None:
    """From import to the first answer, in processes of their own; the kernels compiled and the robots known before."""
    # as whoever installs it has it: with the sources as Python's byte code
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    rows = {"panda": PlanRequest("panda", "bookshelf", JointsGoal({"panda_joint1": 0.8}), recording="off")}
    rows["ur5"] = PlanRequest("ur5", "table", JointsGoal({"elbow_joint": 1.2}), guide_planes=[], recording="off")
    for name, request in rows.items():
        asked, clock, cpu = codec.encode(request), [], []
        for _ in range(options.repeats + 1):
            command = [sys.executable, "-c", _FIRST_ANSWER]
            ended = subprocess.run(command, input=asked, capture_output=True, check=True, env=environment)
            status, seconds, used = ended.stdout.decode().split()
            clock.append(float(seconds))
            cpu.append(float(used))
        print(f"import to first answer, {name} ({status}): {min(clock):.2f} s, CPU {min(cpu):.2f} s")


def _batch(options: argparse.Namespace) -> None:
    """`guidefield batch` over the public Panda problems, on two workers: plans a second once the workers are ready."""
    if not options.folder:
        return
    requests = public_requests(Problems.load(options.folder, "panda"))[0]
    with tempfile.TemporaryDirectory() as folder:
        given = Path(folder) / "requests.jsonl"
        lines = [codec.encode(_anonymous(request)) for request in requests]
        seconds = []
        for count in (len(lines) // 4, len(lines)):
            given.write_bytes(b"\n".join(lines[:count]) + b"\n")
            results = ["--output", str(Path(folder) / str(count)), "--workers", "2", "--no-recordings"]
            begin = time.perf_counter()
            subprocess.run(
                [sys.executable, "-m", "guidefield", "batch", str(given), *results],
                stdout=subprocess.DEVNULL,
                check=True,
            )
            seconds.append(time.perf_counter() - begin)
        rate = (len(lines) - len(lines) // 4) / (seconds[1] - seconds[0])
        print(
            f"guidefield batch, {len(lines)} Panda problems, 2 workers: {rate:.0f} plans/s, {seconds[1]:.1f} s in all"
        )


def refused_requests() -> dict[str, PlanRequest]:
    """Questions that have a plain no for an answer."""
    on_the_arm = Scene("block", obstacles=[Box(name="block", size=(0.3, 0.3, 0.3), position=(0.0, 0.45, 0.5))])
    at_rest = Scene("block", obstacles=[Box(name="block", size=(0.3, 0.3, 0.3), position=(0.45, 0.0, 0.5))])
    clear = Scene("clear", obstacles=[Box(name="block", size=(0.1, 0.1, 0.1), position=(0.0, -0.9, 0.1))])
    sideways = JointsGoal({"panda_joint1": 1.5708})
    far = PoseGoal(position=(3.0, 0.0, 0.5), quaternion_xyzw=(1.0, 0.0, 0.0, 0.0))

    def request(scene: Scene, goal: JointsGoal | PoseGoal) -> PlanRequest:
        return PlanRequest("panda", scene, goal, guide_planes=[], recording="off")

    return {
        "goal in collision": request(on_the_arm, sideways),
        "start in collision": request(at_rest, sideways),
        "goal beyond limits": request(clear, JointsGoal({"panda_joint1": 9.0})),
        "goal out of reach": request(clear, far),
    }


def _anonymous(request: PlanRequest) -> PlanRequest:
    return msgspec.structs.replace(request, run_id=None, allowed_planning_time=SECONDS)


def _best(name: str, request: Any, options: argparse.Namespace) -> Answer:
    """The quickest of some answers to a request, after one that isn't counted."""
    answer(request)
    found = []
    for _ in range(options.repeats):
        seconds, reply = _seconds(lambda: answer(request), options.cpu)
        stages = {stage: getattr(reply.timing, stage) for stage in STAGES}
        found.append(Answer(name, reply.status.name, seconds, stages))
    return min(found, key=lambda one: one.whole)


def _seconds(call: Callable[[], Any], cpu: bool = False) -> tuple[float, Any]:
    clock = time.process_time if cpu else time.perf_counter
    begin = clock()
    result = call()
    return clock() - begin, result


def _print(title: str, answers: list[Answer]) -> None:
    """One line: whole answers, then each stage, medians; how many succeeded."""
    whole = 1e3 * np.array([one.whole for one in answers])
    stages = [f"{stage} {1e3 * statistics.median(one.stages[stage] for one in answers):.1f}" for stage in STAGES]
    unaccounted = 100.0 * statistics.median(one.unaccounted for one in answers)
    counts = {status: sum(one.status == status for one in answers) for status in {one.status for one in answers}}
    ended = ", ".join(f"{count} {status}" for status, count in sorted(counts.items()))
    print(
        f"{title} ({ended}): whole {np.median(whole):.1f} / {np.quantile(whole, 0.95):.1f}; {', '.join(stages)};"
        f" unaccounted {unaccounted:.1f} %",
        flush=True,
    )
