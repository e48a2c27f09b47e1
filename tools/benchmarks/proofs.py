"""What it takes to prove a motion: the verdict alone, with the smallest distances, among what moves, among many boxes.

Usage: tools/bench proofs <folder> [--robots panda,ur5,fetch,baxter] [--every N] [--repeats N]

The folder is described in problems.py. Motions are those of `guidefield.answer` to joint goals; of each the best of N
repetitions counts, in CPU time of one thread with tables known, and a row has the median and the 95th percentile over
the motions [ms]. *movers* adds two boxes on turning screws to the scene, *boxes* 5,000 boxes two to six metres away;
*refused* is the clearance asked for 1 mm above what the motion keeps, *certify* the whole answer to a certify request
of the motion, free and refused so, recording off.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.problems import ROBOTS, Problems
from benchmarks.whole import public_requests
from guidefield import CertifyRequest, PlanReply, PlanRequest, answer
from guidefield.collision.world import World
from guidefield.messages import scene as messages
from guidefield.messages.certify_request import GivenTrajectory
from guidefield.messages.values import Placement
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.prove.certificate import certify
from guidefield.prove.curve import Curve
from guidefield.prove.minima import smallest_along
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import build

SAMPLES = 30
"""Samples of a motion at which distances are asked for, as a plan asks."""

SECONDS = 10.0
"""Budget of a plan."""


def run(arguments: list[str]) -> None:
    """Print a row of figures for each robot."""
    parser = argparse.ArgumentParser(prog="tools/bench proofs", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--robots", default=",".join(ROBOTS))
    parser.add_argument("--every", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=5)
    given = parser.parse_args(arguments)
    for robot in given.robots.split(","):
        rows: dict[str, list[float]] = {}
        problems = Problems.load(given.folder, robot, given.every)
        for request in public_requests(given.folder, robot, given.every)[0]:
            for name, seconds in _measured(problems, request, given.repeats).items():
                rows.setdefault(name, []).append(1e3 * seconds)
        told = "; ".join(
            f"{name} {statistics.median(row):.2f} / {np.percentile(row, 95):.2f}" for name, row in rows.items()
        )
        print(f"{robot} ({len(rows.get('verdict', []))} motions): {told}", flush=True)


def _measured(problems: Problems, request: PlanRequest, repeats: int) -> dict[str, float]:
    """Return the times of a problem's motion [s]; none where no plan was found."""
    reply = answer(request)
    if not isinstance(reply, PlanReply) or reply.trajectory is None or reply.status.name != "SUCCESS":
        return {}
    made, scene = reply.trajectory, request.scene
    assert isinstance(scene, messages.Scene), "a problem's scene is told"
    motion = Trajectory(np.array(made.times), np.array(made.positions), np.array(made.velocities))
    curve, samples = Curve(motion.bezier(), motion.piece_times()), np.linspace(0.0, motion.duration, SAMPLES)
    spans = [(0.0, motion.duration), (0.1 * motion.duration, 0.9 * motion.duration)]
    world = World.build(problems.group, build(scene))
    kept = smallest_along(world, curve, samples, spans).obstacle[0].distance

    def whole(place: World, clearance: float) -> Callable[[], object]:
        return lambda: smallest_along(place, curve, samples, spans, clearance)

    rng = np.random.default_rng(len(made.times))
    moving = _among(problems.group, scene, _movers(rng, motion.duration))
    boxes = _among(problems.group, scene, _boxes(rng))
    found = {
        "verdict": _best(lambda: certify(world, curve.pieces), repeats),
        "all": _best(whole(world, 0.0), repeats),
        "all, movers": _best(whole(moving, 0.0), repeats),
        "all, boxes": _best(whole(boxes, 0.0), repeats),
        "all, refused": _best(whole(world, kept + 1e-3), repeats),
    }
    given = GivenTrajectory(positions=made.positions, times=made.times, velocities=made.velocities)
    for name, clearance in (("certify free", 0.0), ("certify refused", kept + 1e-3)):
        asked = CertifyRequest(
            request.robot, scene, trajectory=given, group=request.group, start=request.start,
            position_names=reply.position_names, min_clearance=clearance, allowed_time=SECONDS, recording="off",
        )  # fmt: skip
        found[name] = _best(partial(answer, asked), repeats)
    return found


def _best(doing: Callable[[], object], repeats: int) -> float:
    """The best CPU time of some repetitions after one that isn't measured [s]."""
    doing()
    times = []
    for _ in range(repeats):
        began = time.process_time()
        doing()
        times.append(time.process_time() - began)
    return min(times)


def _among(group: PlanningGroup, scene: messages.Scene, more: list[messages.Obstacle]) -> World:
    return World.build(group, build(messages.Scene(name="more", obstacles=[*scene.obstacles, *more])))


def _movers(rng: np.random.Generator, duration: float) -> list[messages.Obstacle]:
    """Two boxes that turn and move about the robot, some 2 m away."""
    made = list[messages.Obstacle]()
    for k in range(2):
        times = np.linspace(0.0, max(duration, 0.1), 5)
        placements = []
        for _ in times:
            turn = rng.normal(size=4)
            away = rng.normal(size=3) * (1.0, 1.0, 0.3)
            place = 2.0 * away / np.linalg.norm(away)
            placements.append(
                Placement(position=tuple(place.tolist()), quaternion_xyzw=tuple((turn / np.linalg.norm(turn)).tolist()))
            )
        flight = messages.ObstacleTrajectory(times=times.tolist(), placements=placements)
        made.append(messages.Box(name=f"moving {k}", size=(0.2, 0.1, 0.3), trajectory=flight))
    return made


def _boxes(rng: np.random.Generator) -> list[messages.Obstacle]:
    directions = rng.normal(size=(5000, 3))
    places = directions / np.linalg.norm(directions, axis=1, keepdims=True) * rng.uniform(2.0, 6.0, (5000, 1))
    return [
        messages.Box(name=f"far {k}", size=(0.05, 0.05, 0.05), position=tuple(place))
        for k, place in enumerate(places.tolist())
    ]
