"""Streams among moving obstacles: success, contacts, how much longer they take, and how long a cycle does.

Usage: tools/bench stream FOLDER [--arms 10,14,18,22] [--runs N] [--first N] [--every N]
       tools/bench stream panda [--runs N] [--first N] [--every N] [--hunters]

FOLDER holds public random scenarios in the neutral format: a robot among five boxes of 0.3 m that drift, each declared
0.3 m/s. *panda*: a Panda among 20 boxes of 10 to 12 cm that drift at 0.1 to 0.5 m/s, each of which declares its own
speed; with --hunters three that hunt it at 0.9 m/s; its jerks are limited as its maker says. A run succeeds if the
robot stands at its goal within 10 s and touched nothing, moving or at rest; an outside judge samples each 4 ms with
plain Pinocchio and Coal. The CPU time of every update is charged to the simulated clock: a piece that is late isn't
taken. *free* is the same run without obstacles; *x free* the ratio of times, of runs that succeeded.
"""

from __future__ import annotations

import argparse
import gzip
import json
from collections.abc import Callable
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import coal
import numpy as np

from guidefield.messages.conditions import JointLimits
from guidefield.messages.requests import UrdfFile
from guidefield.messages.scene import Box, HalfSpace, Scene
from guidefield.messages.streams import StreamObstacle, StreamOpen
from guidefield.messages.values import JointsGoal
from guidefield.robot.catalog import Catalog
from guidefield.scene.scene import build
from guidefield.stream.stream import CertifiedStream
from streaming.movers import Mover, hunting, reflected
from streaming.simulation import Outcome, simulate

LONGEST = 10.0
"""A run ends then [s]."""

PANDA_JERKS = (7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0)
"""A Panda's own limits, as its maker states them beside the accelerations that its description has [rad/s^3]."""

SMALLEST_GAP = 0.10
"""Distance of boxes from a Panda's start and goal at first [m]."""


def run(arguments: list[str]) -> None:
    """Run what is asked for, and print a row for each kind."""
    parser = argparse.ArgumentParser(prog="tools/bench stream", description=__doc__.splitlines()[0])
    parser.add_argument("what", help="a folder with scenarios, or panda")
    parser.add_argument("--arms", default="10,14,18,22")
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--every", type=int, default=1, help="of the runs one in so many")
    parser.add_argument("--hunters", action="store_true")
    asked = parser.parse_args(arguments)
    print(
        f"{'':14s}{'success':>12s}{'at speed/rest':>15s}{'x free':>8s}{'95 %':>7s}{'stood':>7s}"
        f"{'cycle ms':>10s}{'95 %':>7s}{'99 %':>7s}{'late':>7s}"
    )
    chosen = range(asked.first, asked.first + asked.runs * asked.every, asked.every)
    if asked.what == "panda":
        print_row("panda hunted" if asked.hunters else "panda", chosen, partial(panda_run, hunters=asked.hunters))
        return
    for arm in asked.arms.split(","):
        print_row(f"{arm} DoF", chosen, partial(public_run, Path(asked.what), int(arm)))


def print_row(name: str, chosen: range, made: Callable[[int], tuple[Outcome, Outcome]]) -> None:
    """Do some runs, each with the one without obstacles, and print a row about them."""
    runs = [made(index) for index in chosen]
    good = [(one, free) for one, free in runs if one.success]
    ratios = [one.reached / free.reached for one, free in good] or [np.nan]
    cycles = 1e3 * np.concatenate([one.cycles for one, _ in runs])
    speed, rest = sum(bool(one.at_speed) for one, _ in runs), sum(bool(one.at_rest) for one, _ in runs)
    late, pieces = sum(one.late for one, _ in runs), sum(one.pieces for one, _ in runs)
    excess = np.max([one.excess for one, _ in runs], axis=0)
    print(
        f"{name:14s}{len(good):5d} of {len(runs):3d}{speed:9d} / {rest:3d}{np.median(ratios):8.2f}"
        f"{np.percentile(ratios, 95):7.2f}{np.mean([one.stood for one, _ in runs]):7.2f}{np.median(cycles):10.1f}"
        f"{np.percentile(cycles, 95):7.1f}{np.percentile(cycles, 99):7.1f}{late:4d}/{pieces + late}"
        f"   beyond limits {np.max(excess):.1e}",
        flush=True,
    )
    for index, (one, _) in zip(chosen, runs, strict=True):
        if not one.success:
            print(f"   run {index}: reached {one.reached:.2f}, {one.at_speed[:1]}, {one.at_rest[:1]}, {one.reasons}")


