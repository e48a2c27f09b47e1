"""Plans with ends at and near the joints' limits, and the largest excess of the curve that a reply describes.

Limits of positions are read from the URDF here, and the extrema of the cubics are found in closed form: nothing of what
plans or certifies has a part in it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from guidefield.collision.world import World
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import JointLimits, JointsGoal, PlaneConstraint, PlanRequest, PoseGoal, RobotReference
from guidefield.messages.scene import Scene, Sphere
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import configuration_to_wire
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import build

LIMITED = ("revolute", "prismatic")
EXACT = 1e-9  # a position may be beyond its limit by this, for rounding [rad or m]
RATES = 1e-9  # a velocity or an acceleration may be above its limit by this share, for rounding
SECONDS = 30.0  # how long a plan may take [s]
DRAWS = 60  # ends that are drawn until one is free
SHARES = {
    "ends": 0.7,
    "mixed": 0.3,
    "pose": 0.4,
    "jerk": 0.6,
    "unrelaxed": 0.6,
    "spheres": 0.4,
    "middle": 0.0,
    "plane": 0.4,
    "moving": 0.0,
    "speeding up": 0.0,
}
"""Kinds of plans, and which share of their joints begin and end at a limit."""
MOVING_JERK = 120.0  # limit of jerk of motions that begin and end in motion [rad/s³ or m/s³]
PLANE_TOLERANCE = 0.1  # how far the tip may be from a plane that it has to stay near [m]
MIDDLE = 0.8  # the other joints are within this share of their range, about its middle


@dataclass(frozen=True)
class Case:
    """A plan that is asked for.

    Attributes:
        kind: One of `SHARES`.
        request: What is asked.
        group: What moves.
    """

    kind: str
    request: PlanRequest
    group: PlanningGroup


@dataclass(frozen=True)
class Excess:
    """By how much a motion is beyond limits, the worst over its joints; nothing beyond them is negative or 0.

    Attributes:
        position: [rad or m].
        joint: The joint of which that is.
        velocity, acceleration, jerk: Shares of the limits, less 1; jerk inside pieces only.
    """

    position: float
    joint: str
    velocity: float
    acceleration: float
    jerk: float

    @property
    def none(self) -> bool:
        """Whether every limit is kept, but for rounding."""
        return self.position <= EXACT and max(self.velocity, self.acceleration, self.jerk) <= RATES


def cases(reference: RobotReference, robot: RobotModel, seed: int, kinds: tuple[str, ...]) -> Iterator[Case]:
    """A plan of each kind for a robot, where free ends are found."""
    actuated = [joint.name for joint in robot.joints if joint.mimic is None]
    if not actuated:
        return
    whole_body = not isinstance(reference, str)
    group = select(robot, actuated if whole_body else None, None, robot.rest, pin.SE3.Identity())
    if not group.limited:
        return
    for kind in kinds:
        rng = np.random.default_rng([seed, list(SHARES).index(kind)])
        spheres = _spheres(group, rng) if kind == "spheres" else []
        world = World.build(group, build(Scene(name="spheres", obstacles=list(spheres))))
        ends = [free_end(world, SHARES[kind], rng) for _ in range(2)]
        if ends[0] is None or ends[1] is None:
            continue
        start, goal = (configuration_to_wire(group.joints, q) for q in ends if q is not None)
        more: dict[str, object] = {}
        if kind == "jerk":
            more["limits"] = {j.name: JointLimits(jerk=float(10.0 * j.acceleration[0])) for j in group.joints}
        if kind == "plane":
            if not group.is_euclidean:
                continue
            more["path_constraints"] = [_plane(group, [q for q in ends if q is not None], rng)]
        if kind in ("moving", "speeding up"):
            if not group.is_euclidean or any(joint.nq > 1 for joint in group.joints):
                continue
            more |= _in_motion(group, rng, rising=kind == "speeding up")
        if kind in ("unrelaxed", "mixed"):
            more["optimization_iterations"] = 0 if kind == "unrelaxed" else 3
        request = PlanRequest(
            robot=reference,
            scene=Scene(name="spheres", obstacles=list(spheres)),
            group=[joint.name for joint in group.joints],
            tip=group.tip,
            start=start,
            goal=_pose(group, ends[1]) if kind == "pose" else JointsGoal(positions=goal),
            guide_planes=[],
            allowed_planning_time=SECONDS,
            recording="off",
            seed=seed,
            **more,
        )
        yield Case(kind, request, group)


def free_end(world: World, share: float, rng: np.random.Generator) -> np.ndarray | None:
    """A free configuration of which about a share of the joints are at a limit; fewer where that is never free."""
    group = world.group
    limited = np.isfinite(group.lower) & np.isfinite(group.upper)
    for draw in range(DRAWS):
        z = group.to_local(group.random(rng))
        lower, upper = np.where(limited, group.lower, 0.0), np.where(limited, group.upper, 0.0)
        inner = 0.5 * (lower + upper) + 0.5 * MIDDLE * (upper - lower) * rng.uniform(-1.0, 1.0, group.nv)
        end = np.where(rng.random(group.nv) < 0.5, group.lower, group.upper)
        at = rng.random(group.nv) < share * (1.0 - draw / DRAWS)
        z[limited] = np.where(at, end, inner)[limited]
        if not world.in_collision(group.expand_from_local(z)):
            return group.from_local(z)
    return None


def excess(reply: PlanReply, case: Case, urdf: str) -> Excess:
    """By how much the curve of a reply's knots is beyond limits, exactly."""
    assert reply.trajectory is not None, "only motions are judged"
    low, high, speed, acceleration, jerk = extremes(*columns(reply))
    by_name = {name: column for column, name in enumerate(reply.velocity_names) if "." not in name}
    worst, joint = -np.inf, ""
    for name, (lower, upper, scale, offset, source) in ranges(urdf).items():
        if source in by_name:
            ends = scale * low[by_name[source]] + offset, scale * high[by_name[source]] + offset
            beyond = max(lower - min(ends), max(ends) - upper)
            worst, joint = max((worst, joint), (beyond, name))
    group, asked = case.group, case.request.limits
    rates = [c for c, name in enumerate(reply.velocity_names) if "." not in name]
    limits = {name: one.jerk for name, one in asked.items() if one.jerk is not None}
    jerks = np.array([limits.get(name, np.inf) for name in reply.velocity_names])
    if "." in "".join(reply.velocity_names):  # of joints of several coordinates knots have tangents, not derivatives
        jerks[:] = np.inf
    return Excess(
        float(worst),
        joint,
        float((speed[rates] / group.velocity_limits[rates]).max(initial=0.0)) - 1.0,
        float((acceleration[rates] / group.acceleration_limits[rates]).max(initial=0.0)) - 1.0,
        float((jerk[rates] / jerks[rates]).max(initial=0.0)) - 1.0,
    )


