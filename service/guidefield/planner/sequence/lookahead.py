"""Choose goals of a step that leave the later steps possible.

Ends of steps are examined, not the motions between them: each later step needs a configuration that is free there, and
a straight line one from which the robot can follow it, from some configuration that the steps before it leave.

With more `ENOUGH`, `BRANCHES` and `DRAWS`, all above 0, fewer possible sequences are refused, for more time. With more
`MAX_EXAMINED_STEPS` impossible ones are refused sooner, but also those whose later ends are among configurations that
weren't drawn. What is kept is planned and certified as ever. Draw `k` takes the seed `seed + k`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.collision.clearance import blocking_pairs, contacts_at
from guidefield.errors import Status
from guidefield.planner.ends import explain_unreached, find_goal_points
from guidefield.planner.sequence.cartesian_line import CartesianLine, follow_line, make_stop_ending
from guidefield.planner.sequence.segments import whole_configuration
from guidefield.planner.sequence.step_sequence import S, StepMotion, StepSequence
from guidefield.planner.task.problem import ConfigurationGoal, LastPlaneGoal, Problem, TipGoal
from guidefield.planner.task.stages import Ending, StageFailed
from guidefield.robot.group.inverse_kinematics import PoseTarget, solve
from guidefield.robot.model.joints import LocalPoint, LocalPoints

ENOUGH = 2  # this many configurations with a future are enough for a step, those nearest to its start
BRANCHES = 3  # configurations of a later step that are tried
MAX_EXAMINED_STEPS = 30  # for one end of a step: if it isn't refuted by then, it counts as possible
DRAWS = 3  # how often other configurations are drawn where none that was found has a future


@dataclass(frozen=True)
class StepRefusal:
    """The reason why a step can't be done, from all ends that were tried."""

    index: int
    ending: Ending


@dataclass
class _LookAhead:
    """The number of steps examined, and the refusal farthest ahead."""

    examined_steps: int = 0
    refused: StepRefusal | None = None

    def refuse(self, index: int, ending: Ending) -> None:
        if self.refused is None or index > self.refused.index:
            self.refused = StepRefusal(index, ending)


def keep_possible_goals(steps: StepSequence[S], index: int, at: S, motion: StepMotion) -> Problem | StepRefusal:
    """The problem of a step whose goals are only those that leave the later steps possible.

    Returns:
        The problem as it is where there is nothing to choose; else with a `ConfigurationGoal`. Or what can't be done.
    """
    problem = motion.problem
    last = not any(steps.moves(later) for later in range(index + 1, len(steps)))
    if last or motion.line is not None or problem.guide_planes or isinstance(problem.goal, LastPlaneGoal):
        return problem
    if not isinstance(problem.goal, TipGoal) and len(problem.goal.configurations) < 2:
        return problem  # nothing to choose
    search = _LookAhead()
    for draw in range(DRAWS):
        try:
            goals = find_goal_points(dataclasses.replace(problem.at(problem.scene.end), seed=problem.seed + draw))
        except StageFailed as failed:
            return StepRefusal(index, failed.ending)
        assert goals is not None, "a plane is no choice"
        kept = _filter_goals(steps, index, at, problem, goals, search)
        if kept:
            chosen = ConfigurationGoal(tuple(problem.group.from_local(z) for z in kept))
            return dataclasses.replace(problem, goal=chosen)
        if not isinstance(problem.goal, TipGoal) or problem.deadline.expired():
            break
    assert search.refused is not None, "something was refused"
    return search.refused


def _filter_goals(
    steps: StepSequence[S], index: int, at: S, problem: Problem, goals: LocalPoints, search: _LookAhead
) -> list[LocalPoint]:
    kept: list[LocalPoint] = []
    for z in _sort_by_distance(problem, goals):
        after = steps.after(index, at, whole_configuration(problem.group, problem.group.from_local(z)), math.inf)
        search.examined_steps = 0
        if _is_possible(steps, index + 1, after, search):
            kept.append(z)
        if len(kept) == ENOUGH:
            break
    return kept


