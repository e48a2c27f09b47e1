"""The seed's algorithm: bring the tip onto a guide plane, in the middle of the free space.

planner.md section 3 with the corrections of findings-seed.md section 2: the robot repels itself, a slide may not undo
an advance (guard), the tip heads for the polygon inset by its radius, the last advance stops at the plane, and every
accepted step belongs to the path.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from guidefield.collision.ball import obstacle_touched
from guidefield.errors import Status
from guidefield.planner.aim import Aim
from guidefield.planner.problem import Problem
from guidefield.planner.projected import Blocks, Projected
from guidefield.planner.settling import Minimizer
from guidefield.planner.steps import MARGIN, Walker
from guidefield.planner.trace import Note, Step
from guidefield.robot.charges import robot_charges
from guidefield.robot.chart import TRANSLATION
from guidefield.scene.guide_plane import GuidePlane

FIRST_STEP = 0.1
"""Length of an advance, delta_0 [m]: a third of a link, a third of a mouth."""
SMALLEST_STEP = FIRST_STEP / 50
"""Below this an advance is given up, delta_min [m]."""
GUARD = 0.5
"""Share of an advance's gain that slide and reorient have to keep, 1 - beta."""
INSET = 1.6
"""The tip heads for the polygon inset by this many radii of its own."""
ON_PLANE = 1e-4
"""How near the plane counts as on it [m]."""
CREEPING = 0.1
"""A round gains little if it brings less than this share of what an advance may bring."""
CREEPING_ROUNDS = 3
"""So many such rounds in a row are a standstill."""


@dataclass(frozen=True)
class Attempt:
    """One way of trying a plane: who minimises, and the length of an advance [m]."""

    minimizer: Minimizer
    step: float


PROJECTED = (
    Attempt(Projected(Blocks.ONE), FIRST_STEP),
    Attempt(Projected(Blocks.TWO), FIRST_STEP),
    Attempt(Projected(Blocks.ONE), FIRST_STEP / 2),
)
"""Tried in this order until one crosses the plane."""


@dataclass(frozen=True, eq=False)
class Crossing:
    """What came of a guide plane.

    Attributes:
        status: SUCCESS, or why the plane was not reached.
        message: One sentence for a person.
        path: Configurations in order, start included, shape (n, nq); the last is on the plane if it was reached.
        details: Values that the message speaks about.
    """

    status: Status
    message: str
    path: np.ndarray
    details: dict[str, Any] = field(default_factory=dict)


def cross(
    problem: Problem, q: np.ndarray, plane: GuidePlane, index: int, attempts: Sequence[Attempt] = PROJECTED
) -> Crossing:
    """Bring the tip onto a guide plane: each attempt from the same start, until one succeeds.

    Args:
        problem: Robot, scene, field and budget.
        q: Where to start, shape (nq,).
        plane: The plane.
        index: Which one of the request's it is, for reports.
        attempts: Tried in order.

    Returns:
        The first attempt that succeeds, else the one that came nearest.
    """
    impossible = _unreachable_at_once(problem, plane)
    if impossible is not None:
        reason, details = impossible
        details = {"stage": "guide", "plane": index, "guide_plane": plane.name, **details}
        return Crossing(Status.GUIDE_PLANE_UNREACHABLE, f"guide plane {plane.name!r}: {reason}", q[None], details)
    best: Crossing | None = None
    for number, attempt in enumerate(attempts):
        if number:
            problem.tell(Note(f"again, {attempt.minimizer.name}, steps of {1000 * attempt.step:.0f} mm"))
        outcome = _attempt(problem, q, plane, index, attempt)
        if outcome.status in (Status.SUCCESS, Status.TIMED_OUT, Status.PREEMPTED):
            return outcome
        if best is None or outcome.details["distance"] < best.details["distance"]:
            best = outcome
    assert best is not None, "there is at least one attempt"
    return best


def inset_of(problem: Problem, plane: GuidePlane) -> float:
    """How far inside a plane's edges the tip stays [m]."""
    return min(INSET * tip_radius(problem), 0.8 * plane.inradius)


def tip_radius(problem: Problem) -> float:
    """Radius of the body nearest to the tip, of those that move with it [m]: how far the tip stays inside an edge."""
    group = problem.group
    charges = robot_charges(group.robot)
    tip = group.model.frames[group.tip_id]
    nearest, radius = np.inf, 0.0
    for charged, shape in zip(charges.shapes, group.geometry.geometryObjects, strict=True):
        if shape.parentJoint == tip.parentJoint:
            distance = float(charged.capsule.distance(shape.placement.actInv(tip.placement).translation[None])[0])
            if distance < nearest:
                nearest, radius = distance, charged.capsule.radius
    return radius


