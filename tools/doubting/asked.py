"""Random plan requests: every planner and goal, ends at limits and close to contact, held objects, constraints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from doubting import scenery
from doubting.curve import Curve, Values
from doubting.loaded import Loaded, Wire, as_values
from guidefield.messages import scene as messages
from guidefield.messages.requests import (
    AttachedObject,
    GuidePlaneGoal,
    JointLimits,
    JointSetGoal,
    JointsGoal,
    LineConstraint,
    OrientationCone,
    PathConstraint,
    PlaneConstraint,
    PlanRequest,
    PoseGoal,
)
from guidefield.robot.model.joints import Joint, JointKind

KINDS = {
    "joints": 0.42,
    "tree": 0.18,
    "pose": 0.09,
    "set": 0.05,
    "constraint": 0.07,
    "guided": 0.06,
    "planes": 0.05,
    "moving": 0.05,
    "leave": 0.03,
}
"""Kinds of plans, and how often each is asked for."""
SECONDS = 1.0
"""Time that a plan may take [s]."""
DRAWS = 25
"""Ends that are drawn until one is free."""
ROAM = 0.6
"""Range of a sliding joint without limits [m]."""
SHORT = 0.4
"""Of most motions the goal is within this share of the way to a random one."""
CROWDS = 0.3
"""Among so many of the plans among what moves it is a crowd, of which those that matter are looked at alone."""
OWN_ROOM = 5e-4
"""Distance between links at ends [m]."""


@dataclass(frozen=True)
class Asked:
    """A plan that is asked for.

    Attributes:
        kind: One of `KINDS`.
        request: The request.
        planned: Joints that move.
    """

    kind: str
    request: PlanRequest
    planned: frozenset[str]


def draw_plan(rng: np.random.Generator, loaded: Loaded, seed: int) -> Asked | None:
    """A plan for a robot; None where no free ends were found."""
    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    planned = [joint for joint in loaded.movable if rng.random() > 0.05] or loaded.movable
    names = frozenset(joint.name for joint in planned)
    if kind == "constraint" and any(joint.nv > 1 for joint in planned):
        kind = "joints"
    base = {joint.name: value(rng, joint) for joint in loaded.movable}
    ends = [free(rng, loaded, planned, base) for _ in range(3 if kind == "set" else 2)]
    if any(end is None for end in ends):
        return None
    wires = [end for end in ends if end is not None]
    if rng.random() < 0.6:
        wires = [wires[0], *(_nearer(rng, loaded, wires[0], wire) for wire in wires[1:])]
    setting: dict[str, Any] = {"placement": scenery.placement(rng), "min_clearance": 0.0, "attached": []}
    if rng.random() < 0.35:
        setting["min_clearance"] = float(10.0 ** rng.uniform(-4.0, -1.7))
    if rng.random() < 0.15:
        setting["attached"] = _held(rng, loaded, names, wires)
    values = [as_values(wire) for wire in wires]
    count = int(rng.integers(0, 8))
    middle = as_values(between(rng, loaded, wires[0], wires[1]))
    obstacles = scenery.strew(rng, loaded, names, values, middle, count, **setting)
    more = _more(rng, kind, loaded, planned, wires, setting)
    if kind == "moving":
        obstacles += _flying(rng, loaded, names, values, setting)
    if kind == "leave":
        obstacles += _touching(rng, loaded, names, values, setting)
    allowed = []
    if rng.random() < 0.1 and obstacles:
        link = str(rng.choice(loaded.subject.links))
        allowed = [(link, obstacles[int(rng.integers(len(obstacles)))].name)]
    request = PlanRequest(
        robot=loaded.reference,
        scene=messages.Scene(name="doubted", obstacles=obstacles),
        group=[joint.name for joint in planned],
        start=wires[0],
        robot_placement=setting["placement"],
        min_clearance=setting["min_clearance"],
        attached_objects=setting["attached"],
        allowed_collisions=allowed,
        limits=_limits(rng, planned) if kind != "moving" else {},
        max_velocity_scaling_factor=float(rng.choice([1.0, 1.0, 0.3])),
        allowed_planning_time=SECONDS,
        optimization_iterations=[None, 0, 0, 0, 0, 2, 2, 8][rng.integers(8)],
        recording="off",
        seed=seed,
        **more,
    )
    return Asked(kind, request, names)


def value(rng: np.random.Generator, joint: Joint) -> Any:
    """A value of a joint within its limits, or at one, as the wire has it."""
    roam = ROAM * rng.uniform(-1.0, 1.0, 3)
    turn = list(scenery.random_rotation(rng))
    match joint.kind:
        case JointKind.PLANAR:
            return [*roam[:2].tolist(), float(rng.uniform(-3.0, 3.0))]
        case JointKind.SPHERICAL:
            return turn
        case JointKind.FLOATING:
            return [*roam.tolist(), *turn]
    lower, upper = float(joint.lower[0]), float(joint.upper[0])
    if rng.random() < 0.08 and np.isfinite([lower, upper]).all():
        return float(rng.choice([lower, upper]))
    most = ROAM if joint.kind is JointKind.PRISMATIC else np.pi
    return float(rng.uniform(min(max(lower, -most), upper), max(min(upper, most), lower)))


def free(rng: np.random.Generator, loaded: Loaded, planned: list[Joint], base: Wire) -> Wire | None:
    """Values of all joints, the planned ones drawn, at which links keep apart; None if none was found."""
    for draw in range(DRAWS):
        wire = {**base, **{joint.name: value(rng, joint) for joint in planned}}
        if draw > DRAWS // 2:  # some robots are free near their rest only
            wire = between(rng, loaded, {n: v.tolist()[0] for n, v in loaded.subject.rest.items()}, wire, 0.3)
            wire = {**base, **{joint.name: wire[joint.name] for joint in planned}}
        if loaded.alone.distances_at(as_values(wire)).min(initial=np.inf) > OWN_ROOM:
            return wire
    return None


def _nearer(rng: np.random.Generator, loaded: Loaded, start: Wire, goal: Wire) -> Wire:
    """A goal that is nearer to the start, if it is free."""
    nearer = between(rng, loaded, start, goal, SHORT)
    keeps = loaded.alone.distances_at(as_values(nearer)).min(initial=np.inf)
    return nearer if keeps > OWN_ROOM else goal


def between(rng: np.random.Generator, loaded: Loaded, first: Wire, last: Wire, most: float = 1.0) -> Wire:
    """Somewhere on the way from one to another."""
    share, found = most * float(rng.uniform()), {}
    for joint in loaded.movable:
        names = [joint.name + s for s in _suffixes(joint)]
        rows = [np.atleast_1d(one[joint.name]).tolist() for one in (first, last)]
        at = Curve.of(names, rows).at(np.array([share]))[joint.name][0]
        found[joint.name] = at.tolist()
    return found


def _suffixes(joint: Joint) -> list[str]:
    parts = {JointKind.PLANAR: "x y theta", JointKind.SPHERICAL: "qx qy qz qw", JointKind.FLOATING: "x y z qx qy qz qw"}
    return [f".{part}" for part in parts[joint.kind].split()] if joint.kind in parts else [""]


def _held(rng: np.random.Generator, loaded: Loaded, names: frozenset[str], wires: list[Wire]) -> list[AttachedObject]:
    """One object that a link holds and that touches no other at the ends, or those that it may touch."""
    one = scenery.draw_held(rng, str(rng.choice(loaded.subject.links)))
    judge = loaded.judge(names, attached=[one])
    touching: set[str] = set()
    for wire in wires:
        close = judge.own & (judge.distances_at(as_values(wire)) < OWN_ROOM)
        touching |= {name for pair in np.flatnonzero(close).tolist() for name in judge.pair_names(pair)}
    touching -= {"held"}
    if len(touching) > 2:
        return []
    return [AttachedObject(one.obstacle, one.link, one.placement, sorted(touching))]


def _limits(rng: np.random.Generator, planned: list[Joint]) -> dict[str, JointLimits]:
    """Limits of some joints, of jerk too."""
    if rng.random() < 0.7:
        return {}
    found, jerks = {}, rng.random() < 0.4
    for joint in planned:
        if rng.random() < 0.6:
            speed, acceleration = float(10.0 ** rng.uniform(-1.0, 0.7)), float(10.0 ** rng.uniform(-0.5, 1.0))
            jerk = float(10.0 ** rng.uniform(0.5, 2.0)) if jerks else None
            found[joint.name] = JointLimits(speed, acceleration, jerk)
    return found


def _more(
    rng: np.random.Generator,
    kind: str,
    loaded: Loaded,
    planned: list[Joint],
    wires: list[Wire],
    setting: dict[str, Any],
) -> dict[str, Any]:
    """Goal, planner, planes and constraints of a kind of plan."""
    goals = [{joint.name: wire[joint.name] for joint in planned} for wire in wires[1:]]
    more: dict[str, Any] = {"goal": JointsGoal(goals[0]), "guide_planes": []}
    poses = tip_poses(loaded, wires, setting)
    if kind == "tree":
        more["planner"] = "tree"
    if kind == "leave":
        more["leave_start_contact"] = True
    if kind == "set":
        more["goal"] = JointSetGoal(goals)
    if kind == "pose":
        free_turn = bool(rng.random() < 0.5)
        more["goal"] = PoseGoal(
            position=tuple(poses[1].translation.tolist()),
            quaternion_xyzw=tuple(pin.Quaternion(poses[1].rotation).coeffs().tolist()),
            orientation_tolerance=(None, None, None) if free_turn else (1e-3, 1e-3, 1e-3),
        )
    if kind == "constraint":
        more["path_constraints"] = [constraint(rng, loaded.model.tip, poses)]
    if kind == "moving" and rng.random() < 0.6:
        return more
    if kind in ("guided", "planes", "moving"):
        more["guide_planes"] = [plane(rng, "gate", poses[1])]
        more["planner"] = "guided" if kind == "guided" else "auto"
    if kind in ("guided", "moving"):
        more["goal"] = GuidePlaneGoal()
    return more


def tip_poses(loaded: Loaded, wires: list[Wire], setting: dict[str, Any]) -> list[Any]:
    """Return where the tip is at values of all joints, in the world."""
    judge = loaded.judge(frozenset(), placement=setting["placement"])
    return [judge.frame_at(as_values(wire), loaded.model.tip) for wire in wires]


def plane(rng: np.random.Generator, name: str, pose: Any) -> messages.GuidePlane:
    """A square through where the tip may be."""
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    half = float(rng.uniform(0.05, 0.3))
    corners = [pose.translation + half * (s * axes[0] + t * axes[1]) for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return messages.GuidePlane(name=name, vertices=[tuple(corner.tolist()) for corner in corners])


def constraint(rng: np.random.Generator, frame: str, poses: list[Any]) -> PathConstraint:
    """Something that the tip keeps at all of some poses, of any kind."""
    first, last = poses[0].translation, poses[1].translation
    way = last - first + 1e-3 * rng.normal(size=3)
    tolerance = float(rng.uniform(0.05, 0.5))
    match rng.integers(3):
        case 0:
            normal = np.cross(way, rng.normal(size=3))
            return PlaneConstraint(frame, tuple(first.tolist()), tuple(normal.tolist()), tolerance)
        case 1:
            return LineConstraint(frame, tuple(first.tolist()), tuple(way.tolist()), tolerance)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    ends = [pose.rotation @ axis for pose in poses[:2]]
    middle = ends[0] + ends[1] + 1e-3 * rng.normal(size=3)
    middle /= np.linalg.norm(middle)
    half = max(float(np.arccos(np.clip(end @ middle, -1.0, 1.0))) for end in ends) + float(rng.uniform(0.02, 0.5))
    return OrientationCone(frame, tuple(axis.tolist()), tuple(middle.tolist()), half)


def _flying(
    rng: np.random.Generator, loaded: Loaded, names: frozenset[str], values: list[Values], setting: dict[str, Any]
) -> list[messages.Obstacle]:
    """Obstacles that fly by, far enough from the start at first; at times a crowd, most of it far away."""
    judge = loaded.judge(names, **setting)
    judge.distances_at(values[0])
    centres, found = judge.moving_centres(), []
    crowd = rng.random() < CROWDS
    for index in range(int(rng.integers(*((18, 40) if crowd else (1, 3)))) if len(centres) else 0):
        kind = str(rng.choice(["box", "sphere", "cylinder", "capsule", "mesh", "polygon", "cloud", "half_space"]))
        if crowd and kind == "half_space":
            continue
        one = scenery.obstacle(rng, kind, f"f{index}", np.zeros(3), float(rng.uniform(0.05, 0.25)))
        by, apart = (float(rng.uniform(0.1, 2.0)), float(rng.uniform(0.0, 4.0))) if crowd else (0.5, 0.0)
        if isinstance(one, messages.HalfSpace):
            one = scenery.make_sway(rng, one, centres, 2.5)
        else:
            at = centres[rng.integers(len(centres))]
            one = scenery.make_fly(rng, one, at + apart * rng.normal(size=3) if crowd else at, by, 2.5)
        if scenery.find_closest(loaded.judge(names, obstacles=[one], **setting), values[0])[0] > 1e-3:
            found.append(one)
    return found


def _touching(
    rng: np.random.Generator, loaded: Loaded, names: frozenset[str], values: list[Values], setting: dict[str, Any]
) -> list[messages.Obstacle]:
    """An obstacle that the robot touches slightly at the start."""
    judge = loaded.judge(names, **setting)
    judge.distances_at(values[0])
    centres = judge.moving_centres()
    if not len(centres):
        return []
    kind = str(rng.choice(["box", "sphere", "cylinder", "capsule"]))
    at = centres[rng.integers(len(centres))] + 0.3 * rng.normal(size=3)
    one = scenery.obstacle(rng, kind, "lid", at, float(rng.uniform(0.05, 0.3)))
    margin, away, pair = scenery.find_closest(
        loaded.judge(names, obstacles=[one], **{**setting, "min_clearance": 0.0}), values[0]
    )
    if pair < 0 or margin <= 0.0:
        return []
    return [scenery.shift(one, away * (margin + float(rng.uniform(1e-4, 8e-3))))]
