"""Plans to configurations and poses among obstacles that move: first paths, then a schedule along each.

A path is found among obstacles that are held in one of several manners (held_paths.py), optimised and certified there,
and a schedule along it is searched for that meets nothing that moves (schedule.py). Paths are tried in order of
their estimated arrival. If the time-dependent certificate refuses a motion, the search continues with another that
isn't there at that time. If all else fails, the robot waits until the obstacles have come to rest, if it may wait, and
goes as the planner among obstacles at rest goes.

The settings are `SCHEDULE` and `PATH_SEARCH` of slices.py: they and the order of the attempts change which motion is
found and how soon. That certificate, over the whole scene, judges each motion before it is returned.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from guidefield.collision.clearance import clearance_at
from guidefield.deadline import end_reason
from guidefield.errors import Status
from guidefield.planner.ends import are_free
from guidefield.planner.finish import certify_found_path, finish, time_through_planes
from guidefield.planner.held_paths import HeldPath, Through, connections, find_detours, find_quick_paths
from guidefield.planner.motion.timing import remove_repetitions
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.motion_certificate import CertifiedMotion, certify_motion, find_excess, judge
from guidefield.planner.optimize.clearance_samples import keeps_distance
from guidefield.planner.optimized_motion import CrossedPlanes, optimize_motion
from guidefield.planner.path_so_far import PathSoFar, time_path
from guidefield.planner.schedule import (
    Occupancy,
    Schedule,
    Stuck,
    choose_step,
    count_slices,
    depart_after,
    retime,
    schedule_at_any_rate,
    schedule_at_one_rate,
)
from guidefield.planner.slices import PATH_SEARCH, SCHEDULE, Slices, find_free_from, find_free_until
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Ending, Stages, make_ending_at_rest
from guidefield.planner.task.trace import Note
from guidefield.prove.verdict import Verdict
from guidefield.robot.model.joints import LocalPoint, LocalPoints

MotionJudge = Callable[[Trajectory], Verdict]  # judges a motion from time 0 on


def reach_among_movers(
    problem: Problem, goals: LocalPoints | None, through: Through, stages: Stages
) -> CertifiedMotion:
    """Bring a robot through guide planes to a goal among obstacles that move, from time 0 on.

    Args:
        problem: Its start is free at time 0.
        goals: Local coordinates, shape (m, nv), free once all rest; None where they are known behind the planes only.
    """
    search, finished = _Search(problem, goals, stages), None
    if not problem.path_constraints:
        finished = search.by_quick_paths(through) or search.by_detours(through)
    finished = finished or search.by_thorough_paths(through)
    if finished is not None:
        return finished
    return search.make_failure()


def keep_schedule(
    problem: Problem,
    finished: CertifiedMotion,
    stages: Stages,
    also: MotionJudge | None = None,
    *,
    at_rest: bool = False,
) -> CertifiedMotion:
    """Schedule a motion that is free of obstacles at rest so that it meets nothing that moves; its path stays.

    Args:
        problem: Where nothing moves the motion stays as it is.
        also: Judges in addition what the problem doesn't know of.
        at_rest: Whether it is free of all obstacles once they have come to rest.

    Returns:
        The motion, from time 0 on, with the wait before it; failed where there is none.
    """
    if not problem.scene.moves:
        return finished
    assert finished.trajectory is not None, "it was certified"
    search = _Search(problem, finished.trajectory.positions[-1:], stages, also)
    return search.schedule(finished, at_rest=at_rest) or search.make_failure()


@dataclass(frozen=True)
class _Estimate:
    path: HeldPath
    arrival: float  # [s]


class _Search:
    """A search, with what it knows: until when the start is free, from when goals are, and where schedules ended."""

    def __init__(
        self, problem: Problem, goals: LocalPoints | None, stages: Stages, also: MotionJudge | None = None
    ) -> None:
        self._problem, self._goals, self._stages, self._also = problem, goals, stages, also
        self._slices = Slices(problem, choose_step(problem.group) / count_slices(choose_step(problem.group)))
        self._free_from: dict[bytes, float] = {}
        self._farthest: tuple[float, LocalPoint] | None = None
        self._ending: Ending | None = None
        self._excess: Ending | None = None

    @cached_property
    def leave_by(self) -> tuple[float, Verdict | None]:
        """The time until which the robot may wait at its start [s], and the refusal of a longer wait."""
        return find_free_until(self._problem, self._problem.z_start)

    @cached_property
    def _resting(self) -> Problem:
        return self._problem.at(self._problem.scene.end)

    def by_quick_paths(self, through: Through) -> CertifiedMotion | None:
        """The motion along the path that is arrived on first, of those that a few motions find; None without any."""
        with self._stages.enter("connect", "ways to the goal, and when each can be gone") as stage:
            estimates = list(self._estimates(find_quick_paths(self._problem, through)))
            stage.outcome = f"{len(estimates)} ways can be gone"
        return self._first(estimates)

    def by_detours(self, through: Through) -> CertifiedMotion | None:
        """The motion by a place to wait at, where the robot may not wait where it starts; None without any."""
        if self.leave_by[0] == np.inf or self._problem.deadline.expired():
            return None
        with self._stages.enter("connect", "ways by places to wait at") as stage:
            paths = find_detours(self._problem, through, self._slices, self.leave_by[0])
            estimates = list(self._estimates(paths))
            stage.outcome = f"{len(estimates)} ways can be gone"
        return self._first(estimates)

    def _first(self, estimates: Sequence[_Estimate]) -> CertifiedMotion | None:
        for estimate in sorted(estimates, key=lambda one: one.arrival):
            if self._problem.deadline.expired():
                return None
            arrival = self._problem.began + estimate.arrival
            self._problem.tell(Note(f"a way {estimate.path.name} may arrive at {arrival:.2f} s"))
            if (finished := self._along(estimate.path)) is not None:
                return finished
        return None

    def by_thorough_paths(self, through: Through) -> CertifiedMotion | None:
        """The motion along the path of the planner among obstacles at rest; None if there is none."""
        if self._problem.deadline.expired():
            return None
        resting, words = self._resting, "to the goal, among the obstacles once they rest"
        crossed, goals = through(resting, PathSoFar.at_start(resting), True)
        found_paths: Iterable[PathSoFar] = (crossed,)
        if goals is not None and crossed.failure is None:
            found_paths = connections(resting, crossed, goals, self._stages, words)
        for found in found_paths:
            if found.failure is not None:
                self._ending = self._ending or found.failure
                return None
            if (finished := self._along(HeldPath("where they come to rest", resting, found, at_rest=True))) is not None:
                return finished
        return None

    def make_failure(self) -> CertifiedMotion:
        """The start alone, with the reason why there is no motion."""
        found = PathSoFar.at_start(self._problem).with_failure(self.why())
        return certify_found_path(self._problem.at(0.0), found, self._stages)

    def why(self) -> Ending:
        problem, (leave_by, refusal) = self._problem, self.leave_by
        if (status := problem.deadline.status()) is not None:
            last = f"; once they rest: {self._ending.message}" if self._ending else ""
            message = f"{end_reason(status)} before a motion among the obstacles that move was found{last}"
            return Ending(status, message, {"stage": "connect"})
        if self._excess is not None:
            return self._excess
        if refusal is not None:
            names, leave_by = " and ".join(refusal.pair or ("a link", "an obstacle")), problem.began + leave_by
            kept = f", where {problem.outside_proof}" if problem.motion_limits else ""
            message = (
                f"at {leave_by:.2f} s {names} meet where the robot starts, and no way was found that leaves before"
                f"{kept}"
            )
            details = {"stage": "start", "time": leave_by, "pair": list(refusal.pair) if refusal.pair else None}
            return Ending(Status.START_STATE_INVALID, message, details)
        if self._ending is not None:
            return make_ending_at_rest(problem, self._ending)
        if self._farthest is None:
            message = "no motion to the goal was certified among the obstacles that move"
            return Ending(Status.PLANNING_FAILED, message, {"stage": "connect"})
        return self._blocked_ending(*self._farthest)

    def _blocked_ending(self, _: float, z: LocalPoint) -> Ending:
        problem = self._problem
        found = clearance_at(self._resting.world, problem.group.expand_from_local(z))
        pair = list(found.obstacle_pair) if found.obstacle_pair else None
        names = " and ".join(pair) if pair else "what moves"
        message = f"no schedule along a way to the goal passes where {names} come near; the robot waited there in vain"
        time = problem.began + problem.scene.end
        return Ending(Status.PLANNING_FAILED, message, {"stage": "connect", "pair": pair, "time": time})

    def _estimates(self, paths: Iterator[HeldPath]) -> Iterator[_Estimate]:
        """Those of some paths that have a schedule, each path once.

        They end once one is hindered by nothing but a goal that isn't free yet, several in a row arrive no sooner, or
        a share of the time is up.
        """
        deadline, known = self._problem.deadline.share(PATH_SEARCH.share), set[tuple[bytes, bool]]()
        step, best, in_vain = choose_step(self._problem.group), np.inf, 0
        for held in paths:
            key = held.found.path.tobytes(), held.at_rest
            if len(remove_repetitions(held.found.path)) == 1 or key in known or not self._ends_free(held):
                continue
            known.add(key)
            if self._problem.motion_limits:  # they may let it be many times as slow
                motion = time_path(held.problem, held.found.path)
            else:
                motion = time_through_planes(held.problem, held.found, held.found.path)
            chosen = self._earliest(motion, self._occupancy(motion, at_rest=held.at_rest), PATH_SEARCH.rooms)
            if not chosen and deadline.expired():
                return
            if not chosen:
                continue
            arrival = chosen[0].arrival
            yield _Estimate(held, arrival)
            soonest = 0.0 if self._goals is None else min(map(self._from, self._goals))
            unhindered = PATH_SEARCH.unhindered * max(motion.duration, soonest) + step
            best, in_vain = (arrival, 0) if arrival < best - step else (best, in_vain + 1)
            if arrival <= unhindered or in_vain == PATH_SEARCH.patience or deadline.expired():
                return

    def _ends_free(self, held: HeldPath) -> bool:
        if self._goals is not None:
            return True
        return bool(are_free(self._resting, held.found.path[-1:])[0])

    def _along(self, held: HeldPath) -> CertifiedMotion | None:
        made, soonest = None, -np.inf
        if not held.detour:
            optimised = finish(held.problem, held.found, self._stages)
            made = self.schedule(optimised, at_rest=held.at_rest)
            soonest = soonest if optimised.trajectory is None else optimised.trajectory.duration
        is_as_found = made is None
        if made is None and not self._problem.deadline.expired():
            made, soonest = self._certify_as_found(held), -np.inf
        if made is None or made.trajectory is None:
            return None
        motion, distance = made.trajectory, SCHEDULE.distance + self._problem.min_clearance
        if motion.times[-1] <= soonest and keeps_distance(self._problem, motion, distance):
            return made  # what moves neither delays it nor comes near
        if self._problem.optimization_iterations == 0 or motion.duration == 0.0:
            return made
        better = self._improve(made)
        if better is not None or is_as_found or self._problem.deadline.expired():
            return better or made
        found = self._certify_as_found(held)  # its schedule may be sooner than that of the optimised shape
        if found is None or found.trajectory is None or found.trajectory.times[-1] >= motion.times[-1]:
            return made
        return self._improve(found) or found

    def _certify_as_found(self, held: HeldPath) -> CertifiedMotion | None:
        return self.schedule(certify_found_path(held.problem, held.found, self._stages), at_rest=held.at_rest)

    def _improve(self, made: CertifiedMotion) -> CertifiedMotion | None:
        """A scheduled motion optimised among what moves; None where that is no better."""
        assert made.trajectory is not None, "it is scheduled"
        between = self.leave_by[0], self._from(made.trajectory.positions[-1])
        crossed = CrossedPlanes.of(self._problem, made.path, made.crossings)
        better = optimize_motion(self._problem, made.trajectory, (), self._stages, crossed, between, self._judge)
        if better is None or not better.verdict.free or self._exceeds(better.trajectory):
            return None
        return replace(better, warnings=(*made.warnings, *better.warnings))

    def _exceeds(self, motion: Trajectory | None) -> bool:
        excess = find_excess(self._problem, motion)
        self._excess = excess or self._excess
        return excess is not None

    def _judge(self, problem: Problem, motion: Trajectory) -> Verdict:
        verdict = judge(problem, motion)
        if not verdict.free or self._also is None:
            return verdict
        kept = self._also(motion)
        return replace(kept, evaluations=verdict.evaluations + kept.evaluations)

    def schedule(self, finished: CertifiedMotion, *, at_rest: bool) -> CertifiedMotion | None:
        """Another motion with a schedule that meets nothing, certified; None where there is none."""
        if finished.trajectory is None or not finished.verdict.free:
            return None
        if finished.trajectory.duration == 0.0:
            made = self._certify(finished, finished.trajectory)
            return made if made.verdict.free and self._from(finished.trajectory.positions[-1]) <= 0.0 else None
        occupancy = self._occupancy(finished.trajectory, at_rest=at_rest)
        for _ in range(1 + SCHEDULE.repairs):
            with self._stages.enter("parameterize", "when to be where, among what moves") as stage:
                schedules = self._earliest(finished.trajectory, occupancy, SCHEDULE.rooms)
                motions = ((one, retime(self._problem, one)) for one in schedules)
                within = ((one, motion) for one, motion in motions if motion is not None and not self._exceeds(motion))
                found = next(within, None)
                stage.outcome = "blocked" if found is None else f"departs at {found[0].departure:.2f} s"
            if found is None:
                return None
            schedule, motion = found
            made = self._certify(finished, motion)
            if made.verdict.free:
                return made
            if self._problem.deadline.status() or made.verdict.piece is None:
                return None
            self._take_out(occupancy, finished.trajectory, schedule, motion, made.verdict)
        return None

    def _occupancy(self, motion: Trajectory, *, at_rest: bool) -> Occupancy:
        return Occupancy(
            self._problem.group,
            motion,
            self._slices,
            self.leave_by[0],
            self._from(motion.positions[-1]),
            free_at_rest=at_rest,
        )

    def _from(self, goal: LocalPoint) -> float:
        key = goal.tobytes()
        if key not in self._free_from:
            self._free_from[key] = find_free_from(self._problem, goal)
        return self._free_from[key]

    def _earliest(self, motion: Trajectory, occupancy: Occupancy, rooms: Sequence[float]) -> list[Schedule]:
        problem, even = self._problem, schedule_at_one_rate(self._problem, motion, occupancy)
        found, by = [even], even.arrival if isinstance(even, Schedule) else np.inf
        found += [
            schedule_at_any_rate(problem, motion, room, occupancy, by) for room in rooms if motion.duration / room < by
        ]
        waits = isinstance(even, Stuck) or bool(problem.motion_limits)  # at its own rate it keeps all limits
        if waits and occupancy.free_at_rest and occupancy.leave_by == np.inf:
            found.append(depart_after(motion, problem.scene.end, choose_step(problem.group)))
        schedules = sorted((one for one in found if isinstance(one, Schedule)), key=lambda one: one.arrival)
        if not schedules:
            cell = max(one.cell for one in found if isinstance(one, Stuck))
            share = cell / occupancy.count
            if self._farthest is None or share > self._farthest[0]:
                self._farthest = share, occupancy.point(min(cell + 1, occupancy.count - 1))
        return schedules

    def _certify(self, finished: CertifiedMotion, motion: Trajectory) -> CertifiedMotion:
        certified = certify_motion(self._problem, motion, {}, self._stages, self._judge)
        return replace(finished, verdict=certified.verdict, trajectory=certified.trajectory)

    def _take_out(
        self, occupancy: Occupancy, along: Trajectory, schedule: Schedule, motion: Trajectory, verdict: Verdict
    ) -> None:
        """Exclude the place and time at which the certificate refused a motion from further schedules."""
        assert verdict.piece is not None, "it was refused somewhere"
        assert verdict.parameter is not None, "it was refused somewhere"
        begin, end = motion.times[verdict.piece], motion.times[verdict.piece + 1]
        when = float(begin + verdict.parameter * (end - begin))
        since = np.array([max(when - schedule.departure, 0.0)])
        own = float(schedule.at(since, schedule.step)[0][0]) * along.duration / schedule.motion.duration
        self._problem.tell(Note(f"refused at {self._problem.began + when:.2f} s: {verdict.reason.value}"))
        occupancy.take_out(when, min(max(own, 0.0), along.duration))
