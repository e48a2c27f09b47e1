"""Paths to a goal: checked in every cycle, planned in a thread beside it, and taken over by one of three rules.

They are free at samples only: the judge proves pieces. `FixedDelay` and `AtRecordedTimes` make a stream repeatable.
With another `FAR` or `INSIDE` journals that are kept replay to other pieces.
"""

from __future__ import annotations

import math
import os
import sys
import threading
from collections.abc import Callable, Collection
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol, TypeVar, cast

import numpy as np
import pinocchio as pin

from guidefield.collision.batch.batch_collision import BatchCollision
from guidefield.collision.bodies import joint_placements
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.errors import InvalidGoal, at_path
from guidefield.kernels.collide.layout import (
    DRIFTING_BOX,
    KEPT,
    KEPT_AT_GOAL,
    KEPT_AT_START,
    ROUNDED_BOX,
    VELOCITY,
    DriftingBoxes,
)
from guidefield.messages.streams import StreamGoal
from guidefield.messages.values import JointSetGoal, JointsGoal, PoseGoal
from guidefield.planner import tree_search
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.inverse_kinematics import PoseTarget, solve
from guidefield.robot.group.kinematics import lent_data
from guidefield.robot.model.configuration import CLAMP_TOLERANCE, configuration_from_wire, limit_faults
from guidefield.robot.model.joints import LocalPoint, LocalPoints
from guidefield.stream.commit import JointBounds
from guidefield.stream.dodging import ScheduledPath, TimedPath, build_tube, choose_sides, draw_sides, schedule_path
from guidefield.stream.obstacles import DriftingObstacles
from guidefield.stream.settings import STREAM, ClearanceRule

FAR = 0.3  # distances are measured up to this [m], at size 1; from ends of paths no more is kept
NOTHING = DriftingObstacles(np.empty((0, 16)), np.empty((0, 3)), np.empty(0), np.empty(0))  # no moving obstacles

_T = TypeVar("_T")

YIELDING = 10  # niceness of the planning thread, as Linux counts, where a clock decides when a path is taken over
INSIDE = 0.005  # subtracted from the distance of an end, to keep grown obstacles off it [m], at size 1


