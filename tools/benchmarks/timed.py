"""Plans among obstacles that move as is known: success and motion times beside waiting until all rest, and CPU time.

Usage: tools/bench timed [--runs N] [--first N] [--robots panda,ur5] [--time S] [--jerk] [--met] [--each]

Random scenes from fixed seeds: two to five bodies of several kinds move and come to rest within 10 s, and never touch
the robot where it starts, or do with --met; one to three rest. Goals are random configurations that are free once all
rest. *still* is how many of them the planner among obstacles at rest solves then. *of them* is how many of these are
solved in time, and *others* how many more. *arrival* is the median of when the robot arrives over when it would, had it
waited until all rest; *waited* is how many departed later than 0.3 s; *lasts* is the median of how long motions take,
waiting included, and *inner* that of their smallest clearance without the ends; *CPU* is the processor time of a plan,
median and 95th percentile; *still CPU* that of the still planner. Every motion is judged by the sampling judge of
`tools/doubt`.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import guidefield
from doubting.compare import judge_of, names_of, planned_curve
from doubting.loaded import Loaded
from doubting.robots import Robot
from doubting.scenery import random_rotation
from guidefield.collision.clearance import contacts_at
from guidefield.collision.world import World
from guidefield.engine import Engine
from guidefield.messages import scene as messages
from guidefield.messages.conditions import JointLimits
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest
from guidefield.messages.values import JointsGoal, Placement
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.scene.scene import Scene, build

LATEST = 10.0
"""By then all obstacles rest [s]."""

SLOWEST = 0.8
"""At least so long is a body on its way from one place to the next [s]."""

SAMPLES = 0.02
"""Between two samples of what passes the robot [s]."""

PASSING = 0.03
"""An obstacle that comes as close to the start as that passes it [m]."""


@dataclass(frozen=True)
class Drawn:
    """A random problem: the request among what moves, and the same once all rest."""

    request: PlanRequest
    resting: PlanRequest
    group: PlanningGroup
    scene: Scene


def run(arguments: list[str]) -> None:
    """Run what is asked for, and print a row for each robot."""
    parser = argparse.ArgumentParser(prog="tools/bench timed", description=__doc__.splitlines()[0])
    parser.add_argument("--robots", default="panda,ur5")
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--time", type=float, default=60.0)
    parser.add_argument("--jerk", action="store_true")
    parser.add_argument("--met", action="store_true")
    parser.add_argument("--each", action="store_true")
    asked = parser.parse_args(arguments)
    print(
        f"{'':10s}{'runs':>6s}{'still':>7s}{'of them':>9s}{'others':>8s}{'arrival':>9s}{'waited':>8s}{'lasts':>8s}"
        f"{'inner mm':>10s}{'CPU ms':>8s}{'95 %':>8s}{'still CPU':>11s}{'contacts':>10s}"
    )
    for robot in asked.robots.split(","):
        loaded = Loaded.of(Robot(catalog=robot), Path(), Engine())
        solved, others, ratios, waited, spent, still_spent, contacts, still = 0, 0, [], 0, [], [], 0, 0
        lasts, inner = [], []
        for seed in range(asked.first, asked.first + asked.runs):
            drawn = problem_of(loaded, seed, asked.time, jerk=asked.jerk, met=asked.met)
            guidefield.answer(drawn.resting)  # what is loaded once is not measured
            reply, seconds = time_answer(drawn.request)
            at_rest, still_seconds = time_answer(drawn.resting)
            good, possible = reply.status.name == "SUCCESS", at_rest.status.name == "SUCCESS"
            still, solved, others = still + possible, solved + (good and possible), others + (good and not possible)
            spent.append(1e3 * seconds)
            still_spent.append(1e3 * still_seconds)
            if good:
                contacts += touches(loaded, drawn, reply)
                lasts.append(reply.metrics.duration)
                inner.append(np.nan if reply.clearance.inner is None else 1e3 * reply.clearance.inner)
                waited += bool(reply.trajectory.times[1] > 0.3)
            if good and possible:
                ratios.append(reply.metrics.duration / (drawn.scene.end + at_rest.metrics.duration))
            if asked.each or good < possible:
                why = f"{reply.status.name}: {reply.status.message}"
                told = f"{lasts[-1]:.3f} s, {inner[-1]:.1f} mm" if good else why
                print(f"   {robot} {seed}: end {drawn.scene.end:.2f} s, {1e3 * seconds:.0f} ms, {told}", flush=True)
        print(
            f"{robot:10s}{asked.runs:6d}{still:7d}{solved:9d}{others:8d}{np.median(ratios or [np.nan]):9.2f}{waited:8d}"
            f"{np.median(lasts or [np.nan]):8.2f}{np.nanmedian(inner or [np.nan]):10.1f}"
            f"{np.median(spent):8.0f}{np.percentile(spent, 95):8.0f}{np.median(still_spent):11.0f}{contacts:10d}",
            flush=True,
        )


def time_answer(request: PlanRequest) -> tuple[Any, float]:
    """A request's answer, and the processor time it took [s]."""
    begin = time.process_time()
    reply = guidefield.answer(request)
    return reply, time.process_time() - begin


