"""Check the start of a motion, and find free configurations that reach its goal; refusals name what is in the way.

The proof of `find_blocked_tip`: where the tip is at a pose, so are the bodies that are fixed to it, whatever the other
joints do. Within the tolerances of a target a point of such a body is at most so far from where it is at one
configuration that reaches it: twice the tolerance of the position, and twice that of the orientation times the point's
distance from the tip. Convex bodies that are deeper in each other than that touch at every configuration that reaches
the target: else a plane would part them at one, and a path no longer than that along its normal would, too.

`SURE_DEPTH` belongs to this proof, and must be more than Coal's error of a depth. The other numbers change whether and
which configurations are found for a request's seed, and how soon. Statuses and details are those of the wire.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import numpy as np

from guidefield.collision.clearance import (
    BlockingPairs,
    blocking_pairs,
    clearance_at,
    contacts_at,
    depth_of,
    find_enclosed_each,
    find_enclosed_pair,
    find_touching_each,
)
from guidefield.collision.world import World
from guidefield.errors import Status
from guidefield.planner.connect import PoseKeeper
from guidefield.planner.leaving import SLIGHT_DEPTH
from guidefield.planner.task.problem import ConfigurationGoal, LastPlaneGoal, Problem, TipGoal
from guidefield.planner.task.stages import StageFailed
from guidefield.robot.group.inverse_kinematics import EXACT, SEARCH, Cause, IkResult, PoseTarget, solve
from guidefield.robot.model.joints import LocalPoint, LocalPoints, ModelConfiguration

SURE_DEPTH = 1e-3  # a smaller depth is no proof, because Coal finds depths by steps [m, at size 1]


def find_blocked_tip(world: World, target: PoseTarget, q: ModelConfiguration) -> BlockingPairs | None:
    """The pairs that touch however a target is reached; None where no such pair is found.

    Args:
        q: A configuration of the group's model that reaches it, shape (model.nq,).
    """
    shift, turned = (
        2.0 * float(np.linalg.norm(np.maximum(each, EXACT)))
        for each in (target.position_tolerance, target.orientation_tolerance)
    )
    if not np.isfinite(shift + turned):
        return None
    group, about = world.group, world.bodies
    tip = group.model.frames[group.tip_id]
    depths: dict[tuple[str, str], float] = {}
    for pair in world.near(q):
        body, other = world.pairs.of(pair)
        if other < world.pairs.links or about.joints[body] != tip.parentJoint or not world.touches(pair):
            continue
        reach = float(np.linalg.norm(about.centres[body] - tip.placement.translation) + about.radii[body])
        depth = depth_of(world, pair)
        if depth is not None and depth > SURE_DEPTH * group.size + shift + turned * reach:
            depths.setdefault(world.pair_names(pair), depth)
    if not depths:
        return None
    ordered = sorted(depths, key=lambda pair: -depths[pair])
    return BlockingPairs(1, dict.fromkeys(ordered, 1), depths[ordered[0]])


SOLUTIONS = 8  # configurations at a pose that a connection is searched to at once. Unrecorded

CANDIDATES = 64
"""Configurations from which those next to the start in time are chosen. With them motions of a Panda to poses are a
tenth faster. The number is unrecorded."""

STARTS = 128  # descents that begin about the problem's start, for these. Unrecorded
START_SPREAD = 0.7  # their distance from it, as a standard deviation [rad, or the group's unit of length]. Unrecorded

LEAST_DIFFERENCE = 0.3
"""Chosen ones differ by this at least in some coordinate [rad, or the unit of length]. Unrecorded."""

GRAZING_DISTANCE = 1e-3
"""Distance that they keep from obstacles beyond the required clearance, if there are such, at size 1 [m]: grazing
would stop a certificate. Unrecorded."""

MAX_STARTS = 8192  # starts from which a configuration that is free is searched for. Unrecorded

GOALS_AT_ONCE = 100
"""Given configurations examined between two checks of the deadline: some milliseconds."""

UNREACHED = (Status.NO_IK_SOLUTION, Status.GOAL_IN_COLLISION, Status.CLEARANCE_BELOW_MINIMUM)
"""Endings of a search for a goal pose that found no free configuration: guide planes may still lead to one."""


def check_start(problem: Problem) -> None:
    """Refuse a start at which no motion may begin.

    Raises:
        StageFailed: START_STATE_IN_COLLISION with the deepest pair, or CLEARANCE_BELOW_MINIMUM.
    """
    z_start = problem.z_start
    if isinstance(problem.goal, LastPlaneGoal) or not are_free(problem, z_start[None])[0]:
        if (fault := find_end_fault(problem, z_start)) is not None:
            message, details = fault
            depth = details["depth"]
            slight = not problem.leave_start_contact and depth is not None and depth <= SLIGHT_DEPTH
            hint = "; `leave_start_contact` would leave so slight a contact first" if slight else ""
            if any(list(one.pair) == details["pair"] for one in problem.world.held_contacts):
                hint = "; `touch_links` names links that a held object may touch"
            raise StageFailed(
                Status.START_STATE_IN_COLLISION, f"the start is in collision: {message}{hint}", stage="start", **details
            )
        _check_clearance(problem, z_start, "start")
    if problem.effort_limit is not None and (weight := problem.effort_limit.faults(z_start[None])[0]) is not None:
        message, values = weight.describe("start")
        raise StageFailed(Status.START_STATE_INVALID, message, **values)
    if (violated := _find_violation(problem, z_start)) is not None:
        message, details = violated
        status = Status.START_STATE_VIOLATES_PATH_CONSTRAINTS
        raise StageFailed(status, f"the start violates a path constraint: {message}", stage="start", **details)


def find_goal_points(problem: Problem) -> LocalPoints | None:
    """Local coordinates (m, nv) that would reach the goal and are free; None where the last guide plane is the goal.

    Raises:
        StageFailed: GOAL_IN_COLLISION, NO_IK_SOLUTION or CLEARANCE_BELOW_MINIMUM; TIMED_OUT or PREEMPTED.
    """
    if isinstance(problem.goal, ConfigurationGoal):
        return _keep_admissible_goals(problem, _free_goals(problem, problem.goal))
    if isinstance(problem.goal, TipGoal):
        target = problem.goal.target
        standing = _find_standing_goal(problem, target)
        if standing is not None and not (problem.guide_planes or problem.in_motion):
            return standing
        if problem.guide_planes:  # the path there begins where they lead
            return _keep_admissible_goals(problem, find_tip_points(problem, target))
        return _keep_admissible_goals(
            problem, find_tip_points(problem, target, _sample_about_start(problem), CANDIDATES, _soonest)
        )
    return None


def _find_standing_goal(problem: Problem, target: PoseTarget) -> LocalPoints | None:
    """The start, shape (1, nv), where its tip is at a pose already, free and within path constraints; else None."""
    group, z = problem.group, problem.z_start
    if not target.is_reached(problem.kinematics.frame_placement(group.expand_from_local(z), group.tip_id)):
        return None
    stays = are_free(problem, z[None])[0] and _find_violation(problem, z) is None
    return z[None] if stays else None


def _sample_about_start(problem: Problem) -> LocalPoints:
    """Local coordinates (k, nv) about the start, within limits, from which configurations next to it are found."""
    group = problem.group
    shift = np.random.default_rng([problem.seed, 4]).normal(scale=START_SPREAD, size=(STARTS, group.nv))
    about: LocalPoints = np.clip(problem.z_start + shift * group.units, group.lower, group.upper)
    return about


def _soonest(problem: Problem, zs: LocalPoints) -> LocalPoints:
    """Choose goals of (m, nv) that lie far apart: those that can be reached soonest, and the first ones.

    By the velocity limits a straight motion along d takes at least max_j |d_j| / V_j. Goals that hardly differ from one
    before are left out.
    """
    group, limit = problem.group, problem.effort_limit
    if limit is not None and any(held := [fault is None for fault in limit.faults(zs)]):
        zs = cast(LocalPoints, zs[held])
    offsets = np.array([group.unwrapped(z, problem.z_start) for z in zs]) - problem.z_start
    order = np.argsort((np.abs(offsets) / group.velocity_limits).max(axis=1), kind="stable").tolist()
    steps, chosen = offsets / group.units, list[int]()
    for candidates in (order, range(len(zs))):
        most = len(chosen) + SOLUTIONS
        for index in candidates:
            if len(chosen) < most and (np.abs(steps[chosen] - steps[index]).max(axis=1) >= LEAST_DIFFERENCE).all():
                chosen.append(index)
    return zs[chosen]


def _choose_all(_problem: Problem, zs: LocalPoints) -> LocalPoints:
    return zs


def find_tip_points(
    problem: Problem,
    target: PoseTarget,
    starts: Sequence[LocalPoint] | LocalPoints = (),
    count: int = SOLUTIONS,
    chosen: Callable[[Problem, LocalPoints], LocalPoints] = _choose_all,
) -> LocalPoints:
    """Local coordinates (m, nv) of free configurations that bring the tip to a pose, far from each other.

    The search begins at the given starts (nv,), then at the problem's and random ones. `chosen` selects from what is
    found; leaving out what it doesn't select must not change its selection.

    Raises:
        StageFailed: NO_IK_SOLUTION with the reason where none reaches the pose: out of reach and by how much;
            GOAL_IN_COLLISION or CLEARANCE_BELOW_MINIMUM with what stands in the way where those found aren't free;
            TIMED_OUT or PREEMPTED.
    """
    tip = _TipBlockage(target, problem.scene.moves)
    result = _solve(problem, target, starts, count, tip.keeps_some_distance, blocked=lambda: tip.blocked is not None)
    if tip.blocked is not None and not problem.deadline.expired():
        raise StageFailed(
            Status.GOAL_IN_COLLISION,
            f"the goal pose is in collision: {tip.blocked.describe()}, however it is reached",
            stage="goal",
            **result.details,
            **tip.blocked.details(),
        )
    if not result.solutions and result.rejected and not _is_hopeless(problem, result):
        result = _solve(problem, target, starts, count, _touch_nothing, MAX_STARTS)
    if (found := _choose_in_the_open(problem, result.solutions, chosen)) is not None:
        return found
    if result.solutions:  # all that were found are inside of something: search for others
        result = _solve(problem, target, starts, count, _are_outside)
    if result.solutions:
        return chosen(problem, np.array(result.solutions))
    rejected = [problem.group.expand_from_local(z) for z in result.rejected]
    touching, touch = find_touching_each(problem.world, rejected)  # batches refuse what all but touches
    if zs := [z for z, kept in zip(result.rejected, _are_apart(problem, result.rejected, touch), strict=True) if kept]:
        return chosen(problem, np.array(zs))
    if (status := problem.deadline.status()) is not None and result.cause is not Cause.OUT_OF_REACH:
        raise StageFailed(
            status, f"no configuration for the goal pose was found in time: {result.reason}", stage="goal"
        )
    met = blocking_pairs(problem.world, rejected, problem.min_clearance, touching)
    status, message = explain_unreached(result, met)
    raise StageFailed(status, message, stage="goal", **result.details, **met.details())


def explain_unreached(result: IkResult, met: BlockingPairs) -> tuple[Status, str]:
    """The status and sentence of a goal pose that no free configuration reaches."""
    if not met.counts:
        return Status.NO_IK_SOLUTION, f"no configuration reaches the goal pose: {result.reason}"
    message = f"no configuration at the goal pose is free: {result.reason}: {met.describe()}"
    return (Status.GOAL_IN_COLLISION if met.clearest is None else Status.CLEARANCE_BELOW_MINIMUM), message


def _choose_in_the_open(
    problem: Problem, zs: Sequence[LocalPoint], chosen: Callable[[Problem, LocalPoints], LocalPoints]
) -> LocalPoints | None:
    """Choose local coordinates (nv,), as `find_tip_points`, of those at which no body is inside another one.

    None where there are none. Only what is chosen is examined, in most cases: that takes longer than the choice.
    """
    if not zs:
        return None
    first = chosen(problem, np.array(zs))
    if all(_are_in_the_open(problem, first)):
        return first
    rest = [z for z, one in zip(zs, _are_in_the_open(problem, zs), strict=True) if one]
    return chosen(problem, np.array(rest)) if rest else None


def _is_hopeless(problem: Problem, result: IkResult) -> bool:
    """Return whether no search finds more than the last one: by SIMD batches all that it found touches something."""
    return result.exhausted and not _touch_nothing(problem, cast(LocalPoints, np.array(result.rejected))).any()


def _solve(
    problem: Problem,
    target: PoseTarget,
    starts: Sequence[LocalPoint] | LocalPoints,
    count: int,
    free: Callable[[Problem, LocalPoints], np.ndarray],
    most: int = SEARCH.most_rejected,
    blocked: Callable[[], bool] = lambda: False,
) -> IkResult:
    return solve(
        problem.group,
        target,
        starts=(*starts, problem.z_start),
        count=count,
        rng=np.random.default_rng([problem.seed, 1]),
        refine=PoseKeeper(problem, target),
        accept=lambda zs: free(problem, zs),
        fault="in collision or too close" if problem.min_clearance > 0.0 else "in collision",
        most=most,
        deadline=problem.deadline.or_if(blocked),
    )


class _TipBlockage:
    """A test whether something blocks the tip at the goal, made once, when nothing that was found there is free.

    Attributes:
        blocked: What blocks it however the target is reached, if that is known.
    """

    def __init__(self, target: PoseTarget, search_done: bool) -> None:
        self._target, self._search_done = target, search_done
        self.blocked: BlockingPairs | None = None

    def keeps_some_distance(self, problem: Problem, zs: LocalPoints) -> np.ndarray:
        free = _touch_nothing(problem, zs, GRAZING_DISTANCE * problem.group.size)  # certificates don't stop by grazing
        if not (self._search_done or free.any()):
            self._search_done = True
            self.blocked = find_blocked_tip(problem.world, self._target, problem.group.expand_from_local(zs[0]))
        return free


def are_free(problem: Problem, zs: LocalPoints) -> np.ndarray:
    """Return which local coordinates (n, nv) touch nothing, are inside of nothing and keep the clearance: (n,), bool.

    Those that a SIMD batch finds free are free; if it finds none, Coal tests all.
    """
    free = _are_outside(problem, zs)
    return free if free.any() else _are_free_by_coal(problem, zs)


def _are_outside(problem: Problem, zs: LocalPoints) -> np.ndarray:
    free = _touch_nothing(problem, zs)
    free[free] = _are_in_the_open(problem, zs[free])
    return free


def _touch_nothing(problem: Problem, zs: LocalPoints, beyond: float = 0.0) -> np.ndarray:
    """Return which of some points (n, nv) surely touch nothing, keep clearance and more, and path constraints: (n,)."""
    if problem.world.held_contacts:
        return np.zeros(len(zs), bool)
    free: np.ndarray = ~problem.batch.touching(zs, problem.min_clearance + beyond)
    if problem.path_constraints:
        free[free] = [_find_violation(problem, z) is None for z in zs[free]]
    return free


def _are_free_by_coal(problem: Problem, zs: LocalPoints) -> np.ndarray:
    return _are_apart(problem, zs, problem.world.in_collision_each([problem.group.expand_from_local(z) for z in zs]))


def _are_apart(problem: Problem, zs: Sequence[LocalPoint] | LocalPoints, touch: list[bool]) -> np.ndarray:
    free = ~np.array(touch, bool)
    free[free] = _are_in_the_open(problem, [z for z, one in zip(zs, free, strict=True) if one])
    free[free] = [_keeps_clearance(problem, z) for z, one in zip(zs, free, strict=True) if one]
    return free


def _are_in_the_open(problem: Problem, zs: Sequence[LocalPoint] | LocalPoints) -> list[bool]:
    """Return at which local coordinates, each of shape (nv,), no body is wholly inside another one."""
    qs = [problem.group.expand_from_local(z) for z in zs]
    return [inside is None for inside in find_enclosed_each(problem.world, qs)]


def find_end_fault(problem: Problem, z: LocalPoint) -> tuple[str, dict[str, Any]] | None:
    """The fault of a point (nv,) as an end of a motion: its deepest contact, as sentence and values; or None."""
    q = problem.group.expand_from_local(z)
    contacts = contacts_at(problem.world, q)
    if contacts:
        worst = max(contacts, key=lambda contact: contact.depth or 0.0)
        pairs = list(dict.fromkeys(contact.pair for contact in contacts))
        depth = f", {1000 * worst.depth:.1f} mm deep" if worst.depth is not None else ""
        more = f" (and {len(pairs) - 1} more pair{'s' if len(pairs) > 2 else ''})" if len(pairs) > 1 else ""
        return f"{worst.pair[0]} and {worst.pair[1]}{depth}{more}", {
            "pair": list(worst.pair),
            "depth": worst.depth,
            "pairs": [list(pair) for pair in pairs],
        }
    inside = find_enclosed_pair(problem.world, q)
    if inside is not None:
        return f"{inside[0]} and {inside[1]}, one wholly inside the other", {"pair": list(inside), "depth": None}
    return None


def _free_goals(problem: Problem, goal: ConfigurationGoal) -> LocalPoints:
    zs = np.array([problem.group.to_local(q) for q in goal.configurations])
    free: LocalPoints = zs[_judge_before_deadline(problem, zs, _are_outside)]
    if not len(free):
        free = zs[_judge_before_deadline(problem, zs, _are_free_by_coal)]
    if len(free):
        return free
    faults: list[tuple[str, dict[str, Any]] | None] = []
    for z in zs:
        if len(faults) >= GOALS_AT_ONCE and (status := problem.deadline.status()) is not None:
            message = f"of {len(zs)} goals {len(faults)} were looked at in time, and all of these are blocked"
            raise StageFailed(status, message, stage="goal", goals=len(zs))
        faults.append(find_end_fault(problem, z))
    touching = [z for z, fault in zip(zs, faults, strict=True) if fault is not None]
    if None in faults:  # some touch nothing, but are too close
        _check_clearance(problem, zs[faults.index(None)], "goal")
    fault = next((fault for fault in faults if fault is not None), None)
    assert fault is not None, "it touches something"
    message, details = fault
    if len(zs) == 1:
        raise StageFailed(Status.GOAL_IN_COLLISION, f"the goal is in collision: {message}", stage="goal", **details)
    met = blocking_pairs(problem.world, [problem.group.expand_from_local(z) for z in touching])
    message = f"all {len(zs)} goals are in collision: {met.describe()}"
    raise StageFailed(Status.GOAL_IN_COLLISION, message, stage="goal", goals=len(zs), **met.details())


def _judge_before_deadline(
    problem: Problem, zs: LocalPoints, free: Callable[[Problem, LocalPoints], np.ndarray]
) -> np.ndarray:
    """Return which local coordinates (n, nv) are free: (n,), bool; those not examined before the deadline aren't."""
    found = np.zeros(len(zs), bool)
    for begin in range(0, len(zs), GOALS_AT_ONCE):
        if begin and problem.deadline.expired():
            break
        found[begin : begin + GOALS_AT_ONCE] = free(problem, zs[begin : begin + GOALS_AT_ONCE])
    return found