def columns(reply: PlanReply) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (n,), positions and velocities (n, c) of a reply; of joints of several coordinates the positions are 0."""
    assert reply.trajectory is not None, "only motions have columns"
    at = {name: column for column, name in enumerate(reply.position_names)}
    rows = np.array(reply.trajectory.positions)
    positions = np.zeros((len(rows), len(reply.velocity_names)))
    for column, name in enumerate(reply.velocity_names):
        if name in at:
            positions[:, column] = rows[:, at[name]]
    order = [at.get(name, -1) for name in reply.velocity_names]
    assert all(a < 0 or "." not in name for a, name in zip(order, reply.velocity_names, strict=True))
    return np.array(reply.trajectory.times), positions, np.array(reply.trajectory.velocities)


def extremes(times: np.ndarray, positions: np.ndarray, velocities: np.ndarray) -> tuple[np.ndarray, ...]:
    """Exact extremes of every column of a cubic Hermite curve.

    Args:
        times: Shape (n,), increasing [s].
        positions: Shape (n, c) [rad or m].
        velocities: Shape (n, c) [rad/s or m/s].

    Returns:
        Least and largest position, largest |velocity|, |acceleration| and |jerk|, each of shape (c,).
    """
    if len(times) == 1:
        still = np.zeros(positions.shape[1])
        return positions[0], positions[0], np.abs(velocities[0]), still, still
    h = np.diff(times)[:, None]
    p, v, w, mean = positions[:-1], velocities[:-1], velocities[1:], np.diff(positions, axis=0) / h
    second, third = (3.0 * mean - 2.0 * v - w) / h, (v + w - 2.0 * mean) / h**2
    with np.errstate(all="ignore"):
        root = np.sqrt(second**2 - 3.0 * third * v)
        # zeros of v + 2 second t + 3 third t^2, each in the form that doesn't cancel
        big = -(second + np.where(second < 0.0, -root, root))
        stops = np.stack([big / (3.0 * third), v / big])
    stops = np.clip(np.where(np.isfinite(stops), stops, 0.0), 0.0, h)
    there = p + stops * (v + stops * (second + stops * third))
    every = np.concatenate([there.reshape(-1, positions.shape[1]), positions])
    with np.errstate(all="ignore"):
        turn = -second / (3.0 * third)
    turn = np.clip(np.where(np.isfinite(turn), turn, 0.0), 0.0, h)
    fastest = np.abs(v + turn * (2.0 * second + 3.0 * turn * third)).max(axis=0)
    accelerations = np.maximum(np.abs(2.0 * second), np.abs(2.0 * second + 6.0 * third * h)).max(axis=0)
    return (
        every.min(axis=0),
        every.max(axis=0),
        np.maximum(fastest, np.abs(velocities).max(axis=0)),
        accelerations,
        np.abs(6.0 * third).max(axis=0),
    )


def ranges(urdf: str) -> dict[str, tuple[float, float, float, float, str]]:
    """Of every joint with limits: these, and multiplier, offset and name of the joint that it follows, or its own."""
    limits: dict[str, tuple[float, float]] = {}
    follows: dict[str, tuple[str, float, float]] = {}
    for joint in ElementTree.fromstring(urdf).iter("joint"):
        name, limit, mimic = joint.get("name", ""), joint.find("limit"), joint.find("mimic")
        if limit is not None and joint.get("type") in LIMITED:
            limits[name] = float(limit.get("lower", 0.0)), float(limit.get("upper", 0.0))
        if mimic is not None:
            terms = float(mimic.get("multiplier", 1.0)), float(mimic.get("offset", 0.0))
            follows[name] = mimic.get("joint", ""), *terms
    found = {}
    for name, (lower, upper) in limits.items():
        source, scale, offset = name, 1.0, 0.0
        while source in follows:
            source, factor, more = follows[source]
            scale, offset = scale * factor, offset + scale * more
        own = limits.get(source, (-np.inf, np.inf))  # one that turns on and on is bound by its mimic joints alone
        if source == name or _can_be_kept(own, (lower, upper), scale, offset):
            found[name] = lower, upper, scale, offset, source
    return found


def _can_be_kept(source: tuple[float, float], own: tuple[float, float], scale: float, offset: float) -> bool:
    """Return whether a mimic joint is within its limits somewhere in its source joint's range."""
    if scale == 0.0:
        return False
    ends = sorted((scale * source[0] + offset, scale * source[1] + offset))
    return max(ends[0], own[0]) <= min(ends[1], own[1])