class PathPlanner:
    """A planner of paths, by samples, among obstacles at rest and drifting; with its own memory: not for two threads.

    Args:
        least: Least distance from obstacles at rest [m]; paths keep `STREAM.resting` beyond it as a rule.
        tolerance: Largest deviation of each coordinate [rad or m]: the distance that it sweeps is kept as well.
    """

    def __init__(self, group: PlanningGroup, world: World, bounds: JointBounds, least: float, tolerance: float) -> None:
        self._speeds = bounds.rates[:, 0].copy()
        self._lower, self._upper = bounds.lower, bounds.upper
        self._sides = draw_sides(STREAM.sides, self._speeds)
        self.batch = BatchCollision.build(world)
        self._group, self._data, self._bound = group, lent_data(group, self), world.motion_bound
        self._bodies = world.bodies
        self._least, self._tolerance = least, tolerance
        self.size = group.size

    def gaps(self, boxes: np.ndarray, z: LocalPoint) -> np.ndarray:
        """Distances from boxes (k, 16) at coordinates z (nv,), shape (k,) [m], less `INSIDE`: these can be kept."""
        kept: np.ndarray = self.batch.gaps(boxes, z[None], FAR * self.size)[0] - INSIDE * self.size
        return kept

    def is_goal_free(self, drifting: DriftingObstacles, z: LocalPoint) -> bool:
        """Return whether coordinates (nv,) keep `STREAM.ending` from what moves, now and in `STREAM.foreseen`."""
        kept = STREAM.ending.from_each(drifting.rates, self.size) + drifting.margins
        most = max(FAR * self.size, float(kept.max(initial=0.0)) + INSIDE * self.size)
        soon = (drifting.boxes, drifting.after(STREAM.foreseen))
        return all(bool((self.batch.gaps(boxes, z[None], most) >= kept).all()) for boxes in soon)

    def choose_clearance(self, most: float, ends: list[LocalPoint]) -> float:
        """Choose the distance from obstacles at rest [m]: `most` beyond the least; less if an end (nv,) is closer.

        The bound of the robot's deviation there is kept as well, unless an end is closer than that.
        """
        zs, off = np.array(ends), self.bound_error(ends)
        beyond = [*(off + share * most * self.size for share in STREAM.closer), 0.0]
        kept = [self._least + one for one in beyond]
        return next((one for one in kept if not self.batch.touching(zs, one).any()), kept[-1])

    def bound_error(self, ends: list[LocalPoint]) -> float:
        """Bound the deviation of any point of the robot at some configurations (nv,) [m]."""
        group, data, tolerances = self._group, self._data, np.full((1, len(ends[0])), self._tolerance)
        most = 0.0
        for z in ends:
            jacobian = pin.computeJointJacobians(group.model, data, group.expand_from_local(z)).reshape(6, -1)
            centres = self._bodies.centres_in_world(joint_placements(data)[None])
            most = max(most, float(self._bound.at(jacobian[None], centres, tolerances)[1].max(initial=0.0)))
        return most

    @property
    def kept_at_goals(self) -> float:
        """The distance that goals keep from obstacles at rest [m]."""
        return self._least + STREAM.resting * self.size

    def find_free(self, zs: LocalPoints) -> np.ndarray:
        """Return which local coordinates (n, nv) keep `kept_at_goals`, and are free of self-contact, shape (n,)."""
        return ~self.batch.touching(zs, self.kept_at_goals)

    def count_kept(self, z: LocalPoint) -> int:
        """Count the distances of `STREAM.leaving` that are kept at coordinates z (nv,), also from the robot itself."""
        kept = [self._least + one * self.size for one in STREAM.leaving]
        return next((k for k, one in enumerate(kept) if self.batch.touching(z[None], one).any()), len(kept))

    def is_free(self, drifting: DriftingObstacles, kept: ClearanceRule, clearance: float, points: LocalPoints) -> bool:
        """Return whether a path (m, nv), straight from point to point, is free, by a clearance from what rests [m]."""
        batch = self._among(drifting, kept, points[0], points[-1])
        return batch.free_until(points, STREAM.resolution, clearance) == len(points) - 1

    def find_path(
        self, drifting: DriftingObstacles, kept: ClearanceRule, z0: LocalPoint, z1: LocalPoint, seed: int
    ) -> LocalPoints | None:
        """A path from z0 to z1, each (nv,), shape (m, nv), by trees and short cuts; None: none was found.

        Where a joint turns without end the path may end whole turns from z1.
        """
        ends, straight = [z0, z1], cast(LocalPoints, np.array([z0, z1]))
        batch, clearance = self._among(drifting, kept, z0, z1), self.choose_clearance(STREAM.resting, ends)
        if batch.free_until(straight, STREAM.resolution, clearance):
            return straight
        found = tree_search.grow(
            batch, straight[:1], straight[1:], STREAM.resolution, clearance, np.random.default_rng(seed), Deadline(),
            most_motions=STREAM.motions,
        ).path  # fmt: skip
        if found is None:
            return None
        path = batch.shorten(found, STREAM.resolution, clearance, STREAM.cuts)
        path[0], path[-1] = z0, self._group.unwrapped(z1, path[-1])
        return path

    def schedule(self, drifting: DriftingObstacles, points: LocalPoints) -> ScheduledPath:
        """Schedule a path (m, nv) among what moves, on it or beside it; with its cost."""
        path = TimedPath(points, self._speeds)
        if path.length == 0.0 or not len(drifting.boxes):
            return ScheduledPath(path.length, points, path.begins)
        ends = [points[0], points[-1]]
        clearance = self.choose_clearance(STREAM.resting, ends)

        def is_taken(zs: LocalPoints) -> np.ndarray:
            out = np.any((zs < self._lower) | (zs > self._upper), axis=1)
            return np.asarray(out | self.batch.touching(zs, clearance))

        wanted, foreseen = drifting.margins + self.bound_error(ends), math.ceil(STREAM.arriving / STREAM.step)
        kinds = (STREAM.going, STREAM.waiting, STREAM.ending)
        kept = np.array([kept.from_each(drifting.rates, self.size) + wanted for kept in kinds])
        sides = choose_sides(self.batch, drifting, path, self._sides)
        tube = build_tube(path, sides, self._speeds, is_taken, foreseen)
        return schedule_path(self.batch, drifting, kept, tube, path, foreseen)

    def _among(
        self, drifting: DriftingObstacles, kept: ClearanceRule, z0: LocalPoint, z1: LocalPoint
    ) -> BatchCollision:
        """The robot among what rests, and what moves, on paths between two points (nv,)."""
        if not len(drifting.boxes):
            return self.batch
        boxes = np.empty((len(drifting.boxes), DRIFTING_BOX), np.float32)
        # the same rule as `then` in `meets_drifting` of kernels/collide/broadphase.py
        later = float(min(np.max(np.abs(z1 - z0) / self._speeds), STREAM.planned))
        boxes[:, :ROUNDED_BOX], boxes[:, VELOCITY:KEPT] = drifting.boxes, drifting.drifts
        boxes[:, KEPT] = kept.from_each(drifting.rates, self.size) + drifting.margins + self.bound_error([z0, z1])
        boxes[:, KEPT_AT_START] = self.gaps(drifting.boxes, z0)
        boxes[:, KEPT_AT_GOAL] = self.gaps(drifting.after(later), z1)
        return self.batch.among(
            DriftingBoxes(
                size=len(boxes),
                boxes=boxes.ravel(),
                ends=np.concatenate([z0, z1]).astype(np.float32),
                rates=(1.0 / self._speeds).astype(np.float32),
                periods=self._group.periods.astype(np.float32),
                numbers=np.array([STREAM.planned, STREAM.widening * self.size], np.float32),
            )
        )


