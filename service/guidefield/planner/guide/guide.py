"""Cross a guide plane: bring the tip onto it in the middle of the free space, by one attempt after the other.

The algorithm is the thesis' (service/docs/algorithm.md, "Crossing a guide plane") with five additions: the robot repels
itself, a slide may not undo an advance (guard), the tip heads for the polygon inset by its radius, the last advance
stops at the plane, and every accepted step belongs to the path.

A plane that `explain_unreachable` names is refused without a search, so its bounds must hold: the reach may be larger,
never too small. With fewer `DIVISIONS` the path to a blocked plane is searched for in vain. The insets are a choice:
farther from a polygon's edges, or through more of it; a plane counts as blocked if its part within `INSET` is.

Each step is checked when it is taken (`GuidedPath.free`, or the same capsules in kernels), so the other constants
change success, clearance and time of the motions, not what is free. Keys of `ATTEMPTS` are names of the wire; that
document repeats `FIRST_STEP`, `CREEPING_ROUNDS` and `INSET`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import coal
import numpy as np

from guidefield.collision.clearance import clearance_at
from guidefield.errors import InvalidGroup, Status
from guidefield.geometry.convex import balls_as_capsules
from guidefield.kernels.distance.distance import DistanceTables, distance_at_points
from guidefield.kernels.field.field import frozen
from guidefield.kernels.guide.coordinate_descent import Searching, sweep
from guidefield.kernels.guide.tip_constraint import COUNTS, EVALUATIONS, JUDGED, TipGuard
from guidefield.kernels.kinematics.link_chain import chain_configuration, close_chain
from guidefield.planner.guide.guided_path import SELF_MARGIN, SWEPT_RESOLUTION, GuidedPath, reach_point, swept_world
from guidefield.planner.guide.rounds import MOST_ROUNDS, NEGLIGIBLE, Aim, Attempt, Blocks, Projected, Round, rounds
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import make_stopped_message
from guidefield.planner.task.trace import Note, Step, StepKind
from guidefield.read_only import ReadOnly
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.kinematics import chain_to_tip, mover_of
from guidefield.robot.group.link_chain import SerialChain, link_chain
from guidefield.robot.link_charges import robot_charges
from guidefield.robot.model.joints import Configuration, Configurations
from guidefield.robot.model.model import MARGIN
from guidefield.scene.distance_tables import distance_tables
from guidefield.scene.guide_plane import GuidePlane
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene

# length of an advance, the thesis' delta_0 [m], at size 1: a third of a link, a third of a mouth. In the thesis'
# scenes shorter ones take up to twice the time, longer ones keep less clearance
FIRST_STEP = 0.1
CREEPING = 0.1  # a round gains little below this share of what an advance may bring. Unrecorded
CREEPING_ROUNDS = 3  # this many such rounds in a row are a standstill. Unrecorded
# Univariate's search for an angle begins with the first step and ends below the last [rad]. Unrecorded
FIRST_TURN = float(np.deg2rad(5.0))
LAST_TURN = float(np.deg2rad(0.5))
FIRST_SLIDE = 0.025  # the same for a slide [m]: a quarter and a 64th of an advance. Unrecorded
LAST_SLIDE = 0.1 / 64
MOST_SEARCH_STEPS = 4000  # steps of one round of Univariate's. Unrecorded
INSET = 1.6  # the tip heads for the polygon inset by this many radii of its own
INSET_KEPT = 0.5  # share of that inset that it keeps while the motion is optimised (optimize/passages.py)
DIVISIONS = 6  # how often a plane's triangles are divided, each into four, to see that none of its places is free
_ROUNDING = 1e-9  # added to a reach, for rounding [m]


def find_touched_obstacle(scene: Scene, centre: np.ndarray, radius: float) -> str | None:
    """Name of an obstacle that a ball about a centre (3,) [m, world] touches, or None."""
    ball = coal.Sphere(max(radius, 1e-9))
    at = coal.Transform3s(np.eye(3), np.asarray(centre, float))
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    for obstacle in scene.obstacles:
        result.clear()
        request.security_margin = obstacle.rounding
        there = coal.Transform3s(obstacle.placement.rotation, obstacle.placement.translation)
        for shape in _near(obstacle, np.asarray(centre, float), radius + obstacle.rounding):
            first, second = balls_as_capsules(shape, ball)
            if coal.collide(first, there, second, at, request, result):
                return obstacle.name
    return None


def _near(obstacle: Obstacle, centre: np.ndarray, reach: float) -> Iterator[Any]:
    """Coal shapes that are all of an obstacle that comes within reach of a place [m]."""
    patches = None if obstacle.facets is None else obstacle.facets.patches
    if patches is None:
        yield obstacle.shape
        return
    local = obstacle.placement.actInv(centre)
    for apart, patch in patches.nearest_first(local, local):
        if apart > reach + _ROUNDING:
            return
        yield patches.shape(patch)


def inset_of(problem: Problem, plane: GuidePlane) -> float:
    """Distance that the tip keeps from a plane's edges [m]."""
    return min(INSET * tip_radius(problem.group), 0.8 * plane.inradius)