def public_run(folder: Path, arm: int, index: int) -> tuple[Outcome, Outcome]:
    """One public run, and the same without obstacles."""
    data = json.loads(gzip.decompress((folder / f"spatial_{arm}dof.json.gz").read_bytes()))
    robot = Catalog().load(UrdfFile(path=str(folder / data["urdf"])))
    one, ground = data["runs"][index], data["ground"]
    names = [joint.name for joint in robot.joints]
    scene = build(Scene("ground", obstacles=[Box(name="ground", **_tuples(ground))]))
    limits = {name: JointLimits(**data["limits"]) for name in names}
    centre, radius = np.array(data["workspace"]["centre"]), data["workspace"]["radius"]
    outcomes = []
    for obstacles in (one["obstacles"], []):
        movers = [
            Mover(
                Box(name=f"box{k}", size=tuple(data["obstacle_size"])),
                0.3,
                np.array(box["position"]),
                np.array(box["velocity"]),
                steer=reflected(centre, radius, 0.545),
            )
            for k, box in enumerate(obstacles)
        ]
        request = StreamOpen(
            robot="given",
            scene="ground",
            goal=JointsGoal(dict(zip(names, one["goal"], strict=True))),
            start=dict(zip(names, one["start"], strict=True)),
            limits=limits,
            # the first link stands on the ground, and the scenarios' authors don't check the robot against itself
            allowed_collisions=[(robot.link_of_geometry(0), "ground"), *combinations(robot.links, 2)],
            obstacles=[StreamObstacle(mover.message, mover.largest) for mover in movers],
        )
        with CertifiedStream(request, robot, scene) as stream:
            place = coal.Transform3s(np.eye(3), np.array(ground["position"], float))
            resting = [("ground", coal.Box(*ground["size"]), place)]
            rng = np.random.default_rng(index)
            outcomes.append(simulate(stream, movers, resting, LONGEST, rng, own=False, deviating=True))
    return outcomes[0], outcomes[1]


def panda_run(index: int, hunters: bool) -> tuple[Outcome, Outcome]:
    """A Panda among drifting boxes, or hunted, and the same without obstacles."""
    robot = Catalog().load("panda")
    floor = HalfSpace(name="floor", normal=(0.0, 0.0, 1.0), offset=-0.05)
    scene = build(Scene("floor", obstacles=[floor]))
    rng = np.random.default_rng(1000 + index)
    centre = np.array([0.0, 0.0, 0.4])
    outcomes = []
    request, movers = _panda_problem(robot, scene, rng, centre, hunters)
    for some in (movers, []):
        asked = StreamOpen(
            robot="panda",
            scene="floor",
            goal=request[1],
            start=request[0],
            limits={name: JointLimits(jerk=jerk) for name, jerk in zip(request[0], PANDA_JERKS, strict=True)},
            obstacles=[StreamObstacle(mover.message, mover.largest) for mover in some],
        )
        with CertifiedStream(asked, robot, scene) as stream:
            place = coal.Transform3s(np.eye(3), np.array([0.0, 0.0, 0.0]))
            resting = [("floor", coal.Halfspace(np.array([0.0, 0.0, 1.0]), -0.05), place)]
            outcomes.append(
                simulate(stream, some, resting, LONGEST, rng, deviating=True, to_the_end=hunters and bool(some))
            )
    return outcomes[0], outcomes[1]


def _panda_problem(robot: Any, scene: Any, rng: np.random.Generator, centre: np.ndarray, hunters: bool) -> Any:
    """Start and goal, free of the floor and apart, and boxes that are away from both."""
    with CertifiedStream(StreamOpen("panda", "floor"), robot, scene) as stream:
        group, paths = stream.group, stream._paths
        while True:
            zs = np.array([group.random(rng) for _ in range(2)])
            if paths.find_free(zs).all() and np.abs(zs[0] - zs[1]).max() > 0.8:
                break
        names = group.position_names

        movers: list[Mover] = []
        count = 3 if hunters else 20
        while len(movers) < count:
            size = rng.uniform(0.10, 0.12, 3)
            where = rng.uniform([-0.9, -0.9, 0.0], [0.9, 0.9, 1.2])
            row = np.zeros((1, 16))
            row[0, [0, 5, 10]] = 1.0
            row[0, [3, 7, 11]], row[0, 12:15] = where, 0.5 * size
            gap = 0.5 if hunters else SMALLEST_GAP
            if paths.batch.gaps(row, np.array(zs), 0.6).min() < gap:
                continue
            speed = 0.9 if hunters else rng.uniform(0.1, 0.5)
            direction = rng.normal(size=3)
            movers.append(
                Mover(
                    Box(name=f"box{len(movers)}", size=tuple(size.tolist())),
                    speed,
                    where,
                    speed * direction / np.linalg.norm(direction),
                    steer=hunting if hunters else reflected(centre, 1.1, 0.30),
                )
            )
    positions = [dict(zip(names, z.tolist(), strict=True)) for z in zs]
    return (positions[0], JointsGoal(positions[1])), movers


def _tuples(box: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(map(float, values)) for name, values in box.items()}
