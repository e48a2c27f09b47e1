"""Certified motions that are changed a little, many of them to within micrometres of contact or of a limit."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from doubting import scenery
from doubting.asked import constraint, tip_poses
from doubting.compare import asked_curve, continuous, farthest, names_of
from doubting.curve import Curve
from doubting.judge import Judge, Sampled
from doubting.limits import RATES, standing
from doubting.loaded import Loaded, as_values
from guidefield.messages import scene as messages
from guidefield.messages.certify_request import GivenTrajectory
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import (
    CertifyRequest,
    JointLimits,
    OrientationCone,
    PlanRequest,
)
from guidefield.messages.values import Placement

SECONDS = 2.0
"""Time that a judgement may take [s]."""
replaced = msgspec.structs.replace


@dataclass(frozen=True, eq=False)
class Base:
    """A certified motion that is changed.

    Attributes:
        loaded: The robot.
        request: The motion as a certify request.
        curve: Its curve.
        judge: Who sampled it.
        sampled: What was found.
    """

    loaded: Loaded
    request: CertifyRequest
    curve: Curve
    judge: Judge
    sampled: Sampled

    @property
    def obstacles(self) -> list[messages.Obstacle]:
        """Those of the request."""
        return self.request.scene.obstacles


def base_of(loaded: Loaded, request: PlanRequest, reply: PlanReply, sampled: Sampled, judge: Judge) -> Base:
    """The motion of a plan's reply as a certify request."""
    one = reply.trajectory
    asked = CertifyRequest(
        robot=request.robot,
        scene=request.scene,
        trajectory=GivenTrajectory(one.positions, one.times, one.velocities),
        robot_placement=request.robot_placement,
        group=request.group,
        start=request.start,
        position_names=reply.position_names,
        velocity_names=reply.velocity_names,
        min_clearance=request.min_clearance,
        attached_objects=request.attached_objects,
        allowed_collisions=request.allowed_collisions,
        path_constraints=request.path_constraints,
        limits=request.limits,
        max_velocity_scaling_factor=request.max_velocity_scaling_factor,
        max_acceleration_scaling_factor=request.max_acceleration_scaling_factor,
        leave_start_contact=request.leave_start_contact,
        allowed_time=SECONDS,
        recording="off",
    )
    return Base(loaded, asked, asked_curve(loaded, asked), judge, sampled)


Mutation = Callable[[np.random.Generator, Base], CertifyRequest | None]


def draw_mutants(rng: np.random.Generator, base: Base, count: int) -> Iterator[tuple[str, CertifyRequest]]:
    """So many changed motions, by how they were changed; the first is as it was."""
    yield "same", base.request
    made = 1
    for _ in range(4 * count):
        if made >= count:
            return
        name = str(rng.choice(list(MUTATIONS), p=SHARES))
        one = MUTATIONS[name](rng, base)
        if one is not None and rng.random() < 0.2:  # a second change on top
            again = str(rng.choice(list(MUTATIONS), p=SHARES))
            other = MUTATIONS[again](rng, with_request(base, one)) if again in LIGHT else None
            one, name = (other, f"{name}+{again}") if other is not None else (one, name)
        if one is not None:
            made += 1
            yield name, one


def with_request(base: Base, request: CertifyRequest) -> Base:
    """The same with another request; what was sampled is that of the first."""
    return Base(base.loaded, request, asked_curve(base.loaded, request), base.judge, base.sampled)


def small(rng: np.random.Generator, least: float, most: float) -> float:
    """A number of either sign whose size is drawn by its order of magnitude, from powers of ten."""
    return float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(least, most))


def _scalars(base: Base) -> list[tuple[int, int, str]]:
    """Position column, velocity column and name of joints of one coordinate."""
    names = base.request.position_names or []
    columns, found = {name: k for k, name in enumerate(names)}, []
    for part in base.curve.parts:
        if part.width == 1:
            found.append((columns[part.name], part.at.start, part.name))
    return found


Knots = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Times, positions and velocities of a motion's knots."""