def inset_at(problem: Problem, plane: GuidePlane, tip: np.ndarray) -> float:
    """Distance that the tip keeps from a plane's edges [m], given its place (3,) there by the motion that was found."""
    return min(INSET_KEPT * inset_of(problem, plane), max(plane.depth(tip), 0.0))


@memoized_for_alike
def tip_radius(group: PlanningGroup) -> float:
    """Radius of the body nearest to the tip, of those that move with it [m]: how far the tip stays inside an edge."""
    charges = robot_charges(group.robot)
    tip = group.model.frames[group.tip_id]
    nearest, radius = np.inf, 0.0
    for charged, shape in zip(charges.shapes, group.geometry.geometryObjects, strict=True):
        if shape.parentJoint == tip.parentJoint:
            distance = float(charged.capsule.distance(shape.placement.actInv(tip.placement).translation[None])[0])
            if distance < nearest:
                nearest, radius = distance, charged.capsule.radius
    return radius


def explain_unreachable(problem: Problem, plane: GuidePlane) -> tuple[str, dict[str, Any]] | None:
    """The reason why the tip can't cross a plane, if that is known without a search; else None."""
    radius = tip_radius(problem.group)
    if plane.inradius < radius:
        return (
            f"its inscribed radius is {1000 * plane.inradius:.1f} mm, the tip's body needs {1000 * radius:.1f} mm",
            {"inradius": plane.inradius, "tip_radius": radius},
        )
    base, reach = arm_reach(problem.group)
    nearest = float(np.linalg.norm(plane.closest_point(base) - base))
    if nearest > reach:
        return (
            f"its nearest point is {nearest:.3f} m from the robot's first joint, the arm reaches {reach:.3f} m",
            {"distance": nearest - reach, "reach": reach},
        )
    corners = plane.inset_vertices(inset_of(problem, plane))
    fan = np.stack([np.broadcast_to(plane.centroid, corners.shape), corners, np.roll(corners, -1, axis=0)], axis=1)
    blocking = find_touched_obstacle(problem.scene, plane.centroid, radius)
    if blocking is None or not _are_all_blocked(distance_tables(problem.world.scene), fan, radius):
        return None
    return "every place on it that the tip heads for is inside an obstacle", {"obstacle": blocking}


def _are_all_blocked(tables: DistanceTables, triangles: np.ndarray, radius: float) -> bool:
    """Return whether obstacles are within a radius of all places in triangles (n, 3, 3) [m]; False where undecided.

    A triangle is blocked if the distance at its middle leaves no place in it free; others are divided into four.
    """
    for _ in range(DIVISIONS):
        middles = triangles.mean(axis=1)
        apart = distance_at_points(tables, middles, 2.0 * radius)[0]
        if apart.max() > radius:
            return False
        spreads = np.linalg.norm(triangles - middles[:, None], axis=2).max(axis=1)
        a, b, c = np.moveaxis(triangles[apart + spreads > radius - _ROUNDING], 1, 0)
        if not len(a):
            return True
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        triangles = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return False


@memoized_for_alike
def arm_reach(group: PlanningGroup) -> tuple[np.ndarray, float]:
    """Origin of the first planned joint, shape (3,) [m, world], and the sum of lengths to the tip [m]."""
    chain = chain_to_tip(group)
    return frozen(chain.table.first[3::4].copy()), chain.reach


