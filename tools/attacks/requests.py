"""Mutate requests, URDFs and scenes, and have workers answer them: no crash, no hang, a reply or a named fault to each.

Usage: tools/attack requests [--examples N] [--seed K] [--workers W] [--seconds S] [--atheris]

The mutations are drawn by hypothesis: of the values of a request, of the elements and attributes of a URDF or SRDF, and
of the bytes of either. Each is answered by a worker process of the service's own pool, which a crash or a hang would
cost its life. With --atheris, what reads messages and URDFs is fuzzed in this process for some seconds, guided by its
coverage (pip install atheris). Exit code 0: nothing crashed, nothing hung, no FAILURE.
"""

from __future__ import annotations

import argparse
import base64
import copy
import json
import os
import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed as drawn_from, settings, strategies as st
from lxml import etree

from guidefield.engines import EngineSetup, Job
from guidefield.errors import GuidefieldError, WorkerCrashed
from guidefield.messages import keys
from guidefield.messages.codec import Encoding
from guidefield.pool.pool import Pool
from guidefield.pool.waiting import Task

HANG = 60.0
"""A worker that takes longer hangs [s]; what is asked takes tenths of a second."""

HERE = Path(__file__).resolve().parent
URDF, SRDF = ((HERE / name).read_text() for name in ("arm.urdf", "arm.srdf"))
"""An arm of joints of every kind, and all elements of an SRDF."""
SCENE = json.loads((HERE / "scene.json").read_text())
"""Obstacles of every kind, away from the arm."""
ARM = {"type": "urdf", "text": URDF, "root_joint": "fixed"}
POSE = {"position": [0.1, 0.0, 0.7], "quaternion_xyzw": [0, 0, 0, 1]}
QUICK = {"allowed_planning_time": 0.1, "seed": 1, "recording": "off", "robot": ARM, "scene": SCENE}
GIVEN = {"type": "certify", "robot": ARM, "scene": SCENE, "position_names": ["a", "b"], "allowed_time": 0.2,
         "recording": "off"}  # fmt: skip
REQUESTS = [
    ("plan", {**QUICK, "goal": {"type": "joints", "positions": {"a": 0.5}}, "start": {"b": 0.1}, "guide_planes": []}),
    ("plan", {**QUICK, "goal": {"type": "pose", **POSE, "position_tolerance": [1, 1, None]}, "tip": "tool"}),
    ("plan", {**QUICK, "goal": {"type": "guide_plane"}, "group": ["a", "b", "c"], "limits": {"a": {"velocity": 0.5}}}),
    ("certify", {**GIVEN, "path": [[0.0, 0.1], [0.2, -0.1]], "min_clearance": 0.01, "start": {"c": 0.1}}),
    ("certify", {**GIVEN, "trajectory": {"positions": [[0.0, 0.1], [0.2, 0.0], [0.1, 0.0]], "times": [0.0, 0.5, 1.0]}}),
    (
        "certify",
        {
            **GIVEN,
            "trajectory": {"positions": [[0.0, 0.1], [0.2, 0.0]], "velocities": [[0.0, 0.1], [0.2, 0.0]]},
            "time_step": 0.5,
            "velocity_names": ["b", "a"],
            "limits": {"a": {"jerk": 3.0}},
        },
    ),
    ("kinematics", {"type": "potential", "scene": SCENE, "points": [[0.0, 0.0, 0.5]]}),
    ("kinematics", {"type": "potential", "scene": SCENE, "robot": ARM, "configurations": [{"a": 0.1}]}),
    ("kinematics", {"type": "clearance", "robot": ARM, "scene": SCENE, "configurations": [{"a": 0.1}, {}]}),
    ("kinematics", {"type": "forward_kinematics", "robot": ARM, "frames": ["tool"], "configurations": [{"b": 1.0}]}),
    ("kinematics", {"type": "inverse_kinematics", "robot": ARM, "tip": "tool", "poses": [POSE], "solutions": 2}),
    ("scenes/all", SCENE),
    ("robots/arm", {"urdf": URDF, "meshes": {}}),
    ("robots/arm", {"urdf": URDF, "srdf": SRDF, "meshes": {}}),
    (
        "kinematics",
        {
            "type": "clearance",
            "robot": {**ARM, "srdf": SRDF, "root_joint": "planar"},
            "scene": SCENE,
            "configurations": [{}],
        },
    ),
]
WEIRD = [
    None, True, False, 0, -1, 1e308, -1e308, 1e-320, 2**53, 2**64, -(2**63), 0.1, "", "a", "\x00", "../../etc/passwd",
    "é" * 100, "x" * 10_000, [], {}, [[]], [None], {"": None}, [0] * 7, [1e9] * 3, {"type": "mesh"},
    {"type": "urdf_file"},
]  # fmt: skip
TEXTS = ["", "0", "-1", "1e400", "nan", "inf", "0 0 0", "1 1", "x", "\u0661", "9" * 400, "a", "base", "file:///etc/passwd",
         "package://../../etc/passwd", "fixed", "floating", "planar", "continuous", "universe", "root_joint", "f.x",
         "${x}", "0 0 1e200", "0 5e-324 0", "a b/c", "#J00000#"]  # fmt: skip