def _keep_goals_held_by_torques(problem: Problem, goals: LocalPoints) -> LocalPoints:
    if problem.effort_limit is None:
        return goals
    faults = problem.effort_limit.faults(goals)
    held = [goal for goal, fault in zip(goals, faults, strict=True) if fault is None]
    if held:
        return np.array(held)
    assert faults[0] is not None, "no goal can be held"
    message, values = faults[0].describe("goal")
    raise StageFailed(Status.GOAL_STATE_INVALID, message, **values)


def _keep_admissible_goals(problem: Problem, goals: LocalPoints) -> LocalPoints:
    goals = _keep_goals_held_by_torques(problem, goals)
    faults = [_find_violation(problem, goal) for goal in goals]
    kept = [goal for goal, fault in zip(goals, faults, strict=True) if fault is None]
    if kept:
        return np.array(kept)
    assert faults[0] is not None, "no goal is kept"
    message, details = faults[0]
    status = Status.GOAL_VIOLATES_PATH_CONSTRAINTS
    raise StageFailed(status, f"the goal violates a path constraint: {message}", stage="goal", **details)


def _find_violation(problem: Problem, z: LocalPoint) -> tuple[str, dict[str, Any]] | None:
    if not problem.path_constraints:
        return None
    frames = problem.constrained_frames
    values = frames.values(z)
    worst = int(np.argmax(values / frames.limits))
    if values[worst] <= frames.limits[worst]:
        return None
    value, limit, frame = float(values[worst]), float(frames.limits[worst]), frames.constraints[worst].frame
    message = f"`path_constraints[{worst}]`: {frames.constraints[worst].describe(value)}"
    return message, {"constraint": worst, "frame": frame, "value": value, "limit": limit}


def _keeps_clearance(problem: Problem, z: LocalPoint) -> bool:
    required = problem.min_clearance
    return (
        required <= 0.0 or clearance_at(problem.world, problem.group.expand_from_local(z)).obstacle_distance >= required
    )


def _check_clearance(problem: Problem, z: LocalPoint, end: str) -> None:
    if _keeps_clearance(problem, z):
        return
    found = clearance_at(problem.world, problem.group.expand_from_local(z))
    pair = list(found.obstacle_pair) if found.obstacle_pair else None
    where = f" ({pair[0]} and {pair[1]})" if pair else ""
    raise StageFailed(
        Status.CLEARANCE_BELOW_MINIMUM,
        f"the {end} keeps {1000 * found.obstacle_distance:.1f} mm from the obstacles{where}, "
        f"{1000 * problem.min_clearance:.1f} mm are asked for",
        stage=end,
        clearance=found.obstacle_distance,
        min_clearance=problem.min_clearance,
        pair=pair,
    )