@dataclass(frozen=True, eq=False)
class Univariate:
    """The thesis' minimizer, for one chain of ball or universal joints: a `Minimizer` (rounds.py)."""

    chain: SerialChain
    negligible: float = NEGLIGIBLE
    most_rounds: int = MOST_ROUNDS

    @property
    def name(self) -> str:
        """Its name, for reports."""
        return "univariate"

    def reach(self, problem: Problem, q: Configuration, point: np.ndarray) -> Iterator[Configuration]:
        """A floating chain (nq,) as a whole.

        A fixed one with its last link's rotation held, then by the least change.
        """
        joints, rotations = self.chain.places(q)
        n = self.chain.n
        if self.chain.leads:
            shifted = self._configuration(q, rotations, joints + (point - joints[0]))
        else:
            near_end = joints[n - 1] + (point - joints[n])
            moved = joints.copy()
            moved[n] = point
            shifted = self._configuration(q, rotations, moved) if close_chain(moved, n - 1, near_end) else None
        if shifted is not None:
            yield shifted
        if not self.chain.leads and (reached := reach_point(problem, q, point)) is not None:
            yield reached

    def minimize(self, guided: GuidedPath, point: np.ndarray, normal: np.ndarray, guard: TipGuard) -> None:  # noqa: ARG002
        """Slide and reorient on a plane until U falls by next to nothing, or rounds are over.

        Every step is parallel to the plane: its point is not needed. See `Minimizer`, with the same shapes.
        """
        problem, field = guided.problem, guided.problem.robot_field
        before = field.potential(guided.q)
        for _ in range(self.most_rounds):
            taken = self._swept(guided, normal, guard)
            if not len(taken):
                return
            after = field.potential(taken[-1])
            if after >= before:  # U is the referee: the round is undone
                return
            if len(taken) > 1 and guided.free(guided.q, taken[-1]):
                taken = taken[-1:]
            for q in taken:
                guided.take(q, StepKind.SWEEP, f"U = {after:.4g}", after)
            fallen, before = before - after, after
            if fallen < self.negligible * (before + fallen) or problem.deadline.expired():
                return

    def _swept(self, guided: GuidedPath, normal: np.ndarray, guard: TipGuard) -> Configurations:
        problem, chain, mover = guided.problem, self.chain, mover_of(self.chain.group)
        swept = swept_world(problem.world)
        searching = Searching(
            FIRST_TURN,
            LAST_TURN,
            FIRST_SLIDE * guided.size,
            LAST_SLIDE * guided.size,
            guided.margin,
            SELF_MARGIN * guided.size,
            SWEPT_RESOLUTION * guided.size,
        )
        path, counts = np.empty((MOST_SEARCH_STEPS, len(guided.q))), np.zeros(COUNTS, np.int64)
        taken = sweep(
            chain.table, chain.joints, chain.parent_joints, int(chain.leads), problem.robot_field.charged,
            problem.robot_field.tables, swept.robot, swept.tables, guard, searching, mover.values, mover.lower,
            mover.upper, normal, guided.q, path, counts,
        )  # fmt: skip
        problem.robot_field.evaluations += int(counts[EVALUATIONS])
        problem.counters.collision_checks += int(counts[JUDGED])
        return path[:taken]

    def _configuration(self, q: Configuration, rotations: np.ndarray, joints: np.ndarray) -> Configuration | None:
        found, turned = np.empty_like(q), np.empty_like(rotations)
        if not chain_configuration(self.chain.table, joints, q, rotations, found, turned):
            return None
        group = self.chain.group
        if group.limited:
            z = group.to_local(found)
            if np.any((z < group.lower) | (z > group.upper)):
                return None
        return found


PROJECTED = (
    Attempt(Projected(Blocks.ONE), FIRST_STEP),
    Attempt(Projected(Blocks.TWO), FIRST_STEP),
    Attempt(Projected(Blocks.ONE), FIRST_STEP / 2),
)
"""Tried in this order until one crosses the plane."""


@dataclass(frozen=True, eq=False)
class PlaneCrossing(ReadOnly):
    """The result of crossing a guide plane."""

    status: Status
    message: str
    # configurations in order, start included, shape (n, nq); the last is on the plane if it was reached
    path: Configurations
    details: dict[str, Any] = field(default_factory=dict)


def cross_plane(
    problem: Problem, q: Configuration, plane: GuidePlane, index: int, attempts: Sequence[Attempt] = PROJECTED
) -> PlaneCrossing:
    """Bring the tip from q (nq,) onto a guide plane.

    The first attempt that succeeds, else the one that came nearest.
    """
    impossible = explain_unreachable(problem, plane)
    if impossible is not None:
        reason, details = impossible
        details = {"stage": "guide", "plane": index, "guide_plane": plane.name, **details}
        return PlaneCrossing(Status.GUIDE_PLANE_UNREACHABLE, f"guide plane {plane.name!r}: {reason}", q[None], details)
    best: PlaneCrossing | None = None
    for number, attempt in enumerate(attempts):
        if number:
            problem.tell(
                Note(f"again, {attempt.minimizer.name}, steps of {1000 * attempt.step * problem.group.size:.0f} mm")
            )
        outcome = _attempt(problem, q, plane, index, attempt)
        if outcome.status in (Status.SUCCESS, Status.TIMED_OUT, Status.PREEMPTED):
            return outcome
        if best is None or outcome.details["distance"] < best.details["distance"]:
            best = outcome
    assert best is not None, "there is at least one attempt"
    return best