TAGS = ("link", "joint", "mesh", "box", "axis", "robot", "unknown", "Collision", "origin", "mimic", "limit", "group",
        "{http://ros.org/wiki/xacro}if", "{http://ros.org/wiki/xacro}grey")  # fmt: skip


def mutate(rng: random.Random, request: object) -> bytes:
    """A request with some of its values, of its URDF's elements, and of its bytes changed."""
    value, kind = copy.deepcopy(request), rng.choice(("urdf", "urdf", "numbers", "numbers", "values", "bytes", "all"))
    if kind in ("numbers", "all"):
        for _ in range(rng.choice((1, 1, 2, 5))):
            _change_number(rng, value)
    if kind in ("values", "all"):
        for _ in range(rng.choice((1, 1, 2))):
            value = _changed_value(rng, value)
    if kind in ("urdf", "all"):
        for holder, key in _urdfs(value):
            holder[key] = _changed_urdf(rng, holder[key])
    data = bytearray(json.dumps(value).encode())
    for _ in range(rng.choice((1, 1, 2, 5)) if kind in ("bytes", "all") else 0):
        at = rng.randrange(len(data) + 1)
        data[at : at + rng.randrange(4)] = rng.choice(
            (b"", b"\x00", b'"', b"{", b"]", b",", b"9" * 30, b"\xff", b"-", b"NaN", rng.randbytes(3))
        )
    return bytes(data)


def _change_number(rng: random.Random, value: object) -> None:
    """Another number, or another name, in the place of one: what can still be understood."""
    places = [place for place in _places(value) if isinstance(place[0][place[1]], int | float | None)]
    if places:
        holder, key = rng.choice(places)
        before = holder[key] or 0.0
        scaled = [before * factor for factor in (-1, 0, 1e-9, 1e-3, 3, 1e3, 1e9, 1.0000001)]
        holder[key] = rng.choice([*scaled, 0.0, 1, -1, 1e-12, 1e6, 1e150, 1e308, before + rng.gauss(0.0, 1.0)])


