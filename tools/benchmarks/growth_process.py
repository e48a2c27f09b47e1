"""The cost of one number of something in a process that has done nothing else: its times and its memory."""

from __future__ import annotations

import gc
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from tests.robots import box_arm

import guidefield
from benchmarks import grown
from benchmarks.grown import PANDA, SEED, TURNED, Made
from guidefield.batch import ItemAnswer, RequestFile, Results
from guidefield.messages import codec
from guidefield.messages.scene import Box, HalfSpace, Scene
from guidefield.messages.streams import Observation, Piece, StreamObstacle, StreamOpen, StreamUpdate
from guidefield.messages.values import JointsGoal, Placement
from guidefield.robot.catalog import Catalog
from guidefield.scene.scene import build
from guidefield.stream.stream import CertifiedStream

WARMED = 5
"""A size that is answered twice before, so that kernels are loaded."""
REPEATS = 3
ROWS = 3000
"""Numbers in a batch's answers: 15 KB each."""

Costs = tuple[float, float]
"""Processor time of the first time and of the next one [s]."""


def measure_answers(made: Callable[[int, int], Made], warmed: int = WARMED) -> Callable[[int], Costs]:
    """Return what measures answers: in a scene that was never seen, and again."""

    def measure(size: int) -> Costs:
        request = codec.decode_request(made(size, SEED))
        return time_of(request), min(time_of(request) for _ in range(REPEATS))

    def time_of(request: Any) -> float:
        began = time.process_time()
        guidefield.answer(request)
        return time.process_time() - began

    for draw in range(2):
        time_of(codec.decode_request(made(warmed, draw)))
    return measure


def configurations(count: int, draw: int) -> Made:
    turned = [{**PANDA, "panda_joint1": 0.001 * ((k + draw) % 1000)} for k in range(count)]
    return {"type": "clearance", "robot": "panda", "scene": "bookshelf", "configurations": turned}


def goals(count: int, draw: int) -> Made:
    places = [{**TURNED, "panda_joint1": 0.9 + 0.0001 * k, "panda_joint7": 0.001 * draw} for k in range(count)]
    return {**grown.plan(grown.boxes(10, draw)), "goal": {"type": "joint_set", "positions": places}}


def held(count: int, draw: int) -> Made:
    """A stack of thin sheets in the hand."""
    sheets = [
        {
            "obstacle": {"type": "box", "name": f"sheet{k}", "size": [0.03, 0.03, 0.001]},
            "link": "panda_hand",
            "placement": {"position": [0.0, 0.0, 0.12 + 0.0015 * k]},
            "touch_links": ["panda_leftfinger", "panda_rightfinger"],
        }
        for k in range(count)
    ]
    return {**grown.plan(grown.boxes(10, draw)), "attached_objects": sheets}


def joints(count: int, draw: int) -> Made:
    """An arm of boxes, 4 m long, that bends a little; another draw is another arm."""
    arm = box_arm(" ".join("xy"[k % 2] for k in range(count)), count, (4.0 + 0.1 * draw) / (count + 1))
    far = [{"type": "box", "name": "far", "size": [0.1, 0.1, 0.1], "position": [9.0, 0.0, 0.0]}]
    bent = {f"j{k}": 0.3 / count for k in range(1, count + 1)}
    robot = {"type": "urdf", "text": arm.text}
    return {**grown.plan(far), "robot": robot, "start": {}, "goal": {"type": "joints", "positions": bent}}


def batch_results(count: int) -> Costs:
    """Write so many answers of a batch, then find that it is finished."""
    reply = b'{"status":{"code":1,"name":"SUCCESS"},"path":[' + b"0.5," * ROWS + b"0.5]}"
    with tempfile.TemporaryDirectory(prefix="guidefield-") as name:
        folder, times = Path(name), []
        file = folder / "requests.jsonl"
        with file.open("wb") as written:
            written.writelines(b'{"robot":"panda","number":%d}\n' % k for k in range(count))
        for _ in range(2):
            began = time.process_time()
            with RequestFile(file) as requests, Results(folder, requests) as results:
                for item in requests.items(folder, recordings=False):
                    if not results.has(item):
                        results.add(ItemAnswer(item, True, reply))
            times.append(time.process_time() - began)
    return times[0], times[1]


