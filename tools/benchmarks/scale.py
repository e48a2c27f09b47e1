"""How the time of a whole answer grows: with obstacles, triangles, points, links, and waypoints of a given motion.

Usage: tools/bench scale [obstacles | triangles | points | movers | crossed | links | waypoints ...] [--most N]
       [--repeats N]

Each answer is through `guidefield.answer`, by CPU time of the process: the first one in a scene that was never seen,
and the best of the next ones. The exponent is that of the power of the size that fits best, over all sizes but the
smallest decade. Obstacles are small boxes, all but ten of them more than a metre away from where the robot is. Movers
are the same boxes, each of which slides to and fro; crossed are boxes at rest, with one that comes across the way.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

import guidefield
from guidefield.messages import codec
from guidefield.messages.requests import ReadRobot
from guidefield.messages.values import Float32Array

PANDA = {f"panda_joint{i}": v for i, v in enumerate((0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785), 1)}
TURNED = {**PANDA, "panda_joint1": 0.9}
PATIENT = {"allowed_planning_time": 600.0, "recording": "off"}
SEED = 7

Made = dict[str, Any]


class Subject(NamedTuple):
    """What grows: sizes, and the request of a size; another draw is another scene of the same kind."""

    sizes: tuple[int, ...]
    request: Callable[[int, int], Made]


def run(arguments: list[str]) -> None:
    """Print a table for each subject."""
    parser = argparse.ArgumentParser(prog="tools/bench scale", description=__doc__.partition("\n")[0])
    parser.add_argument("--most", type=int, default=1_000_000, help="leave larger sizes out")
    parser.add_argument("--repeats", type=int, default=3, help="answers after the first")
    parser.add_argument("subjects", nargs="*", choices=[*SUBJECTS, []], help="which; all unless told")
    asked = parser.parse_args(arguments)
    for warm in range(2):
        _answered(_plan(_boxes(5, warm)))
    for name in asked.subjects or SUBJECTS:
        subject = SUBJECTS[name]
        _table(name, subject, [size for size in subject.sizes if size <= asked.most], asked.repeats)


def _table(name: str, subject: Subject, sizes: Sequence[int], repeats: int) -> None:
    print(f"\n{name:>10} {'first, ms':>12} {'then, ms':>12}  status", flush=True)
    rows = []
    for draw, size in enumerate(sizes):
        request = codec.decode_request(subject.request(size, SEED + draw))
        first, status = _answered(request)
        then = min(_answered(request)[0] for _ in range(repeats))
        rows.append((size, first, then))
        print(f"{size:>10} {1e3 * first:>12.1f} {1e3 * then:>12.1f}  {status}", flush=True)
    fitted = [row for row in rows if row[0] >= 10 * sizes[0]] or rows
    if len(fitted) > 1:
        size, first, then = np.log(np.array(fitted)).T
        powers = [float(np.polyfit(size, times, 1)[0]) for times in (first, then)]
        print(f"{'exponent':>10} {powers[0]:>12.2f} {powers[1]:>12.2f}  from {fitted[0][0]} on", flush=True)


def _answered(request: Any) -> tuple[float, str]:
    """CPU time of an answer [s], and how it ended."""
    began = time.process_time()
    reply = guidefield.answer(request)
    return time.process_time() - began, reply.status.name


def _plan(obstacles: list[Made]) -> Made:
    scene = {"name": "grown", "obstacles": obstacles}
    goal = {"type": "joints", "positions": TURNED}
    return {"robot": "panda", "scene": scene, "start": PANDA, "goal": goal, "guide_planes": [], **PATIENT}


def _boxes(count: int, draw: int) -> list[Made]:
    rng, made = np.random.default_rng(draw), []
    for k in range(min(10, count)):
        angle = 0.2 * math.pi * k
        place = [0.75 * math.cos(angle), 0.75 * math.sin(angle), 0.05 + 0.02 * k]
        made.append({"type": "box", "name": f"near{k}", "size": [0.05, 0.05, 0.05], "position": place})
    while len(made) < count:
        place = rng.uniform(-8.0, 8.0, 3)
        if np.linalg.norm(place - [0.0, 0.0, 0.3]) > 2.2:
            size = rng.uniform(0.02, 0.1, 3).tolist()
            made.append({"type": "box", "name": f"far{len(made)}", "size": size, "position": place.tolist()})
    return made


def _moving(box: Made, way: Sequence[float]) -> Made:
    """A box that slides by a way and back in five seconds."""
    begin, end = box["position"], (np.array(box["position"]) + way).tolist()
    places = [{"position": place} for place in (begin, end, begin)]
    return {**box, "trajectory": {"times": [0.0, 2.5, 5.0], "placements": places}}


def _movers(count: int, draw: int) -> list[Made]:
    ways = np.random.default_rng(draw).uniform(-0.1, 0.1, (count, 3)).tolist()
    return [_moving(box, way) for box, way in zip(_boxes(count, draw), ways, strict=True)]


def _crossed(count: int, draw: int) -> list[Made]:
    across = {"type": "box", "name": "across", "size": [0.05, 0.05, 0.05], "position": [0.55, 0.9, 0.5]}
    return [*_boxes(count, draw), _moving(across, [0.0, -1.5, 0.0])]


def _terrain(count: int, draw: int) -> list[Made]:
    """An open mesh of about so many triangles, 6 m wide, below the robot."""
    side = max(1, round(math.sqrt(0.5 * count)))
    u = np.linspace(-3.0, 3.0, side + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(u, u, indexing="ij"))
    z = -0.25 + 0.04 * np.sin(11.0 * x + draw) * np.cos(7.0 * y)
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    halves = [np.column_stack([corner, corner + side + 1, corner + 1])]
    halves.append(np.column_stack([corner + 1, corner + side + 1, corner + side + 2]))
    triangles, vertices = np.concatenate(halves).tolist(), np.column_stack([x, y, z]).tolist()
    return [{"type": "mesh", "name": "terrain", "vertices": vertices, "triangles": triangles}]


def _cloud(count: int, draw: int) -> list[Made]:
    """So many points spread over the ground, sent as float32."""
    rng = np.random.default_rng(draw)
    points = np.column_stack([rng.uniform(-3.0, 3.0, (count, 2)), rng.uniform(-0.25, -0.22, count)])
    sent = Float32Array(points.astype("<f4").tobytes())
    return [{"type": "point_cloud", "name": "ground", "points": sent, "radius": 0.01}]


CHAINS = {6: "6x300_r25", 10: "10x168_r22", 12: "12x155_r22", 20: "20x88_r22", 24: "24x77_r22", 48: "48x39_r13"}


def _chain(links: int, draw: int) -> Made:
    """A chain of so many links, straight at first, that bends among ten boxes far away."""
    robot = f"chain_fixed_{CHAINS[links]}"
    balls = [joint.name for joint in guidefield.answer(ReadRobot(robot=robot)).joints if joint.kind == "spherical"]
    half = 0.3 / len(balls)
    bent = {name: [math.sin(half), 0.0, 0.0, math.cos(half)] for name in balls}
    far = [{**box, "position": [9.0, 0.1 * k, 0.0]} for k, box in enumerate(_boxes(10, draw))]
    goal = {"type": "joints", "positions": bent}
    return {"robot": robot, "scene": {"name": "far", "obstacles": far}, "goal": goal, "guide_planes": [], **PATIENT}


def _judged(rows: int, draw: int) -> Made:
    """A motion through so many rows, to and fro, judged among a hundred boxes."""
    ends = np.array([list(PANDA.values()), list(TURNED.values())])
    shares = 0.5 - 0.5 * np.cos(np.linspace(0.0, 0.5 * math.pi * rows, rows))
    path = (ends[0] + shares[:, None] * (ends[1] - ends[0])).tolist()
    scene = {"name": "grown", "obstacles": _boxes(100, draw)}
    asked = {"type": "certify", "robot": "panda", "scene": scene, "path": path}
    return {**asked, "allowed_time": 600.0, "recording": "off"}


SUBJECTS = {
    "obstacles": Subject((10, 100, 1_000, 3_000, 10_000), lambda size, draw: _plan(_boxes(size, draw))),
    "triangles": Subject((1_000, 10_000, 100_000, 1_000_000), lambda size, draw: _plan(_terrain(size, draw))),
    "points": Subject((1_000, 10_000, 100_000, 1_000_000), lambda size, draw: _plan(_cloud(size, draw))),
    "movers": Subject((10, 100, 1_000, 2_000), lambda size, draw: _plan(_movers(size, draw))),
    "crossed": Subject((10, 100, 1_000, 10_000), lambda size, draw: _plan(_crossed(size, draw))),
    "links": Subject(tuple(CHAINS), _chain),
    "waypoints": Subject((10, 100, 1_000, 10_000), _judged),
}
