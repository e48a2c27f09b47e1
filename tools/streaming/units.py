"""Units of doubt about streams: everything in them is drawn from one seed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import coal
import msgspec
import numpy as np

from guidefield.errors import InvalidConfiguration
from guidefield.messages.conditions import AttachedObject, JointLimits
from guidefield.messages.scene import Box, Capsule, Cylinder, HalfSpace, Mesh, PointCloud, Scene, Sphere
from guidefield.messages.streams import Deviation, StreamObstacle, StreamOpen
from guidefield.messages.values import JointsGoal, Placement
from guidefield.robot.catalog import Catalog
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import build
from guidefield.stream.stream import CertifiedStream
from streaming.movers import OCTAHEDRON, Mover, hunting, reflected
from streaming.simulation import Faults, Outcome, simulate

ROBOTS = ("ur5", "panda", "xarm7")

SLIDING = "tiago"
"""Its torso slides; the arm's joints turn."""

SLIDES = ["torso_lift_joint", *(f"arm_{k}_joint" for k in range(1, 8))]

HELD = 100
"""So often are configurations that are free with what is held looked for, before nothing is."""

LONGEST = 8.0
"""A unit lasts so long [s]."""

_CATALOG = Catalog()


def unit(seed: int, longest: float = LONGEST) -> Outcome:
    """One stream, judged from outside; it lasts so long at most [s]."""
    rng = np.random.default_rng([19, seed])
    name = ROBOTS[int(rng.integers(len(ROBOTS)))]
    more = np.random.default_rng([20, seed])  # what was drawn before stays as it was
    group = None
    if more.random() < 0.1:
        name, group = SLIDING, SLIDES
    robot = _CATALOG.load(name)
    scene = build(Scene("floor", obstacles=[HalfSpace(name="floor", normal=(0.0, 0.0, 1.0), offset=-0.05)]))
    plain = StreamOpen(name, "floor", group=group)
    with CertifiedStream(plain, robot, scene) as stream:
        free = _free(stream, rng)
    names = stream.group.position_names
    held = _held(plain, robot, scene, stream.group.tip, more)
    if held:
        with CertifiedStream(msgspec.structs.replace(plain, attached_objects=held), robot, scene) as stream:
            free = _free(stream, more)
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
    movers = [disguise(one, more) for one in movers]
    faults.drift = float(more.choice([0.0, -2.0, 2.0])) * clock / LONGEST
    request = StreamOpen(
        robot=name,
        group=group,
        attached_objects=held,
        limits={one: JointLimits(jerk=float(more.uniform(5.0, 500.0))) for one in names if more.random() < 0.1},
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
    if more.random() < 0.3:
        request = msgspec.structs.replace(request, tracking_tolerance=float(more.choice([0.002, 0.01])))
        faults.astray = request.tracking_tolerance
    place = coal.Transform3s(np.eye(3), np.zeros(3))
    resting = [("floor", coal.Halfspace(np.array([0.0, 0.0, 1.0]), -0.05), place)]
    with CertifiedStream(request, robot, scene) as stream:
        # a robot that stands at its goal shows nothing: with five goals it moves for 1.7 times as long as with two
        goals += [dict(zip(names, z.tolist(), strict=True)) for z in _free(stream, np.random.default_rng([21, seed]))]
        changes = [(LONGEST / len(goals) * k, JointsGoal(goal)) for k, goal in enumerate(goals) if k]
        return simulate(
            stream, movers, resting, longest, rng, faults, charged=False, deviating=deviating, to_the_end=True,
            goals=changes,
        )  # fmt: skip


def _free(stream: CertifiedStream, rng: np.random.Generator) -> np.ndarray:
    """Three configurations that touch nothing that rests, shape (3, nv)."""
    found: list[np.ndarray] = []
    while len(found) < 3:
        z = stream.group.random(rng)
        if stream._paths.find_free(z[None]).all():
            found.append(z)
    return np.array(found)


def _mover(index: int, rng: np.random.Generator) -> Mover:
    """Something that hunts, or drifts and turns."""
    name, size = f"mover{index}", rng.uniform(0.04, 0.12)
    kinds: list[Any] = [
        Box(name=name, size=(size, 2.0 * size, size)),
        Sphere(name=name, radius=size),
        Capsule(name=name, radius=0.5 * size, length=2.0 * size),
        Cylinder(name=name, radius=size, length=size),
    ]
    message = kinds[int(rng.integers(len(kinds)))]
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    where = np.array([0.0, 0.0, 0.5]) + rng.uniform(0.8, 1.2) * direction
    where[2] = abs(where[2])
    speed = float(rng.uniform(0.1, 1.2))
    hunts = rng.random() < 0.5
    turns = not isinstance(message, Sphere) and rng.random() < 0.5
    return Mover(
        message,
        speed,
        where,
        -speed * direction,
        spin=rng.normal(size=3) if turns else np.zeros(3),
        steer=hunting if hunts else reflected(np.array([0.0, 0.0, 0.5]), 1.3, 0.3),
    )


def disguise(mover: Mover, rng: np.random.Generator) -> Mover:
    """The same, or a mesh or a cloud in its place; it moves as before."""
    drawn = rng.random()
    if drawn > 0.3:
        return mover
    size = float(rng.uniform(0.05, 0.12))
    if drawn > 0.15:
        vertices = OCTAHEDRON[0] * rng.uniform(0.5, 1.0, 3) * size
        mesh = Mesh(name=mover.name, vertices=vertices.tolist(), triangles=OCTAHEDRON[1].tolist())
        return replace(mover, message=mesh)
    points = rng.uniform(-size, size, (40, 3)).tolist()
    return replace(mover, message=PointCloud(name=mover.name, points=points, radius=0.02))


def _held(
    plain: StreamOpen, robot: RobotModel, scene: Any, link: str, rng: np.random.Generator
) -> list[AttachedObject]:
    """A ball or a box that the tip holds, or nothing; the robot has room for it."""
    if rng.random() > 0.3:
        return []
    direction = rng.normal(size=3)
    place = Placement(tuple((0.15 * direction / np.linalg.norm(direction)).tolist()))
    size = float(rng.uniform(0.03, 0.08))
    shape = Sphere(name="held", radius=size) if rng.random() < 0.5 else Box(name="held", size=(size, size, 2.0 * size))
    held = [AttachedObject(shape, link, place)]
    try:
        stream = CertifiedStream(msgspec.structs.replace(plain, attached_objects=held), robot, scene)
    except InvalidConfiguration:  # it touches the hand wherever the joints are
        return []
    with stream:
        zs = [stream.group.random(rng) for _ in range(HELD)]
        fits = sum(bool(stream._paths.find_free(z[None])[0]) for z in zs) >= 3
    return held if fits else []