@dataclass(frozen=True)
class PlannedPath:
    """The outcome of planning."""

    path: ScheduledPath | None  # the cheapest, or the one that is followed; None: none was found
    nowhere: bool  # whether none was found


@dataclass(frozen=True)
class PathOrder:
    """A path that is being planned."""

    due: float  # the time at which it is taken over, by the client's clock [s]
    goal: LocalPoint  # its end, shape (nv,)
    found: Future[PlannedPath]


class BackgroundPlanner:
    """A planner of paths beside the cycle, one at a time, in a thread of its own.

    Args:
        niceness: Of the thread, where the system knows priorities of threads.
    """

    def __init__(self, paths: PathPlanner, niceness: int = 0) -> None:
        self._paths = paths
        self._thread = ThreadPoolExecutor(1, "guidefield-ways", lower_priority, (niceness,))

    def submit(self, work: Callable[[PathPlanner], _T]) -> Future[_T]:
        """Have other work done with its path planner, when its turn comes."""
        return self._thread.submit(work, self._paths)

    def order(
        self,
        due: float,
        z0: LocalPoint,
        z1: LocalPoint,
        drifting: DriftingObstacles,
        followed: LocalPoints | None,
        rng: np.random.Generator,
    ) -> PathOrder:
        """Have a path from z0 to z1 (nv,) planned, due at a time [s], that costs less than the rest of one."""
        seed = int(rng.integers(1 << 62))
        return PathOrder(due, z1, self._thread.submit(self._plan, z0, z1, drifting, followed, seed))

    def close(self) -> None:
        """End its thread."""
        self._thread.shutdown(wait=True, cancel_futures=True)

    def _plan(
        self, z0: LocalPoint, z1: LocalPoint, drifting: DriftingObstacles, followed: LocalPoints | None, seed: int
    ) -> PlannedPath:
        paths = self._paths
        straight = np.array([z0, z1])
        found: list[LocalPoints] = []
        for kept in STREAM.kept:
            path = paths.find_path(drifting, kept, z0, z1, seed)
            if path is None:
                break  # none that keeps more is found either
            found.append(path)
        if paths.is_free(NOTHING, STREAM.going, paths.choose_clearance(STREAM.resting, [z0, z1]), straight):
            found.append(straight)
        if not found and followed is None:
            return PlannedPath(None, nowhere=True)
        scheduled = [paths.schedule(drifting, path) for path in found]
        best = min(scheduled, key=lambda one: one.cost, default=None)
        if followed is not None:
            before = paths.schedule(drifting, followed)
            if best is None or best.cost > before.cost - max(STREAM.gain, STREAM.gain_share * before.cost):
                best = before
        return PlannedPath(best, nowhere=False)


