"""Plans among clouds of points: what every stage costs, beside the same problems with the bodies themselves.

Usage: tools/bench clouds --problems <folder> [--every N] [--points N] [--radius MM] [<robot> ...]

The folder is described in problems.py. A problem's obstacles become one cloud: points spread evenly over their
surfaces, each a ball. Problems whose start or goal touches a ball are left out. All is CPU time.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.posed import posed
from benchmarks.problems import ROBOTS, Problems, scene_of
from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.errors import Status
from guidefield.messages import codec, scene as messages
from guidefield.messages.values import Float32Array
from guidefield.planner.connect import tree_search
from guidefield.planner.connect.settings import TREE
from guidefield.planner.plan import Planner, plan
from guidefield.planner.task.problem import ConfigurationGoal
from guidefield.scene.distance_tables import distance_tables
from guidefield.scene.scene import Scene, build

SECONDS = 20.0
"""Budget of one problem."""

Times = dict[str, float]
"""Seconds by what took them."""


def run(arguments: list[str]) -> None:
    """Print a table for each robot."""
    parser = argparse.ArgumentParser(prog="tools/bench clouds", description=__doc__.partition("\n")[0])
    parser.add_argument("--problems", type=Path, required=True, help="folder of problems and robots")
    parser.add_argument("--every", type=int, default=1, help="take every n-th problem only")
    parser.add_argument("--points", type=int, default=100_000, help="points of a cloud")
    parser.add_argument("--radius", type=float, default=5.0, help="of each point's ball [mm]")
    parser.add_argument("robots", nargs="*", default=list(ROBOTS))
    asked = parser.parse_args(arguments)
    for robot in asked.robots:
        given = Problems.load(asked.problems, robot, asked.every)
        warm = given.problems[0]  # kernels come from their cache, the robot's tables are made
        _planned(given, warm, scene_of(warm))
        _planned(given, warm, build(cloud_of(warm, 1000, 1e-3 * asked.radius)))
        rows = [_row(given, problem, asked.points, 1e-3 * asked.radius) for problem in given.problems]
        free = [row for row in rows if row is not None]
        print(f"\n{robot}: {len(free)} of {len(rows)} problems whose ends keep off the clouds of {asked.points} points")
        _print("clouds", [row[0] for row in free])
        _print("bodies", [row[1] for row in free])


def cloud_of(problem: dict[str, Any], count: int, radius: float) -> messages.Scene:
    """A scene of one cloud: so many points on the surfaces of a problem's obstacles, sent as float32."""
    rng = np.random.default_rng(problem["index"])
    corners = np.concatenate([one.vertices[one.triangles] for one in scene_of(problem).obstacles])
    a, b, c = np.moveaxis(corners, 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    chosen = rng.choice(len(corners), count, p=areas / areas.sum())
    shares = np.sort(rng.random((2, count, 1)), axis=0)
    points = shares[0] * a[chosen] + (shares[1] - shares[0]) * b[chosen] + (1.0 - shares[1]) * c[chosen]
    sent = Float32Array(points.astype("<f4").tobytes())
    return messages.Scene(name="scan", obstacles=[messages.PointCloud(name="cloud", points=sent, radius=radius)])


def _row(given: Problems, problem: dict[str, Any], count: int, radius: float) -> tuple[Times, Times] | None:
    """Times among the cloud and among the bodies; None if an end touches the cloud."""
    times: Times = {}
    message = codec.encode(cloud_of(problem, count, radius), codec.Encoding.MSGPACK)
    began = time.process_time()
    declared = codec.decode(message, messages.Scene, codec.Encoding.MSGPACK)
    times["decoded"] = _since(began)
    began = time.process_time()
    scene = build(declared)
    times["built"] = _since(began)
    world = World.build(given.group, scene)
    if any(world.in_collision(given.group.expand_from_chart(z)) for z in given.ends(problem)):
        return None
    began = time.process_time()
    _ = scene.obstacles[0].cloud.tables
    times["tables for lanes"] = _since(began)
    began = time.process_time()
    distance_tables(scene)
    times["tables for distances"] = _since(began)
    times.update(_planned(given, problem, scene))
    return times, _planned(given, problem, scene_of(problem))


def _planned(given: Problems, problem: dict[str, Any], scene: Scene) -> Times:
    """Times of a bare tree, and of a whole plan by stage."""
    group, times = given.group, {}
    z_start, z_goal = given.ends(problem)
    for name in ("tree, first", "tree, again"):
        lanes = BatchCollision.build(World.build(group, scene))
        began = time.process_time()
        deadline = Deadline(time.monotonic() + SECONDS)
        rng = np.random.default_rng(0)
        found = tree_search.grow(lanes, z_start[None], z_goal[None], TREE.resolution, 0.0, rng, deadline)
        times[name] = _since(began) if found.path is not None else np.nan
    q_start, goal = group.from_chart(z_start), ConfigurationGoal((group.from_chart(z_goal),))
    asked = posed(group, scene, q_start, goal, deadline=Deadline(time.monotonic() + SECONDS))
    began = time.process_time()
    planned = plan(asked, Planner.AUTO)
    times["plan"] = _since(began)
    times["certified"] = float(planned.status is Status.SUCCESS)
    return times | {f"  {stage}": seconds for stage, seconds in planned.seconds.items()}


def _since(began: float) -> float:
    return time.process_time() - began


def _print(title: str, rows: list[Times]) -> None:
    certified = sum(int(row.pop("certified")) for row in rows)
    print(f" {title}: certified {certified} of {len(rows)}; ms median / mean / p95")
    for name in dict.fromkeys(name for row in rows for name in row):
        found = 1e3 * np.array([row[name] for row in rows if name in row])
        print(f"  {name:24} {np.nanmedian(found):9.3g} {np.nanmean(found):9.3g} {np.nanquantile(found, 0.95):9.3g}")
