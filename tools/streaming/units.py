"""Units of doubt about streams: everything in them is drawn from one seed."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from guidefield.messages.goals import JointsGoal
from guidefield.messages.scene import Box, Capsule, Cylinder, HalfSpace, Scene, Sphere
from guidefield.messages.streams import Deviation, StreamObstacle, StreamOpen
from guidefield.robot.catalog.catalog import Catalog
from guidefield.scene.scene import build
from guidefield.stream.stream import CertifiedStream
from streaming.movers import Mover, hunting, reflected
from streaming.simulation import Faults, Outcome, simulate

ROBOTS = ("ur5", "panda", "xarm7")

LONGEST = 8.0
"""A unit lasts so long [s]."""

_CATALOG = Catalog()


def unit(seed: int, longest: float = LONGEST) -> Outcome:
    """One stream, judged from outside; it lasts so long at most [s]."""
    rng = np.random.default_rng([19, seed])
    name = ROBOTS[int(rng.integers(len(ROBOTS)))]
    robot = _CATALOG.load(name)
    scene = build(Scene("floor", obstacles=[HalfSpace(name="floor", normal=(0.0, 0.0, 1.0), offset=-0.05)]))
    with CertifiedStream(StreamOpen(name, "floor"), robot, scene) as stream:
        free = _free(stream, rng)
    names = stream.group.position_names
    start, *goals = (dict(zip(names, z.tolist(), strict=True)) for z in free)
    movers = [_mover(k, rng) for k in range(int(rng.integers(1, 6)))]
    deviating = bool(rng.random() < 0.2) and not any(one.steer is hunting for one in movers)
    clock = float(rng.choice([0.0, 0.005]))
    faults = Faults(
        lost=float(rng.choice([0.0, 0.1, 0.5])),
        dropped=float(rng.choice([0.0, 0.2])),
        delayed=float(rng.choice([0.0, 0.05])),
        clock=clock,
        silent=(2.0, 2.3) if rng.random() < 0.3 else (np.inf, np.inf),
    )
    request = StreamOpen(
        robot=name,
        scene="floor",
        goal=JointsGoal(goals[0]),
        start=start,
        obstacles=[
            # who turns about the middle keeps the declared rate; rounding of a step is granted
            StreamObstacle(one.message, one.largest * (1.0 + 1e-9), float(np.linalg.norm(one.spin)) * (1.0 + 1e-9))
            for one in movers
        ],
        # what is reflected leaves the velocity that was observed
        assume=Deviation(2.0 * max(one.largest for one in movers), 7.0) if deviating else "largest_speed",
        clock_error=clock,
        tracking_tolerance=float(rng.choice([0.0, 0.002])),
        latency=float(rng.choice([0.01, 0.02, 0.04])),
        piece=0.05,
        seed=seed,
    )
    faults.epoch = float(rng.choice([0.0, 9e8]))
    changes = [(LONGEST / 3.0 * (k + 1), JointsGoal(goal)) for k, goal in enumerate(goals[1:])]
    place = coal.Transform3s(np.eye(3), np.zeros(3))
    resting = [("floor", coal.Halfspace(np.array([0.0, 0.0, 1.0]), -0.05), place)]
    with CertifiedStream(request, robot, scene) as stream:
        return simulate(
            stream, movers, resting, longest, rng, faults, charged=False, deviating=deviating, to_the_end=True,
            goals=changes,
        )  # fmt: skip


def _free(stream: CertifiedStream, rng: np.random.Generator) -> np.ndarray:
    """Three configurations that touch nothing that rests, shape (3, nv)."""
    found: list[np.ndarray] = []
    while len(found) < 3:
        z = stream.group.random(rng)
        if stream._room.resting_free(z[None]).all():
            found.append(z)
    return np.array(found)


def _mover(index: int, rng: np.random.Generator) -> Mover:
    """Something that hunts, or drifts and turns."""
    name, size = f"mover{index}", rng.uniform(0.04, 0.12)
    kinds: list[tuple[Any, Any]] = [
        (Box(name=name, size=(size, 2.0 * size, size)), coal.Box(size, 2.0 * size, size)),
        (Sphere(name=name, radius=size), coal.Sphere(size)),
        (Capsule(name=name, radius=0.5 * size, length=2.0 * size), coal.Capsule(0.5 * size, 2.0 * size)),
        (Cylinder(name=name, radius=size, length=size), coal.Cylinder(size, size)),
    ]
    message, shape = kinds[int(rng.integers(len(kinds)))]
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    where = np.array([0.0, 0.0, 0.5]) + rng.uniform(0.8, 1.2) * direction
    where[2] = abs(where[2])
    speed = float(rng.uniform(0.1, 1.2))
    hunts = rng.random() < 0.5
    turns = not isinstance(message, Sphere) and rng.random() < 0.5
    return Mover(
        name,
        message,
        shape,
        speed,
        where,
        -speed * direction,
        spin=rng.normal(size=3) if turns else np.zeros(3),
        steer=hunting if hunts else reflected(np.array([0.0, 0.0, 0.5]), 1.3, 0.3),
    )