def _pose(group: PlanningGroup, q: np.ndarray | None) -> PoseGoal:
    """The tip's pose at a configuration."""
    assert q is not None, "the end is known"
    tip = Kinematics(group).frame_placement(group.expand(q), group.tip_id)
    quaternion = pin.Quaternion(tip.rotation).coeffs()
    return PoseGoal(position=tuple(tip.translation.tolist()), quaternion_xyzw=tuple(quaternion.tolist()))


def _in_motion(group: PlanningGroup, rng: np.random.Generator, rising: bool) -> dict[str, object]:
    """Velocities at both ends, and accelerations at the start; rising ones need part of the jerk limit."""
    begins, ends = rng.uniform(-0.3, 0.3, (2, group.nv)) * group.velocity_limits
    most = np.sqrt(MOVING_JERK * np.abs(begins)) if rising else 0.3 * group.acceleration_limits
    rise = rng.uniform(0.0, 1.0, group.nv) * np.minimum(most, group.acceleration_limits)
    rise = np.sign(begins) * rise if rising else rise * rng.choice([-1.0, 1.0], group.nv)
    named = [dict(zip((j.name for j in group.joints), row.tolist(), strict=True)) for row in (begins, rise, ends)]
    return {
        "limits": {joint.name: JointLimits(jerk=MOVING_JERK) for joint in group.joints},
        "start_velocities": named[0],
        "start_accelerations": named[1],
        "end_velocities": named[2],
    }


def _plane(group: PlanningGroup, ends: list[np.ndarray], rng: np.random.Generator) -> PlaneConstraint:
    """A plane through where the tip is at both ends, near which it has to stay."""
    first, last = (Kinematics(group).tip_position(group.expand(q)) for q in ends)
    normal = np.cross(last - first + 1e-3 * rng.normal(size=3), rng.normal(size=3))
    return PlaneConstraint(
        frame=group.tip, point=tuple(first.tolist()), normal=tuple(normal.tolist()), tolerance=PLANE_TOLERANCE
    )


def _spheres(group: PlanningGroup, rng: np.random.Generator) -> list[Sphere]:
    """Some spheres within the tip's reach."""
    kinematics = Kinematics(group)
    reach = [kinematics.tip_position(group.expand(group.random(rng))) for _ in range(5)]
    return [Sphere(name=f"s{k}", radius=0.05, position=tuple(at.tolist())) for k, at in enumerate(reach)]