def problem_of(loaded: Loaded, seed: int, seconds: float, *, jerk: bool = False, met: bool = False) -> Drawn:
    """The random problem of a seed; with `met` one in which something comes to the robot where it starts."""
    model = loaded.model
    group = select(model, None, None, model.rest, pin.SE3.Identity())
    rng = np.random.default_rng([seed, 19])
    start = group.part_of(model.rest)
    while True:
        obstacles = [moving(rng, f"mover{k}") for k in range(rng.integers(2, 6))]
        obstacles += [
            body(rng, f"rest{k}", rng.uniform([-0.8, -0.8, 0.0], [0.8, 0.8, 1.0])) for k in range(rng.integers(1, 4))
        ]
        scene = build(messages.Scene("timed", obstacles=obstacles))
        last = scene.at(scene.end)
        world, first = World.build(group, last), World.build(group, scene.at(0.0))
        ends_free = not any(contacts_at(one, group.expand(start)) for one in (world, first))
        if not ends_free or is_passed(loaded, obstacles) != met:
            continue
        goal = next(
            (z for z in (group.random(rng) for _ in range(50)) if not contacts_at(world, group.expand_from_local(z))),
            None,
        )
        if goal is not None:
            break
    names = group.position_names
    fields = {
        "robot": loaded.reference,
        "start": dict(zip(names, group.wire_positions(group.to_local(start)), strict=True)),
        "goal": JointsGoal(dict(zip(names, group.wire_positions(goal), strict=True))),
        "guide_planes": [],
        "allowed_planning_time": seconds,
        "limits": {joint.name: JointLimits(jerk=300.0) for joint in group.joints} if jerk else {},
        "seed": seed,
    }
    return Drawn(PlanRequest(scene=scene.message, **fields), PlanRequest(scene=last.message, **fields), group, scene)


def moving(rng: np.random.Generator, name: str) -> messages.Obstacle:
    """A body that goes through two to four places and comes to rest."""
    count, times = int(rng.integers(2, 5)), np.zeros(2)
    while np.diff(times).min() < SLOWEST:
        times = np.sort(rng.uniform(0.0, LATEST, count))
    places = rng.uniform([-0.9, -0.9, 0.0], [0.9, 0.9, 1.1], (count, 3))
    placements = [Placement(position=tuple(place.tolist()), quaternion_xyzw=random_rotation(rng)) for place in places]
    return body(rng, name, places[0], messages.ObstacleTrajectory(times=times.tolist(), placements=placements))


def body(
    rng: np.random.Generator, name: str, at: np.ndarray, trajectory: messages.ObstacleTrajectory | None = None
) -> messages.Obstacle:
    """A body of a random kind at a place (3,)."""
    size, place = rng.uniform(0.08, 0.35, 3), {"name": name, "position": tuple(at.tolist()), "trajectory": trajectory}
    kinds = [
        lambda: messages.Box(size=tuple(size.tolist()), quaternion_xyzw=random_rotation(rng), **place),
        lambda: messages.Sphere(radius=0.5 * size[0], **place),
        lambda: messages.Capsule(radius=0.3 * size[0], length=size[1], quaternion_xyzw=random_rotation(rng), **place),
        lambda: messages.Cylinder(radius=0.4 * size[0], length=size[1], quaternion_xyzw=random_rotation(rng), **place),
    ]
    return kinds[int(rng.integers(len(kinds)))]()


def touches(loaded: Loaded, drawn: Drawn, reply: PlanReply) -> bool:
    """Return whether a sample of a reply's motion touches an obstacle as it stands then."""
    curve = planned_curve(reply)
    return judge_of(loaded, drawn.request, names_of(reply.position_names)).along_all(curve).obstacle.distance <= 0.0


def is_passed(loaded: Loaded, obstacles: list[messages.Obstacle]) -> bool:
    """Return whether any obstacle touches a robot at rest, or comes within 30 mm of it, as it passes."""
    times = np.arange(0.0, LATEST + SAMPLES, SAMPLES)
    judge = loaded.judge(frozenset(joint.name for joint in loaded.movable), obstacles=obstacles)
    distances, _ = judge.measured({name: np.repeat(one, len(times)) for name, one in judge.whole({}).items()}, times)
    return bool(distances[:, ~judge.own].min() < PASSING)