def _attempt(problem: Problem, q: np.ndarray, plane: GuidePlane, index: int, attempt: Attempt) -> Crossing:
    """Advance, slide and reorient until the tip is on the plane or a reason to give up turns up."""
    aim = Aim(plane, inset_of(problem, plane))
    walker = Walker(problem, q, _margin(problem, q), index)
    problem.tell(Step("start", q, f"towards guide plane {plane.name}", problem.robot_field.potential(q), index))
    creeping = 0
    while True:
        if (spent := problem.budget.spent()) is not None:
            return _given_up(spent, "planning was stopped", walker, aim, index)
        distance = aim.distance(walker.tip)
        if distance <= ON_PLANE:
            return Crossing(Status.SUCCESS, f"reached {plane.name}", np.array(walker.path))
        target = aim.closest_point(walker.tip)
        direction = (target - walker.tip) / distance
        since = len(walker.path) - 1
        step, smallest = min(attempt.step, distance), min(SMALLEST_STEP, 0.5 * distance)
        moved = walker.advance(direction, step, smallest, attempt.minimizer.reach)
        if moved.q is None:
            return _blocked(walker, aim, index)
        gained = distance - aim.distance(walker.tip)
        farthest = distance - GUARD * gained
        if moved.step >= distance - ON_PLANE:  # arrived: minimise in the guide plane itself, inside its polygon
            attempt.minimizer.settle(walker, plane.centroid, plane.normal, aim.inside(0.5 * aim.inset))
            walker.straighten(since)
            return Crossing(Status.SUCCESS, f"reached {plane.name}", np.array(walker.path))
        attempt.minimizer.settle(walker, walker.tip, direction, aim.within(farthest))
        walker.straighten(since)
        kept = distance - aim.distance(walker.tip)
        creeping = creeping + 1 if kept < CREEPING * min(attempt.step, distance) else 0
        if creeping >= CREEPING_ROUNDS:
            return _given_up(
                Status.STUCK_IN_MINIMUM,
                f"stuck in a minimum of the potential {1000 * distance:.0f} mm before guide plane {plane.name!r}",
                walker, aim, index,
            )  # fmt: skip


def _blocked(walker: Walker, aim: Aim, index: int) -> Crossing:
    """No advance is possible: held by an obstacle it is stuck, out of reach the plane is unreachable from here."""
    plane, left = aim.plane, 1000 * aim.distance(walker.tip)
    refusal = walker.refusal()
    if refusal is None:
        return _given_up(
            Status.GUIDE_PLANE_UNREACHABLE,
            f"guide plane {plane.name!r} is {left:.0f} mm away and the tip can't get nearer: joint limits or reach",
            walker, aim, index,
        )  # fmt: skip
    pair = " and ".join(refusal.pair) if refusal.pair else "two bodies"
    return _given_up(
        Status.STUCK_IN_MINIMUM,
        f"stuck in a minimum of the potential {left:.0f} mm before guide plane {plane.name!r}: {pair} would touch",
        walker, aim, index,
    )  # fmt: skip


def _given_up(status: Status, message: str, walker: Walker, aim: Aim, index: int) -> Crossing:
    group, refusal = walker.problem.group, walker.refusal()
    z = group.chart(walker.q)
    at_limit = [
        j.name for j in group.joints if min(z[j.idx_v] - group.lower[j.idx_v], group.upper[j.idx_v] - z[j.idx_v]) < 1e-6
    ]
    details = {
        "stage": "guide",
        "plane": index,
        "guide_plane": aim.plane.name,
        "distance": aim.distance(walker.tip),
        "potential": walker.problem.robot_field.potential(walker.q),
        "pair": list(refusal.pair) if refusal is not None and refusal.pair else None,
        "joints_at_limit": at_limit,
    }
    return Crossing(status, message, np.array(walker.path), details)


def _margin(problem: Problem, q: np.ndarray) -> float:
    """Distance that steps keep from obstacles [m]: what is asked for, a little more where the start allows it."""
    start = max(problem.world.clearance(q).obstacle_distance, 0.0)
    return max(problem.min_clearance, min(MARGIN, 0.5 * start))


def _unreachable_at_once(problem: Problem, plane: GuidePlane) -> tuple[str, dict[str, Any]] | None:
    """Why no configuration can have its tip on a plane, where that is known without looking; else None."""
    radius = tip_radius(problem)
    if plane.inradius < radius:
        return (
            f"its inscribed radius is {1000 * plane.inradius:.1f} mm, the tip's body needs {1000 * radius:.1f} mm",
            {"inradius": plane.inradius, "tip_radius": radius},
        )
    base, reach = arm_reach(problem)
    nearest = float(np.linalg.norm(plane.closest_point(base) - base))
    if nearest > reach:
        return (
            f"its nearest point is {nearest:.3f} m from the robot's first joint, the arm reaches {reach:.3f} m",
            {"distance": nearest - reach, "reach": reach},
        )
    corners = plane.inset_vertices(inset_of(problem, plane))
    places = np.vstack([plane.centroid, *(plane.centroid + t * (corners - plane.centroid) for t in (0.5, 1.0))])
    blocking = [obstacle_touched(problem.scene, place, radius) for place in places]
    if all(blocking):
        return "every place on it where the tip's body would fit is inside an obstacle", {"obstacle": blocking[0]}
    return None


def arm_reach(problem: Problem) -> tuple[np.ndarray, float]:
    """Origin of the first planned joint, shape (3,), and the sum of lengths to the tip [m]; infinite if it roams."""
    group = problem.group
    tip_frame = group.model.frames[group.tip_id]
    chain = [index for index in group.model.supports[tip_frame.parentJoint] if index]
    lengths = [float(np.linalg.norm(group.model.jointPlacements[index].translation)) for index in chain[1:]]
    reach = sum(lengths) + float(np.linalg.norm(tip_frame.placement.translation))
    names = {group.model.names[index] for index in chain}
    for joint in group.joints:
        if joint.kind in TRANSLATION and joint.name in names:
            at = TRANSLATION[joint.kind]
            reach += float(np.linalg.norm(np.maximum(np.abs(joint.lower[at]), np.abs(joint.upper[at]))))
    return group.model.jointPlacements[chain[0]].translation.copy(), reach