def changes_knots(change: Callable[..., Knots | None]) -> Mutation:
    """Make a mutation of a change of a motion's knots; a motion that has none isn't changed."""

    @functools.wraps(change)
    def mutation(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
        given = base.request.trajectory
        if given is None or given.velocities is None or given.times is None:
            return None
        knots = np.array(given.times), np.array(given.positions, float), np.array(given.velocities, float)
        changed = change(rng, base, knots)
        if changed is None:
            return None
        times, positions, velocities = (one.tolist() for one in changed)
        return replaced(base.request, trajectory=GivenTrajectory(positions, times, velocities))

    return mutation


@changes_knots
def shifted(rng: np.random.Generator, base: Base, knots: Knots) -> Knots | None:
    """A knot, or all of them, with a joint elsewhere."""
    times, positions, velocities = knots
    scalars = _scalars(base)
    if not scalars:
        return None
    rows = slice(None) if rng.random() < 0.4 else int(rng.integers(len(times)))
    positions[rows, scalars[rng.integers(len(scalars))][0]] += small(rng, -7.0, -1.0)
    return times, positions, velocities


@changes_knots
def hurried(rng: np.random.Generator, _base: Base, knots: Knots) -> Knots | None:
    """Velocities of knots changed."""
    times, positions, velocities = knots
    rows = slice(None) if rng.random() < 0.5 else int(rng.integers(len(times)))
    velocities[rows] *= 1.0 + small(rng, -6.0, 0.5)
    return times, positions, velocities


@changes_knots
def scaled(rng: np.random.Generator, base: Base, knots: Knots) -> Knots | None:
    """Times stretched until a limit of a rate is just kept, or just not."""
    times, positions, velocities = knots
    shares = standing(base.loaded, base.request, base.curve).shares
    rate = str(rng.choice(RATES))
    if not shares.get(rate, 0.0) > 0.0:
        return None
    factor = shares[rate] ** (1.0 / (1 + RATES.index(rate))) * (1.0 + small(rng, -9.0, -2.0))
    if not 1e-2 < factor < 1e2:
        return None
    return times * factor, positions, velocities / factor


def limited(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
    """A limit of a rate that is just what the motion needs, or just not."""
    extremes = standing(base.loaded, base.request, base.curve).extremes
    if not extremes:
        return None
    joint = str(rng.choice(list(extremes)))
    rate = int(rng.integers(3))
    value = extremes[joint][2 + rate] * (1.0 + small(rng, -9.0, -2.0))
    if not 1e-6 < value < 1e6:
        return None
    before = base.request.limits.get(joint, JointLimits())
    mine = replaced(before, **{RATES[rate]: value})
    return replaced(
        base.request,
        limits={**base.request.limits, joint: mine},
        max_velocity_scaling_factor=1.0,
        max_acceleration_scaling_factor=1.0,
    )


@changes_knots
def to_limit(rng: np.random.Generator, base: Base, knots: Knots) -> Knots | None:
    """All knots of a joint moved until it just reaches a limit of its position, or just exceeds it."""
    times, positions, velocities = knots
    extremes = standing(base.loaded, base.request, base.curve).extremes
    ranged = [(k, name) for k, _, name in _scalars(base) if _range(base, name) is not None]
    if not ranged or not extremes:
        return None
    column, name = ranged[rng.integers(len(ranged))]
    bounds, (low, high, *_) = _range(base, name), extremes[name]
    by = bounds[0] - low if rng.random() < 0.5 else bounds[1] - high
    positions[:, column] += by + small(rng, -13.0, -3.0)
    return times, positions, velocities


def _range(base: Base, name: str) -> tuple[float, float] | None:
    joint = base.loaded.model.joint(name)
    bounds = float(joint.lower[0]), float(joint.upper[0])
    return bounds if np.isfinite(bounds).all() else None


def _resting(base: Base) -> list[int]:
    return [k for k, one in enumerate(base.obstacles) if one.trajectory is None]


def _with_obstacle(base: Base, index: int, one: messages.Obstacle) -> CertifyRequest:
    obstacles = list(base.obstacles)
    obstacles[index:] = [one, *obstacles[index + 1 :]]
    return replaced(base.request, scene=replaced(base.request.scene, obstacles=obstacles))


def pushed(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
    """The obstacle that is nearest, moved until it is just as far as required, or just not."""
    nearest = base.sampled.obstacle
    resting = _resting(base)
    mine = [k for k in resting if nearest.pair is not None and base.obstacles[k].name == nearest.pair[1]]
    if not mine:
        return None
    (distance,) = base.judge.along(base.curve, np.array([nearest.time]), np.array([nearest.index]))
    away = base.judge.towards_first(nearest.index)
    by = away * (distance - base.request.min_clearance + small(rng, -6.0, -3.0))
    if not np.isfinite(by).all() or np.linalg.norm(by) > 2.0:
        return None
    return _with_obstacle(base, mine[0], scenery.shift(base.obstacles[mine[0]], by))


def jogged(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
    """An obstacle moved a little, anywhere."""
    resting = _resting(base)
    if not resting:
        return None
    index = resting[rng.integers(len(resting))]
    by = rng.normal(size=3)
    by *= abs(small(rng, -6.0, -1.0)) / np.linalg.norm(by)
    return _with_obstacle(base, index, scenery.shift(base.obstacles[index], by))


def added(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
    """One more obstacle, just as far from where the robot is at some time as is required, or just not."""
    times = np.array([float(rng.uniform(base.curve.times[0], base.curve.times[-1]))])
    values = {**as_values(base.request.start), **base.curve.at(times)}
    base.judge.distances_at(values)
    centres = base.judge.moving_centres()
    if not len(centres):
        return None
    at = centres[rng.integers(len(centres))] + 0.3 * rng.normal(size=3)
    one = scenery.obstacle(rng, str(rng.choice(scenery.KINDS)), "added", at, float(rng.uniform(0.02, 0.4)))
    setting: dict[str, Any] = {
        "placement": base.request.robot_placement,
        "attached": base.request.attached_objects,
        "min_clearance": base.request.min_clearance,
        "still": as_values(base.request.start),
    }
    planned = names_of(base.request.position_names or [])
    margin, away, pair = scenery.find_closest(base.loaded.judge(planned, obstacles=[one], **setting), values)
    if pair < 0 or not 0.0 < margin < 3.0:
        return None
    one = scenery.shift(one, away * (margin + small(rng, -6.0, -2.0)))
    obstacles = [*base.obstacles, one]
    return replaced(base.request, scene=replaced(base.request.scene, obstacles=obstacles))


def launched(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
    """An obstacle that rests is made to move a little."""
    can = [k for k in _resting(base) if not isinstance(base.obstacles[k], messages.HalfSpace | messages.PointCloud)]
    if not can or base.request.trajectory is None or base.request.leave_start_contact:
        return None
    index = can[rng.integers(len(can))]
    one, end = base.obstacles[index], max(float(base.curve.times[-1]), 0.1)
    times = np.sort(rng.uniform(0.0, end, 3)) + 1e-3 * np.arange(3)
    place = getattr(one, "position", (0.0, 0.0, 0.0))
    steps = [np.array(place) + abs(small(rng, -4.0, -1.0)) * rng.normal(size=3) for _ in times]
    turn = getattr(one, "quaternion_xyzw", (0.0, 0.0, 0.0, 1.0))
    flight = messages.ObstacleTrajectory(times.tolist(), [Placement(tuple(p.tolist()), turn) for p in steps])
    return _with_obstacle(base, index, replaced(one, trajectory=flight))


def required(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
    """A clearance asked for that the motion just keeps, or just not."""
    nearest = base.sampled.obstacle.distance
    asked = nearest + small(rng, -6.0, -3.0)
    return replaced(base.request, min_clearance=asked) if 0.0 <= asked < 1.0 else None


def constrained(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
    """A path constraint that the motion just keeps, or just not."""
    if any(part.width > 1 for part in base.curve.parts) or base.judge.moves:
        return None
    ends = [
        {**base.request.start, **{name: float(values[0]) for name, values in base.curve.at(np.array([t])).items()}}
        for t in base.curve.times[[0, -1]]
    ]
    poses = tip_poses(base.loaded, ends, {"placement": base.request.robot_placement})
    one = constraint(rng, str(rng.choice(base.loaded.subject.links)), poses)
    worst, _ = farthest(base.judge, base.curve, one)
    kept = worst * (1.0 + small(rng, -6.0, -2.0))
    if not 1e-4 < kept < 3.0:
        return None
    field = "half_angle" if isinstance(one, OrientationCone) else "tolerance"
    return replaced(base.request, path_constraints=[replaced(one, **{field: kept})])


def allowed(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
    """The nearest pair may touch; or nothing may any more."""
    pair = (base.sampled.obstacle if rng.random() < 0.5 else base.sampled.own).pair
    if base.request.allowed_collisions:
        return replaced(base.request, allowed_collisions=[])
    return None if pair is None else replaced(base.request, allowed_collisions=[pair])


def placed(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
    """The robot stands a little elsewhere."""
    by = rng.normal(size=3)
    by *= abs(small(rng, -6.0, -1.5)) / np.linalg.norm(by)
    before = base.request.robot_placement
    return replaced(
        base.request, robot_placement=replaced(before, position=tuple((np.array(before.position) + by).tolist()))
    )


def holding(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
    """Something is held elsewhere, or is held at all."""
    if base.request.attached_objects:
        one = base.request.attached_objects[0]
        at = np.array(one.placement.position) + abs(small(rng, -6.0, -1.5)) * rng.normal(size=3)
        moved = replaced(one, placement=replaced(one.placement, position=tuple(at.tolist())))
        return replaced(base.request, attached_objects=[moved])
    one = scenery.draw_held(rng, str(rng.choice(base.loaded.subject.links)))
    return replaced(base.request, attached_objects=[one])


def straight(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
    """Straight pieces between some places of the motion, without time."""
    if base.judge.moves:
        return None
    rows = _rows(base, np.linspace(base.curve.times[0], base.curve.times[-1], int(rng.integers(2, 30))))
    return replaced(base.request, trajectory=None, velocity_names=None, path=rows)


def resampled(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
    """Samples of the motion, by their times or a step, and the curve that is laid through them."""
    count = int(rng.integers(4, 60))
    step = float(base.curve.times[-1] - base.curve.times[0]) / (count - 1)
    if base.judge.moves or step < 1e-3:
        return None
    times = step * np.arange(count)
    rows = _rows(base, base.curve.times[0] + times)
    by_step = bool(rng.random() < 0.5)
    return replaced(
        base.request,
        trajectory=GivenTrajectory(rows, None if by_step else times.tolist()),
        time_step=step if by_step else None,
        velocity_names=None,
        interpolation=str(rng.choice(["spline", "linear"])),
    )


def _rows(base: Base, times: np.ndarray) -> list[list[float]]:
    """Rows of the motion at times, in the columns of its positions."""
    values = base.curve.at(times)
    columns = [values[part.name].reshape(len(times), -1) for part in base.curve.parts]
    return np.hstack(columns).tolist()


def rewritten(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
    """The same motion in other words: columns in another order, whole turns added, quaternions with the other sign."""
    given, names = base.request.trajectory, base.request.position_names
    if given is None or given.velocities is None or base.request.velocity_names is None:
        return None
    times, positions, velocities = np.array(given.times), np.array(given.positions), np.array(given.velocities)
    turning = continuous(base.loaded)
    columns = {name: k for k, name in enumerate(names)}
    for part in base.curve.parts:
        rows = rng.random(len(times)) < 0.3
        if part.name in turning and part.width == 1:
            positions[rows, columns[part.name]] += 2.0 * np.pi * rng.integers(-2, 3, int(rows.sum()))
        if part.width >= 4:
            last = columns[f"{part.name}.qw"]
            positions[np.ix_(rows, range(last - 3, last + 1))] *= -1.0
    order, rates = rng.permutation(len(names)), rng.permutation(velocities.shape[1])
    given = GivenTrajectory(positions[:, order].tolist(), times.tolist(), velocities[:, rates].tolist())
    return replaced(
        base.request,
        trajectory=given,
        position_names=[names[k] for k in order],
        velocity_names=[base.request.velocity_names[k] for k in rates],
    )


@changes_knots
def delayed(rng: np.random.Generator, _base: Base, knots: Knots) -> Knots | None:
    """The same motion, begun at another time: among obstacles that move it is another one."""
    times, positions, velocities = knots
    return times + float(rng.uniform(-1.0, 2.0)), positions, velocities


@changes_knots
def backwards(_rng: np.random.Generator, base: Base, knots: Knots) -> Knots | None:
    """The motion from its end to its start."""
    times, positions, velocities = knots
    if base.request.leave_start_contact:
        return None
    return (times[-1] - times)[::-1], positions[::-1], -velocities[::-1]


@changes_knots
def wild(rng: np.random.Generator, base: Base, knots: Knots) -> Knots | None:
    """Another motion altogether: joints somewhere at each knot, with some velocity."""
    times, positions, velocities = knots
    scalars, count = _scalars(base), int(rng.integers(1, 8))
    times, positions = np.cumsum(rng.uniform(0.05, 1.0, count)), np.repeat(positions[:1], count, axis=0)
    velocities = np.zeros((count, velocities.shape[1]))
    for column, rate, _ in scalars:
        reach = abs(small(rng, -3.0, 0.3))
        positions[:, column] += reach * rng.normal(size=count)
        velocities[:, rate] = reach * rng.normal(size=count)
    return times - times[0], positions, velocities


def renamed(rng: np.random.Generator, base: Base) -> CertifyRequest | None:
    """An obstacle has another name."""
    if not base.obstacles:
        return None
    index = int(rng.integers(len(base.obstacles)))
    return _with_obstacle(base, index, replaced(base.obstacles[index], name="another"))


WEIGHTS: dict[Mutation, float] = {
    shifted: 2.0,
    hurried: 1.0,
    scaled: 1.0,
    limited: 1.0,
    to_limit: 1.0,
    pushed: 4.0,
    jogged: 1.0,
    added: 3.0,
    launched: 0.6,
    required: 3.0,
    constrained: 1.0,
    allowed: 0.7,
    placed: 1.0,
    holding: 1.0,
    straight: 1.0,
    resampled: 1.0,
    wild: 1.5,
    renamed: 0.3,
    rewritten: 1.0,
    delayed: 0.5,
    backwards: 0.5,
}
"""The weight with which each change is drawn."""
MUTATIONS = {one.__name__: one for one in WEIGHTS}
SHARES = np.array(list(WEIGHTS.values())) / sum(WEIGHTS.values())
LIGHT = ("limited", "required", "allowed", "placed", "scaled", "hurried")
"""Changes that may come on top of another."""
