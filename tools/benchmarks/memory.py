"""Memory of a worker under requests that are all different: it levels off.

Usage: tools/bench memory [--requests N] [--every N] [--settled N] [--most-growth SHARE] [--robots NAME ...]
       [--found MB]

Plans, judgements, clearance and inverse kinematics for robots of the catalog and for arms that nobody has seen, with
other scenes, allowed pairs, held objects and moving obstacles in each; an engine answers them in this process, as a
worker does. Each row is the memory in use [MB] after so many requests. It goes up and down by what is forgotten at one
time: growth is that of the mean, from the first half of the rows after 300 requests to the second. Exit code 0: it is
at most the given share.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.grown import Made, boxes, cloud, moving, terrain
from guidefield import memo
from guidefield.engine import Engine
from guidefield.errors import GuidefieldError
from guidefield.memory import FOUND, BoundedMap, Limit
from guidefield.messages.requests import ReadRobot
from guidefield.system import resident

ROBOTS = ("panda", "ur5", "talos_left_arm", "chain_fixed_6x300_r25", "kinova")
SETTLED = 300
"""So many requests are let fill what is bounded."""


def run(arguments: list[str]) -> None:
    """Print a row for every so many requests."""
    parser = argparse.ArgumentParser(prog="tools/bench memory", description=__doc__.partition("\n")[0])
    parser.add_argument("--requests", type=int, default=1000)
    parser.add_argument("--every", type=int, default=50)
    parser.add_argument("--settled", type=int, default=SETTLED)
    parser.add_argument("--most-growth", type=float, default=0.02)
    parser.add_argument("--robots", nargs="*", default=ROBOTS)
    parser.add_argument("--found", type=int, help="another limit of what is found once [MiB]")
    asked = parser.parse_args(arguments)
    if asked.found is not None:
        memo._FOUND = BoundedMap(Limit(FOUND.entries, asked.found * 2**20))
    grown = measure(asked.robots, asked.requests, asked.every, asked.settled)
    print(f"grown by {100 * grown:.1f} % after {asked.settled} requests")
    sys.exit(int(grown > asked.most_growth))


def measure(names: Sequence[str], requests: int, every: int, settled: int) -> float:
    """Answer requests; return by which share the mean of the later half of rows is more, after some requests."""
    engine, ended, rows = Engine(), Counter[str](), list[tuple[int, float]]()
    robots = [name for name in names if _is_there(engine, name)]
    known = {name: engine.answer(ReadRobot(robot=name)) for name in robots}
    print(f"{'requests':>10} {'MB':>8} {'seconds':>8}  {', '.join(robots)}", flush=True)
    began = time.process_time()
    for index in range(1, requests + 1):
        request = vary(np.random.default_rng(index), known)
        try:
            status = getattr(engine.answer(request), "status", None)
            ended["answered" if status is None else status.name] += 1
        except GuidefieldError as error:
            ended[type(error).__name__] += 1
        if index % every == 0:
            rows.append((index, resident(os.getpid()) / 2**20))
            print(f"{index:>10} {rows[-1][1]:>8.1f} {time.process_time() - began:>8.1f}  {dict(ended)}", flush=True)
    late = [memory for index, memory in rows if index >= settled]
    half = len(late) // 2
    return float(np.mean(late[half:]) / np.mean(late[: half or 1]) - 1.0)


def _is_there(engine: Engine, name: str) -> bool:
    try:
        engine.answer(ReadRobot(robot=name))
    except GuidefieldError:
        return False
    return True


def vary(rng: np.random.Generator, robots: dict[str, Any]) -> Made:
    """A request that differs from all others in robot, scene, allowed pairs and question."""
    kind = rng.integers(4)
    scene = _scene(rng, may_move=bool(kind > 0))
    if rng.random() < 0.2:
        robot: Any = {"type": "urdf", "text": _arm(rng)}
        moved, links = {f"joint{k}": (-2.0, 2.0) for k in range(5)}, [f"link{k}" for k in range(1, 6)]
    else:
        robot = [*robots][rng.integers(len(robots))]
        turning = [one for one in robots[robot].joints if one.kind == "revolute" and one.mimics is None]
        moved, links = {one.name: (one.lower[0], one.upper[0]) for one in turning}, robots[robot].links
    ends = [{name: float(rng.uniform(*_inner(*span))) for name, span in moved.items()} for _ in range(2)]
    asked = {"robot": robot, "scene": scene}
    names = [*links, *(one["name"] for one in scene["obstacles"])]
    chosen = [[links[rng.integers(len(links))], names[rng.integers(len(names))]] for _ in range(rng.integers(4))]
    pairs = {"allowed_collisions": [pair for pair in chosen if pair[0] != pair[1]]}
    if kind == 0:
        path = [list(end.values()) for end in ends]
        return {"type": "certify", **asked, **pairs, "path": path, "position_names": list(moved), "recording": "off"}
    if kind == 1:
        return {"type": "clearance", **asked, **pairs, "configurations": ends}
    plan = {**asked, **pairs, "start": ends[0], "goal": {"type": "joints", "positions": ends[1]}}
    if rng.random() < 0.3:
        box = {"type": "box", "name": "held", "size": rng.uniform(0.01, 0.05, 3).tolist()}
        plan["attached_objects"] = [{"obstacle": box, "link": links[-1]}]
    return {**plan, "guide_planes": [], "allowed_planning_time": 1.0, "recording": "off", "seed": int(rng.integers(99))}


def _inner(lower: float, upper: float) -> tuple[float, float]:
    middle = 0.5 * (lower + upper)
    return 0.5 * (lower + middle), 0.5 * (upper + middle)


def _scene(rng: np.random.Generator, may_move: bool) -> Made:
    draw = int(rng.integers(2**31))
    obstacles = boxes(int(rng.integers(1, 60)), draw)
    if rng.random() < 0.2:
        obstacles += terrain(int(rng.integers(200, 4000)), draw)
    if rng.random() < 0.1:
        obstacles += cloud(int(rng.integers(100, 3000)), draw)
    if may_move and rng.random() < 0.2:
        obstacles[-1:] = [moving(one, (0.1, 0.0, 0.0)) if one["type"] == "box" else one for one in obstacles[-1:]]
    return {"name": f"scene {draw}", "obstacles": obstacles}


def _arm(rng: np.random.Generator) -> str:
    """An arm of five joints, of lengths that nobody has seen."""
    parts = ['<robot name="arm"><link name="link0"/>']
    for k in range(5):
        length, radius = rng.uniform(0.1, 0.3), rng.uniform(0.02, 0.05)
        axis = "0 0 1" if k % 2 == 0 else "0 1 0"
        parts.append(
            f'<link name="link{k + 1}"><collision><origin xyz="0 0 {length / 2}"/><geometry>'
            f'<cylinder radius="{radius}" length="{length}"/></geometry></collision></link>'
            f'<joint name="joint{k}" type="revolute"><parent link="link{k}"/><child link="link{k + 1}"/>'
            f'<origin xyz="0 0 {length}"/><axis xyz="{axis}"/>'
            '<limit lower="-2.5" upper="2.5" velocity="2" effort="9"/></joint>'
        )
    return "".join([*parts, "</robot>"])