def _attempt(problem: Problem, q: Configuration, plane: GuidePlane, index: int, attempt: Attempt) -> PlaneCrossing:
    aim = Aim(plane, inset_of(problem, plane))
    guided = GuidedPath(problem, q, margin_at(problem, q), index)
    problem.tell(Step(StepKind.START, q, f"towards guide plane {plane.name}", problem.robot_field.potential(q), index))
    creeping = 0
    while True:
        if (status := problem.deadline.status()) is not None:
            return _give_up(
                status, make_stopped_message(status, plane.name, aim.distance(guided.tip)), guided, aim, index
            )
        for made in rounds(guided, aim, attempt):
            if made.ended is Round.BLOCKED:
                return _explain_blockage(guided, aim, index)
            if made.ended is Round.ARRIVED:
                return PlaneCrossing(Status.SUCCESS, f"reached {plane.name}", np.array(guided.path))
            little = made.before - made.after < CREEPING * min(attempt.step * guided.size, made.before)
            creeping = creeping + 1 if little else 0
            if creeping >= CREEPING_ROUNDS:
                return _give_up(
                    Status.STUCK_IN_MINIMUM,
                    f"stuck in a minimum of the potential {1000 * made.before:.0f} mm before guide plane"
                    f" {plane.name!r}",
                    guided, aim, index,
                )  # fmt: skip


def _explain_blockage(guided: GuidedPath, aim: Aim, index: int) -> PlaneCrossing:
    """No advance is possible: held by an obstacle it is stuck, out of reach the plane is unreachable from here."""
    plane, left = aim.plane, 1000 * aim.distance(guided.tip)
    refusal = guided.refusal()
    if refusal is None:
        return _give_up(
            Status.GUIDE_PLANE_UNREACHABLE,
            f"guide plane {plane.name!r} is {left:.0f} mm away and the tip can't get nearer: joint limits or reach",
            guided, aim, index,
        )  # fmt: skip
    pair = " and ".join(refusal.pair) if refusal.pair else "two bodies"
    why = f"{pair} would {'come too close' if guided.problem.min_clearance > 0.0 else 'touch'}"
    return _give_up(
        Status.STUCK_IN_MINIMUM,
        f"stuck in a minimum of the potential {left:.0f} mm before guide plane {plane.name!r}: {why}",
        guided, aim, index,
    )  # fmt: skip


def _give_up(status: Status, message: str, guided: GuidedPath, aim: Aim, index: int) -> PlaneCrossing:
    group, refusal = guided.problem.group, guided.refusal()
    z = group.to_local(guided.q)
    at_limit = [
        j.name for j in group.joints if min(z[j.idx_v] - group.lower[j.idx_v], group.upper[j.idx_v] - z[j.idx_v]) < 1e-6
    ]
    details = {
        "stage": "guide",
        "plane": index,
        "guide_plane": aim.plane.name,
        "distance": aim.distance(guided.tip),
        "tip": guided.tip.tolist(),
        "potential": guided.problem.robot_field.potential(guided.q),
        "pair": list(refusal.pair) if refusal is not None and refusal.pair else None,
        "joints_at_limit": at_limit,
    }
    return PlaneCrossing(status, message, np.array(guided.path), details)


def margin_at(problem: Problem, q: Configuration) -> float:
    """Return the distance that steps keep from obstacles [m]: the required one, a little more if the start allows it.

    Args:
        q: Where the robot starts, shape (nq,).
    """
    margin = MARGIN * problem.group.size
    if swept_world(problem.world).keeps(q, 2.0 * margin):
        return max(problem.min_clearance, margin)
    start = max(clearance_at(problem.world, problem.group.expand(q)).obstacle_distance, 0.0)
    return max(problem.min_clearance, min(margin, 0.5 * start))


def projected(group: PlanningGroup) -> tuple[Attempt, ...]:
    """Projected in one block, in two, with shorter advances; then, where it is for such a robot, Univariate."""
    try:
        chain = link_chain(group)
    except InvalidGroup:
        return PROJECTED
    return (*PROJECTED, Attempt(Univariate(chain), FIRST_STEP, careful=True))


def univariate(group: PlanningGroup) -> tuple[Attempt, ...]:
    """Univariate, then with shorter advances.

    Raises:
        InvalidGroup: if the group isn't a chain of ball or universal joints.
    """
    minimizer = Univariate(link_chain(group))
    return tuple(Attempt(minimizer, step, careful=True) for step in (FIRST_STEP, FIRST_STEP / 2))


ATTEMPTS = {"projected": projected, "univariate": univariate}  # by `minimizer` of messages/plan_request.py