def stream_cycles(count: int) -> Costs:
    """Run a stream of a Panda to and fro among three boxes that sway for so many cycles, 50 a second."""
    names = [f"box{k}" for k in range(3)]
    places, sways = np.array([[0.8, 0.3 * k, 0.4 + 0.2 * k] for k in (-1, 0, 1)]), 0.1 * np.eye(3)
    goals = [JointsGoal({**PANDA, "panda_joint1": turn}) for turn in (1.0, -1.0)]
    obstacles = [StreamObstacle(Box(name=name, size=(0.1, 0.1, 0.1)), 0.5) for name in names]
    floor = build(Scene("floor", obstacles=[HalfSpace(name="floor", normal=(0.0, 0.0, 1.0), offset=-0.05)]))
    request = StreamOpen("panda", "floor", goal=goals[0], start=goals[1].positions, obstacles=obstacles)
    times, turns = [], 0
    with CertifiedStream(request, Catalog().load("panda"), floor) as stream:
        gc.collect()
        gc.freeze()  # as a service does
        for now in (0.02 * np.arange(count)).tolist():
            moved, rates = (places + np.sin(now) * sways).tolist(), (np.cos(now) * sways).tolist()
            observed = [
                Observation(name, now, Placement(tuple(at)), tuple(rate))
                for name, at, rate in zip(names, moved, rates, strict=True)
            ]
            positions = stream.executing.state(now)[:, 0].tolist()
            joints = dict(zip(stream.group.position_names, positions, strict=True))
            began = time.thread_time()
            reply = stream.update(StreamUpdate(now, observed, joints))
            times.append(time.thread_time() - began)
            if not isinstance(reply, Piece) and reply.reason == "at_goal" and now >= reply.stops:
                turns += 1
                stream.aim_for(goals[turns % 2])
    return sum(times), 4.0 * sum(times[-count // 4 :])


SUBJECTS: dict[str, Callable[[], Callable[[int], Costs]]] = {
    "boxes": lambda: measure_answers(lambda size, draw: grown.plan(grown.boxes(size, draw))),
    "polygons": lambda: measure_answers(lambda size, draw: grown.plan(grown.polygons(size, draw))),
    "triangles": lambda: measure_answers(lambda size, draw: grown.plan(grown.terrain(size, draw))),
    "points": lambda: measure_answers(lambda size, draw: grown.plan(grown.cloud(size, draw))),
    "movers": lambda: measure_answers(lambda size, draw: grown.plan(grown.movers(size, draw))),
    "crossed": lambda: measure_answers(lambda size, draw: grown.plan(grown.crossed(size, draw))),
    "configurations": lambda: measure_answers(configurations),
    "waypoints": lambda: measure_answers(grown.judgement),
    "goals": lambda: measure_answers(goals),
    "steps": lambda: measure_answers(grown.steps),
    "links": lambda: measure_answers(grown.chain, min(grown.CHAINS)),
    "joints": lambda: measure_answers(joints),
    "held": lambda: measure_answers(held),
    "results": lambda: batch_results,
    "cycles": lambda: stream_cycles,
}
"""Subjects that are measured in a process, by name."""


def main() -> None:
    """Print what the subject and the size of the arguments cost, as JSON."""
    subject, size = sys.argv[1], int(sys.argv[2])
    measure = SUBJECTS[subject]()
    before = _memory("VmRSS")
    first, then = measure(size)
    print(json.dumps({"first": first, "then": then, "memory": max(0.0, _memory("VmHWM") - before)}))


def _memory(field: str) -> float:
    """Return a figure of this process's memory [MB]."""
    return int(Path("/proc/self/status").read_text().partition(f"{field}:")[2].split()[0]) / 1e3


if __name__ == "__main__":
    main()