def _sort_by_distance(problem: Problem, zs: LocalPoints) -> list[LocalPoint]:
    away = [problem.group.unwrapped(z, problem.z_start) - problem.z_start for z in zs]
    order = np.argsort(np.linalg.norm(np.array(away) / problem.group.units, axis=1), kind="stable")
    return [cast(LocalPoint, zs[index]) for index in order]


def _is_possible(steps: StepSequence[S], index: int, at: S, search: _LookAhead) -> bool:
    if index == len(steps):
        return True
    motion = steps.motion(index, at, math.inf)
    if motion is None:
        return _is_possible(steps, index + 1, steps.after(index, at, at.q, math.inf), search)
    search.examined_steps += 1
    if search.examined_steps > MAX_EXAMINED_STEPS or motion.problem.deadline.expired():
        return True
    ends = _find_ends(motion, index, search)
    if ends is None:
        return True
    group = motion.problem.group
    return any(
        _is_possible(
            steps,
            index + 1,
            steps.after(index, at, whole_configuration(group, group.from_local(z)), math.inf),
            search,
        )
        for z in ends
    )


def _find_ends(motion: StepMotion, index: int, search: _LookAhead) -> list[LocalPoint] | None:
    """Configurations in which a step may end; None if they aren't known before it is planned."""
    problem = motion.problem
    if motion.line is None and (problem.guide_planes or isinstance(problem.goal, LastPlaneGoal)):
        return None
    found: list[LocalPoint] | Ending
    if motion.line is not None:
        found = _find_straight_end(problem, motion.line)
    elif isinstance(problem.goal, TipGoal):
        found = _find_reached(problem, problem.goal.target)
    else:
        assert isinstance(problem.goal, ConfigurationGoal), "no plane is the goal"
        found = _free_of(problem, problem.goal)
    if isinstance(found, Ending):
        search.refuse(index, found)
        return []
    return found


def _find_straight_end(problem: Problem, line: CartesianLine) -> list[LocalPoint] | Ending:
    path, stop = follow_line(problem, line)
    if stop is not None:
        return make_stop_ending(problem, line, stop)
    touching = next((z for z, touches in zip(path, _touch(problem, path), strict=True) if touches), None)
    if touching is None:
        return [cast(LocalPoint, path[-1])]
    pair = contacts_at(problem.world, problem.group.expand_from_local(touching))[0].pair
    message = f"on the straight way {pair[0]} and {pair[1]} touch"
    return Ending(Status.INVALID_MOTION_PLAN, message, {"stage": "goal", "pair": list(pair)})


def _find_reached(problem: Problem, target: PoseTarget) -> list[LocalPoint] | Ending:
    found = solve(
        problem.group,
        target,
        starts=(problem.z_start,),
        count=BRANCHES,
        rng=np.random.default_rng([problem.seed, 1]),
        accept=lambda zs: ~_touch(problem, zs),
        deadline=problem.deadline,
    )
    if found.solutions:
        return list(found.solutions)
    expanded = [problem.group.expand_from_local(z) for z in found.rejected]
    met = blocking_pairs(problem.world, expanded, problem.min_clearance)
    return Ending(*explain_unreached(found, met), {"stage": "goal", **found.details, **met.details()})


def _free_of(problem: Problem, goal: ConfigurationGoal) -> list[LocalPoint] | Ending:
    zs = _sort_by_distance(problem, np.array([problem.group.to_local(q) for q in goal.configurations]))
    free = [z for z, touches in zip(zs, _touch(problem, zs), strict=True) if not touches]
    if free:
        return free[:BRANCHES]
    pair = contacts_at(problem.world, problem.group.expand_from_local(zs[0]))[0].pair
    message = f"the goal is in collision: {pair[0]} and {pair[1]}"
    return Ending(Status.GOAL_IN_COLLISION, message, {"stage": "goal", "pair": list(pair)})


def _touch(problem: Problem, zs: Iterable[LocalPoint]) -> np.ndarray:
    return np.array(problem.world.in_collision_each([problem.group.expand_from_local(z) for z in zs]), bool)
