"""Path constraints in planning: bring configurations back to them, also at a pose, and connect within them.

Paths are free and within the constraints at samples; the certificate judges both between them (`prove/certificate.py`).
The constants change what is found and how soon.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from guidefield.errors import Status
from guidefield.kernels.tree.path_constraints import KeptFrames, bring_back
from guidefield.planner.connect import tree_search
from guidefield.planner.connect.connect import Connection, explain_failed_search
from guidefield.planner.connect.tree_search import CONSTRAINT_ROOM, CORRECTIONS, RESOLUTION
from guidefield.planner.motion.waypoints import length_of
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import Step, StepKind, TreeGrown
from guidefield.robot.group.path_constraints import ConstrainedFrames, keep_frames
from guidefield.robot.ik.inverse_kinematics import EXACT, SEARCH, PoseTarget
from guidefield.robot.model.spaces import ChartPoint, ChartPoints

CONSTRAINED_ITERATIONS = 10_000_000  # samples that a search draws at most: for safety
SHORTCUTS = 60  # detours that are examined. Unrecorded


@dataclass(frozen=True, eq=False)
class Keeper:
    """Keeps configurations within path constraints."""

    problem: Problem
    frames: ConstrainedFrames

    def bring_back(self, z: ChartPoint) -> ChartPoint | None:
        """The chart point next to z (nv,), within limits, that keeps the constraints with room; None if there is none.

        Newton's steps of least length on the numbers that are too large.
        """
        there: ChartPoint = np.array(z)
        return there if bring_back(self.tables, CONSTRAINT_ROOM, CORRECTIONS, there) else None

    @property
    def tables(self) -> KeptFrames:
        """The constraints as kernels read them."""
        return keep_frames(self.frames)


def connect_constrained(
    problem: Problem, keeper: Keeper, z_start: ChartPoint, goals: ChartPoints, rng: np.random.Generator
) -> Connection:
    """Find a motion within path constraints from z_start (nv,) to one of some goals (m, nv), free by samples."""
    roots = np.array([problem.group.unwrapped(goal, z_start) for goal in goals])
    found = tree_search.grow(
        problem.lanes, z_start[None], roots, RESOLUTION, 0.0, rng, problem.deadline,
        most_iterations=CONSTRAINED_ITERATIONS, frames=keeper.tables,
    )  # fmt: skip
    problem.counters.iterations += found.iterations
    problem.counters.collision_checks += found.motions
    problem.tell(TreeGrown(found.trees))
    if found.path is None:
        status = problem.deadline.status()
        message = explain_failed_search(found, len(goals), in_time=status is not None)
        return Connection(status or Status.PLANNING_FAILED, f"within the path constraints {message}", z_start[None])
    path = _shorten(problem, keeper, found.path, rng)
    for z in path[1:]:
        problem.tell(Step(StepKind.TREE, problem.group.from_chart(z), "found within the path constraints"))
    return Connection(Status.SUCCESS, f"found within the path constraints in {found.iterations} iterations", path)


def _shorten(problem: Problem, keeper: Keeper, path: ChartPoints, rng: np.random.Generator) -> ChartPoints:
    units = problem.group.units
    for _ in range(SHORTCUTS):
        if len(path) < 4 or problem.deadline.expired():
            break
        first, last = np.sort(rng.choice(len(path), 2, replace=False))
        ends = path[first], path[last]
        way = tree_search.grow(
            problem.lanes, ends[0][None], ends[1][None], RESOLUTION, 0.0, rng, problem.deadline,
            most_iterations=0, frames=keeper.tables,
        ).path  # fmt: skip
        if way is None or np.abs(way[-1] - ends[1]).max() > 1e-9:  # not there, or there the other way round
            continue
        if length_of(way, units) < length_of(path[first : last + 1], units) - 1e-9:
            path = np.concatenate([path[:first], ends[0][None], way[1:-1], path[last:]])
    return path


STEPS = 15  # most steps of `_move_within`. From the edges of tolerances three to six lead to where both hold

TRIES = 20
"""After this many failures in a row no other configuration is moved: the constraint is out of reach."""

DAMPING = 1e-9  # of the steps, relative to the largest singular value: a row that nothing moves is given up


class PoseKeeper:
    """Moves configurations that reach a pose and violate a path constraint to nearby ones that keep both."""

    def __init__(self, problem: Problem, target: PoseTarget) -> None:
        self._problem, self._target = problem, target
        self._tries = TRIES

    def __call__(self, zs: ChartPoints) -> ChartPoints:
        """Chart points (n, nv) that reach the pose, some moved; those that aren't helped stay."""
        if not self._problem.path_constraints:
            return zs
        moved: ChartPoints = zs.copy()
        for row, z in enumerate(zs):
            if self._tries == 0:
                break
            found = _move_within(self._problem, self._target, z)
            self._tries = self._tries - 1 if found is None else TRIES
            moved[row] = z if found is None else found
        return moved


def _move_within(problem: Problem, target: PoseTarget, z: ChartPoint) -> ChartPoint | None:
    frames, group = problem.constrained_frames, problem.group
    there = z.copy()
    for _ in range(STEPS):
        values, slopes = frames.values_and_rows(there)
        excess, rows, reached = _pose_excess(problem, target, there)
        if reached and (values <= frames.limits).all():
            return there
        beyond = values - CONSTRAINT_ROOM * frames.limits
        excess = np.concatenate([excess, np.maximum(beyond, 0.0)])
        active = excess != 0.0
        step = np.linalg.pinv(np.concatenate([rows, slopes])[active], rcond=DAMPING) @ excess[active]
        there = np.clip(there - step, group.lower, group.upper)
    return None


def _pose_excess(problem: Problem, target: PoseTarget, z: ChartPoint) -> tuple[np.ndarray, np.ndarray, bool]:
    """The tip's excess over the aimed part of the tolerances, shape (6,), its derivative (6, nv), and if it is there.

    All along and about the axes of the target's frame, translation first [m, rad].
    """
    group, kinematics = problem.group, problem.kinematics
    q = group.expand_from_chart(z)
    tip = kinematics.frame_placement(q, group.tip_id)
    offset = target.placement.actInv(tip)
    away = np.concatenate([offset.translation, pin.log3(offset.rotation)])
    allowed = np.concatenate([target.position_tolerance, target.orientation_tolerance])
    aimed = np.where(allowed > EXACT, SEARCH.aim * allowed, 0.0)
    jacobian = kinematics.tip_jacobian(q) @ group.tangent_map(z)
    linear = target.placement.rotation.T @ jacobian[:3]
    angular = pin.Jlog3(offset.rotation) @ tip.rotation.T @ jacobian[3:]
    excess = np.sign(away) * np.maximum(np.abs(away) - aimed, 0.0)
    return excess, np.concatenate([linear, angular]), target.is_reached(tip)
