"""What it costs that one obstacle of a stored scene of thousands is moved, added or removed.

Usage: tools/bench changes [--count N] [--rounds N]

Through the door, as a worker of the service does it: an engine with a store of scenes on disk (in memory, where the
system has such a folder) answers a change, a plan for a Panda in what the scene is now, and the same plan again. The
columns are CPU time of the change, how much more of it the first of both plans takes than the second, and that of the
second: each the best of the rounds, then the median. Obstacles are small boxes: ten near the robot, the others more
than a metre from where it is; or all within two metres of it, where a plan leaves out few.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks import grown
from benchmarks.grown import SEED, Made
from guidefield.engine import Engine
from guidefield.messages import codec
from guidefield.messages.replies import PlanReply
from guidefield.stores.scenes import SceneStore

MEMORY = Path("/dev/shm")  # noqa: S108 - a folder of its own is made in it
AGAIN = 4
"""Plans in a scene that is known, of which the quickest counts."""


class Case(NamedTuple):
    """A scene, and what is changed in the k-th round."""

    dense: bool
    change: Any


def run(arguments: list[str]) -> None:
    """Print a row for each kind of change."""
    parser = argparse.ArgumentParser(prog="tools/bench changes", description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=10_000, help="obstacles")
    parser.add_argument("--rounds", type=int, default=12, help="changes of each kind")
    asked = parser.parse_args(arguments)
    print(f"{'ms of CPU time':>24} {'change':>14} {'plan after it':>16} {'again':>16}", flush=True)
    for name, case in CASES.items():
        boxes = _dense(asked.count) if case.dense else grown.boxes(asked.count, SEED)
        with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as folder:
            rows = 1e3 * _rounds(Engine(scenes=SceneStore(Path(folder))), boxes, case, asked.rounds)
        figures = [
            (change, first - again, again) for change, first, again in (rows.min(axis=0), np.median(rows, axis=0))
        ]
        print(
            f"{name:>24}", *(f"{best:>9.2f} {middle:>6.2f}" for best, middle in zip(*figures, strict=True)), flush=True
        )


def _rounds(engine: Engine, boxes: list[Made], case: Case, rounds: int) -> np.ndarray:
    """Of each round the time of the change, of the next plan, and of that plan again, shape (n, 3) [s]."""
    scene = {"name": "cell", "obstacles": boxes}
    engine.answer({"type": "store_scene", "name": "cell", "scene": scene})
    plan = codec.decode_request({**grown.plan(boxes), "scene": "cell"})
    for _ in range(3):
        _seconds(engine, plan)
    rows = []
    for k in range(rounds):
        change = _seconds(engine, {"type": "change_scene", "name": "cell", "diff": case.change(k)})
        first = _seconds(engine, plan)
        again = min(_seconds(engine, plan) for _ in range(AGAIN))
        rows.append((change, first, again))
    return np.array(rows)


def _seconds(engine: Engine, request: Any) -> float:
    """CPU time of an answer [s]."""
    asked = codec.decode_request(request)
    began = time.process_time()
    reply = engine.answer(asked)
    took = time.process_time() - began
    assert not isinstance(reply, PlanReply) or reply.status.name == "SUCCESS", reply
    return took


def _dense(count: int) -> list[Made]:
    """Crumbs all about a robot, ten boxes among them, and none where it is."""
    rng, made = np.random.default_rng(SEED), grown.boxes(min(10, count), SEED)
    while len(made) < count:
        place = rng.uniform(-1.6, 1.6, 3)
        if place[2] < -0.3 or np.hypot(place[0], place[1]) > 1.05:
            size = [0.01, 0.02, 0.01]
            made.append({"type": "box", "name": f"far{len(made)}", "size": size, "position": place.tolist()})
    return made


def _moved(name: str, x: float, y: float, z: float) -> Made:
    return {"type": "scene_diff", "move": {name: {"position": [x, y, z]}}}


def _far(k: int) -> Made:
    return _moved(f"far{77 + k}", 3.0 + 0.01 * k, 3.0, 1.0)


def _near(k: int) -> Made:
    return _moved("near3", -0.78, 0.1 + 0.01 * k, 0.5)


def _added(k: int) -> Made:
    box = {"type": "box", "name": f"new{k}", "size": [0.1, 0.1, 0.1], "position": [-0.78, 0.1 * k, 0.5]}
    return {"type": "scene_diff", "add": [box]}


CASES = {
    "moved, out of reach": Case(False, _far),
    "moved, in reach": Case(False, _near),
    "moved, all in reach": Case(True, _near),
    "added": Case(False, _added),
    "removed": Case(False, lambda k: {"type": "scene_diff", "remove": [f"far{100 + k}"]}),
}