def lower_priority(niceness: int = YIELDING) -> None:
    """Set the niceness of this thread against the others of its process, as Linux counts."""
    if niceness and sys.platform == "linux":  # elsewhere a process has one priority for all of its threads
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), niceness)


def find_goals(
    goal: StreamGoal, group: PlanningGroup, paths: PathPlanner, near: LocalPoint, rng: np.random.Generator
) -> LocalPoints:
    """The configurations that a goal means, free of what rests and of themselves, shape (k, nv).

    Args:
        near: The robot's configuration, shape (nv,): of whole turns the nearest are taken.

    Raises:
        InvalidGoal: if it names joints that don't move, or no configuration of it is within limits and free.
    """
    if isinstance(goal, PoseGoal):
        found = solve(group, PoseTarget.from_wire(goal), [near], STREAM.goals, rng=rng, accept=paths.find_free)
        if not found.solutions:
            raise InvalidGoal(f"the goal's pose can't be reached: {found.reason}", **found.details)
        return np.array(found.solutions)
    given = goal.positions if isinstance(goal, JointSetGoal) else [goal.positions]
    zs = np.array([_configuration(goal, index, group, near) for index in range(len(given))])
    within = ((zs >= group.lower - CLAMP_TOLERANCE) & (zs <= group.upper + CLAMP_TOLERANCE)).all(axis=1)
    if not within.any():
        q = group.from_local(zs[0])
        fault = limit_faults(group.joints, q)[0]
        raise InvalidGoal(
            f"the goal has {fault.joint} at {fault.value:.6g}, its limits are {fault.lower:.6g} and {fault.upper:.6g}",
            joint=fault.joint,
            value=fault.value,
        )
    zs = np.clip(zs[within], group.lower, group.upper)
    free = paths.find_free(zs)
    if not free.any():
        kept = f"{1000.0 * paths.kept_at_goals:.3g} mm"
        raise InvalidGoal(f"the goal touches the scene or the robot itself, or is closer to the scene than {kept}")
    return cast(LocalPoints, zs[free])


def _configuration(goal: JointsGoal | JointSetGoal, index: int, group: PlanningGroup, near: LocalPoint) -> LocalPoint:
    positions = goal.positions[index] if isinstance(goal, JointSetGoal) else goal.positions
    planned = {joint.name for joint in group.joints}
    for name in positions:
        if group.robot.joint(name) is not None and name not in planned:
            raise InvalidGoal(
                f"the goal gives joint {name!r}, which doesn't move; those that do are {', '.join(sorted(planned))}",
                joint=name,
                available=sorted(planned),
            )
    with at_path(f"$.goal.positions[{index}]" if isinstance(goal, JointSetGoal) else "$.goal.positions"):
        q = configuration_from_wire(group.robot, positions, base=group.q_reference, error=InvalidGoal)
    return group.unwrapped(group.to_local(group.part_of(q)), near)


class TakeOver(Protocol):
    """A rule that decides in each cycle whether the ordered path is taken over."""

    @property
    def niceness(self) -> int:
        """Niceness of the planning thread."""

    def takes(self, ordered: PathOrder, now: float) -> bool:
        """Return whether to take it over at an update's time [s]; if it isn't found yet, the cycle waits for it."""


class FixedDelay:
    """Take a path over a fixed time after it was ordered: the same updates get the same pieces."""

    niceness = 0

    def takes(self, ordered: PathOrder, now: float) -> bool:
        """Return whether it is due."""
        return now >= ordered.due


class WhenReady:
    """Take a path over as soon as it is found: nothing ever waits for it.

    Attributes:
        last: Time of the last update at which one was taken over [s]; None: there was none.
    """

    niceness = YIELDING

    def __init__(self) -> None:
        self.last: float | None = None

    def takes(self, ordered: PathOrder, now: float) -> bool:
        """Return whether it is found."""
        if not ordered.found.done():
            return False
        self.last = now
        return True


class AtRecordedTimes:
    """Take paths over at the updates at which they were taken over before.

    Args:
        times: Of these updates [s].
    """

    niceness = 0

    def __init__(self, times: Collection[float]) -> None:
        self._times = frozenset(times)

    def takes(self, ordered: PathOrder, now: float) -> bool:  # noqa: ARG002 - the result doesn't matter
        """Return whether one was taken over then."""
        return now in self._times