def _places(value: object) -> list[tuple[object, object]]:
    """Every container in a value, with each of its keys."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [place for key, part in inner for place in [(value, key), *_places(part)]]


def _changed_value(rng: random.Random, value: object) -> object:
    places = _places(value)
    if not places or rng.random() < 0.02:
        return rng.choice(WEIRD)
    holder, key = rng.choice(places)
    match rng.randrange(6):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, list):
            holder.insert(key, copy.deepcopy(holder[key]))
        case 1:
            holder["unknown"] = holder[key]
        case 2 if isinstance(holder[key], int | float):
            holder[key] *= rng.choice((-1, 0, 1e-9, 1e9, 1.0000001))
        case 3:
            holder[key] = copy.deepcopy(rng.choice(places)[0])
        case 4 if isinstance(holder, list):
            rng.shuffle(holder)
        case _:
            holder[key] = copy.deepcopy(rng.choice(WEIRD))
    return value


def _urdfs(value: object) -> list[tuple[object, object]]:
    return [
        (holder, key)
        for holder, key in _places(value)
        if key in ("text", "urdf", "srdf") and isinstance(holder[key], str) and holder[key].startswith("<")
    ]


def _changed_urdf(rng: random.Random, text: str) -> str:
    root = etree.fromstring(text)
    for _ in range(rng.choice((1, 1, 2, 4))):
        element = rng.choice(list(root.iter()))
        parent = element.getparent()
        match rng.randrange(6):
            case 0 if parent is not None:
                parent.remove(element)
            case 1 if parent is not None:
                parent.append(copy.deepcopy(element))
            case 2:
                element.append(copy.deepcopy(rng.choice(list(root.iter()))))
            case 3:
                element.tag = rng.choice(TAGS)
            case _ if element.attrib:
                name = rng.choice(list(element.attrib))
                if rng.random() < 0.2:
                    del element.attrib[name]
                else:
                    element.attrib[name] = rng.choice([t for t in TEXTS if "\x00" not in t])
    return etree.tostring(root, encoding="unicode")


class Found(Exception):
    """A fault that is not named, with what to ask to see it again."""


class Judge:
    """Has requests answered by workers, and keeps what is not a reply or a named fault."""

    def __init__(self, workers: int, data: Path) -> None:
        self.counts: Counter[str] = Counter()
        self.found: list[str] = []
        self._pool = Pool(EngineSetup(data, "fuzz", 60), workers=workers)
        self._pool.start()
        while not self._pool.ready(1.0):
            pass
        self._asked: list[tuple[str, bytes, Task]] = []

    def ask(self, key: str, payload: bytes) -> None:
        """Ask; answers are judged some requests later, so that all workers are busy."""
        query = keys.Query(tuple(key.split("/")), {}, payload, Encoding.JSON)
        task = self._pool.submit(Task(Job(query, time.monotonic()), HANG))
        self._asked.append((key, payload, task))
        if len(self._asked) >= 32:
            self._settle(self._asked.pop(0))

    def close(self) -> None:
        """Judge the rest."""
        while self._asked:
            self._settle(self._asked.pop(0))
        self._pool.close(0.0)

    def _settle(self, asked: tuple[str, bytes, Task]) -> None:
        key, payload, task = asked
        try:
            is_reply, body = task.result()
            answer = json.loads(body)
            name = answer.get("status", {}).get("name", "reply") if is_reply else answer["name"]
            message = answer.get("message", "")
        except WorkerCrashed as crash:
            name, message = "CRASH", crash.message
        self.counts[name] += 1
        if name in ("FAILURE", "CRASH"):
            self.found.append(f"{name} at {key}: {message}\n    {base64.b64encode(payload).decode()[:4000]}")


def by_hypothesis(judge: Judge, examples: int, seconds: float, drawn: int | None) -> None:
    """Ask mutated requests; from a number the same ones every time."""
    end = time.monotonic() + seconds
    begun = time.monotonic()

    @settings(
        max_examples=examples,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(st.integers(0, 2**64), st.sampled_from(REQUESTS))
    def fuzz(seed: int, asked: tuple[str, object]) -> None:
        if time.monotonic() > end:
            return
        key, request = asked
        judge.ask(key, mutate(random.Random(seed), request))  # noqa: S311 - no secret
        total = judge.counts.total()
        if total % 5000 == 4999:
            print(f"{total} answered in {time.monotonic() - begun:.0f} s, {len(judge.found)} faults", flush=True)

    (fuzz if drawn is None else drawn_from(drawn)(fuzz))()


def by_atheris(seconds: float) -> None:
    """Fuzz what reads messages and URDFs, guided by its coverage; does not return."""
    import atheris

    with atheris.instrument_imports(include=["guidefield.messages", "guidefield.robot"]):
        from guidefield.messages import codec, requests, scene
        from guidefield.robot.urdf import meshes, urdf_validation

    resolver = meshes.MeshResolver.for_wire()

    def one(data: bytes) -> None:
        kind, payload = data[:1], data[1:]
        try:
            if kind < b"\x40":
                codec.decode(payload, requests.PlanRequest)
            elif kind < b"\x80":
                codec.decode(payload, requests.TaggedRequest, Encoding.MSGPACK)
            elif kind < b"\xc0":
                codec.decode(payload, scene.Scene)
            else:
                urdf_validation.check_urdf(payload.decode(errors="replace"), resolver)
        except GuidefieldError:
            pass

    with tempfile.TemporaryDirectory() as corpus:
        for number, (_, request) in enumerate(REQUESTS):
            (Path(corpus) / str(number)).write_bytes(b"\x00" + json.dumps(request).encode())
        (Path(corpus) / "scene").write_bytes(b"\x80" + json.dumps(SCENE).encode())
        (Path(corpus) / "urdf").write_bytes(b"\xff" + URDF.encode())
        atheris.Setup([sys.argv[0], corpus, f"-max_total_time={int(seconds)}", "-rss_limit_mb=8000"], one)
        atheris.Fuzz()


def run(arguments: list[str]) -> int:
    """Fuzz, and say what came of it."""
    parser = argparse.ArgumentParser(prog="tools/attack requests", description=__doc__.partition("\n")[0])
    parser.add_argument("--examples", type=int, default=100_000)
    parser.add_argument("--seed", type=int, help="asks the same requests every time")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seconds", type=float, default=7200.0, help="at most so long")
    parser.add_argument("--atheris", action="store_true")
    options = parser.parse_args(arguments)
    if options.atheris:
        by_atheris(options.seconds)
    with tempfile.TemporaryDirectory(prefix="guidefield-fuzz-") as data:
        judge = Judge(options.workers, Path(data))
        by_hypothesis(judge, options.examples, options.seconds, options.seed)
        judge.close()
    print(f"\n{judge.counts.total()} requests, each answered; {len(judge.found)} crashed, hung or failed")
    for name, count in judge.counts.most_common():
        print(f"  {name:32s} {count}")
    for found in judge.found[:20]:
        print(found)
    return int(bool(judge.found))
