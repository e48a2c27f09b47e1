"""Find a stream's next piece: along the path to the goal, else away from what comes close, or from what rests.

No piece is returned that the judge (`commit.py`) hasn't proven together with its stop. A path planned beside the cycle
is taken over here, and the next one ordered. `TRAVELLED_IN`, never 0, is time, and how close the bound is by which what
may appear refuses a piece. With another order of work, or of random draws, journals that are kept replay to other ones.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from guidefield.messages.streams import Reason, StreamOpen
from guidefield.robot.model.joints import LocalPoint
from guidefield.stream.commit import (
    Commit,
    CommitReason,
    CommitVerdict,
    Judge,
    SeenObstacles,
    join_commits,
    plan_commit,
)
from guidefield.stream.dodging import TimedPath, draw_flights, measure_pressures, pressure_slope
from guidefield.stream.obstacles import Obstacles
from guidefield.stream.opening import StreamSetup
from guidefield.stream.path_planner import INSIDE, NOTHING, BackgroundPlanner, PathPlanner, TakeOver
from guidefield.stream.settings import STREAM, WITHIN
from guidefield.stream.state import Event, Phase, Pursuit, State

GOAL_TOLERANCE = 1e-6  # a goal this close is reached [rad or m]: above `WITHIN` of settings.py, for goals at limits
TRAVELLED_IN = 20  # parts in which the travel of the robot is bounded, before what appears can have come

LeadsTo = Literal["goal", "away"]  # the direction of a piece, as `Piece.leads_to` has it


class Cycle:
    """The data of one update's answer: the executed commits and observations; and the reasons so far."""

    def __init__(
        self,
        now: float,
        begins: float,
        state: State,
        executed: list[Commit],
        broken: CommitVerdict | None,
        seen: SeenObstacles,
    ) -> None:
        self.now, self.begins, self.state = now, begins, state
        self.executed, self.base = executed, executed[-1]
        self.broken, self.seen = broken, seen
        self.reason: Reason = "too_close"
        self.verdict: CommitVerdict | None = None
        self.threatened = False
        self.evaluations = 0


class PieceFinder:
    """Finds the pieces of one stream; its state, obstacles and random numbers change from cycle to cycle."""

    def __init__(
        self,
        request: StreamOpen,
        setup: StreamSetup,
        judge: Judge,
        obstacles: Obstacles,
        paths: PathPlanner,
        planner: BackgroundPlanner,
        taking: TakeOver,
        rng: np.random.Generator,
    ) -> None:
        self._request, self._setup, self._group = request, setup, setup.group
        self._judge, self._obstacles, self._paths = judge, obstacles, paths
        self._planner, self._taking, self._rng = planner, taking, rng
        self._speeds = setup.bounds.rates[:, 0]

    def find(self, cycle: Cycle) -> tuple[Commit, LeadsTo] | None:
        """Find a proven piece, and say what it leads to; None if there is none, then the cycle knows why."""
        state = np.ascontiguousarray(cycle.base.state(cycle.begins)[:, :3])
        still = self._make_commit(cycle, state, np.zeros(self._group.nv), None)
        pursuit = cycle.state.pursuit
        found = self._follow(cycle, pursuit, state, still)
        # a robot that comes to the goal stands there first: the piece that leads there is proven
        arriving = cycle.reason == "at_goal" and cycle.now < cycle.base.stops
        if (found is None and not arriving) or cycle.threatened:
            found = self._flee(cycle, state, still) or found
        if found is None and cycle.reason in ("too_close", "no_way") and not state[:, 1:].any():
            found = self._leave(cycle, state, still)
        if pursuit is not None:
            pursuit.refused = 0 if found is not None else pursuit.refused + 1
        return found

    def _make_commit(self, cycle: Cycle, state: np.ndarray, velocities: np.ndarray, last: LocalPoint | None) -> Commit:
        """The commit of a piece from a state (nv, 3) towards velocities (nv,), or lower ones for limits in space."""
        goals, slowed = np.full(self._group.nv, np.inf) if last is None else last, 0
        while True:
            bounds = self._setup.bounds
            commit = plan_commit(state, velocities, goals, bounds, cycle.begins, self._request.piece, WITHIN)
            if slowed == STREAM.slowed or not velocities.any():
                return commit
            if (share := self._judge.speed_share(commit)) <= 1.0:
                return commit
            velocities, slowed = velocities * (STREAM.in_space / share), slowed + 1

    def _follow(
        self, cycle: Cycle, pursuit: Pursuit | None, state: np.ndarray, still: Commit
    ) -> tuple[Commit, LeadsTo] | None:
        """A proven piece along the path to the goal, or None; then the cycle knows why."""
        if pursuit is None:
            cycle.reason = "standing"
            return None
        if cycle.base.at_goal and cycle.base.goal == cycle.state.goal:
            cycle.reason = "at_goal"
            return None
        path = self._update_path(cycle, pursuit, still.ends)
        since = pursuit.place
        for share in STREAM.speeds:
            aim = path.aim(still.ends, since, STREAM.ahead * share, path.due(cycle.begins + STREAM.early))
            pursuit.place = aim.place
            largest = float((np.abs(aim.direction) / self._speeds).max())
            velocities = aim.direction * (share / largest) if largest > 0.0 else aim.direction
            commit = self._make_commit(cycle, state, velocities, aim.last)
            if (commit.ends == state[:, 0]).all() and not state[:, 1:].any():
                if self.is_at_goal(cycle.state, commit.ends):
                    cycle.reason = "at_goal"
                    return None
                break
            closing = aim.last is not None and bool((aim.last == path.goal).all())  # then there is nothing to go on to
            if self._prove(cycle, commit, reserved=not closing):
                flees = share <= STREAM.threatened and self._is_threatened(
                    cycle, commit.ends, path, pursuit.place, share
                )
                stays = closing and flees and self._paths.is_goal_free(self._obstacles.drifting(cycle.now), path.goal)
                cycle.threatened = flees and not stays
                return commit, "goal"
        if cycle.verdict is None or pursuit.unfound:
            cycle.reason = "no_way"
        return None

    def _is_threatened(self, cycle: Cycle, end: LocalPoint, path: TimedPath, place: float, share: float) -> bool:
        """Return whether what is foreseen comes close to a piece's end (nv,), and to where the path leads by then.

        The piece ends at a place of the path [s].
        """
        boxes = self._obstacles.boxes([cycle.now + STREAM.foreseen])
        then = min(place + STREAM.foreseen * share, path.due(cycle.now + STREAM.foreseen))
        places = (end, path.at(max(then, place)))
        near = STREAM.threat * self._group.size
        return bool((measure_pressures(self._paths.batch, boxes, np.array(places), near) > 0.0).all())

    def _flee(self, cycle: Cycle, state: np.ndarray, still: Commit) -> tuple[Commit, LeadsTo] | None:
        """A proven piece away from what is predicted to come close, or None."""
        boxes = self._obstacles.boxes([cycle.now + STREAM.foreseen])
        if not len(boxes):
            return None
        near = STREAM.near * self._group.size
        batch = self._paths.batch
        before = float(measure_pressures(batch, boxes, still.ends[None], near)[0])
        if before <= 0.0:
            return None
        directions = draw_flights(pressure_slope(batch, boxes, still.ends, near), self._speeds, self._rng)
        commits = [self._make_commit(cycle, state, velocities, None) for velocities in directions]
        after = measure_pressures(batch, boxes, np.array([one.ends for one in commits]), near).tolist()
        tried = [(now, k, one) for k, (now, one) in enumerate(zip(after, commits, strict=True)) if now < before]
        return self._choose_flight(cycle, tried, reserved=False)

    def _leave(self, cycle: Cycle, state: np.ndarray, still: Commit) -> tuple[Commit, LeadsTo] | None:
        """A proven piece from where the robot stands to where it keeps more from what rests, or None."""
        before = self._paths.count_kept(still.ends)
        if before == len(STREAM.leaving):
            return None
        tried: list[tuple[float, int, Commit]] = []
        for velocities in draw_flights(np.zeros(self._group.nv), self._speeds, self._rng):
            for towards_it in (velocities, -velocities):
                commit = self._make_commit(cycle, state, towards_it, None)
                after = self._paths.count_kept(commit.ends)
                if after > before:
                    tried.append((-after, len(tried), commit))
        return self._choose_flight(cycle, tried, reserved=True)

    def _choose_flight(
        self, cycle: Cycle, tried: list[tuple[float, int, Commit]], *, reserved: bool
    ) -> tuple[Commit, LeadsTo] | None:
        """Return the first proven commit by cost and order, or None."""
        for _, _, commit in sorted(tried, key=lambda one: one[:2])[: STREAM.flights]:
            if self._prove(cycle, commit, reserved):
                if cycle.state.pursuit is not None:
                    cycle.state.pursuit.place = 0.0  # the path may be nearest elsewhere then
                return commit, "away"
        return None

    def _prove(self, cycle: Cycle, commit: Commit, reserved: bool) -> bool:
        """Return whether a commit is proven; the cycle keeps the first refusal."""
        verdict = self._judge.judge(commit, cycle.seen, STREAM.evaluations, reserved=reserved)
        cycle.evaluations = verdict.evaluations
        if verdict.free and not self._is_seen_far_enough(cycle, commit):
            verdict = CommitVerdict(CommitReason.UNDECIDED, verdict.evaluations, -1, commit.stops)
        if not verdict.free and cycle.verdict is None:
            cycle.verdict = verdict
        return verdict.free

    def _is_seen_far_enough(self, cycle: Cycle, commit: Commit) -> bool:
        """Return whether an obstacle that isn't observed yet can't reach the robot before it stands."""
        request = self._request
        if request.appear_distance is None:
            return True
        until = join_commits([*cycle.executed, commit])
        gone = self._judge.bound_travel(until, cycle.seen, cycle.now, commit.stops, TRAVELLED_IN)
        come = request.appear_speed * (commit.stops - cycle.now + request.clock_error)
        return gone + come < request.appear_distance

    def _update_path(self, cycle: Cycle, pursuit: Pursuit, stand: LocalPoint) -> TimedPath:
        """The path to follow; takes a planned one over, and orders the next one, if it is time."""
        state, goal = cycle.state, self._choose_goal(cycle, pursuit, stand)
        if (ordered := state.ordered) is not None and self._taking.takes(ordered, cycle.now):
            found = ordered.found.result()
            pursuit.unfound = found.nowhere
            if found.path is not None and self.is_same(ordered.goal, goal):
                pursuit.follow(TimedPath(found.path.points, self._speeds, ordered.due + STREAM.lag + found.path.times))
            state.enter(Event.TAKE)
        if pursuit.path is None or not self.is_same(pursuit.path.goal, goal):
            pursuit.follow(TimedPath(np.array([stand, goal]), self._speeds))
        assert pursuit.path is not None, "one is followed"
        if state.phase is Phase.FOLLOWING:
            self._order_if_due(cycle, pursuit, pursuit.path, stand, goal)
        return pursuit.path

    def _order_if_due(
        self, cycle: Cycle, pursuit: Pursuit, path: TimedPath, stand: LocalPoint, goal: LocalPoint
    ) -> None:
        """Have a path planned where the one that is followed isn't free of what rests, or something moves.

        It begins on the path that is followed, where the robot could stand when it is taken over; or where it could
        stand now, if it isn't on its path.
        """
        state, speeds = cycle.state, self._speeds
        due = cycle.now + self._request.planning_time
        drifting = self._obstacles.drifting(due + STREAM.lag)
        goes = pursuit.refused < STREAM.refused and self._is_free(path, pursuit.place, stand)
        again = len(drifting.boxes) > 0 and cycle.now >= state.planned + self._request.planning_time + STREAM.again
        if goes and not again:
            return
        start, followed = stand, None
        if goes:
            place = path.nearest(stand, pursuit.place, pursuit.place + STREAM.looked_at)
            share = float((np.abs(cycle.base.state(cycle.begins)[:, 1]) / speeds).max())
            goes_on = self._request.planning_time * min(1.0, share)
            then = max(place, min(place + goes_on, path.due(due + STREAM.early)))
            if (np.abs(path.at(then) - stand) / speeds).max() <= STREAM.on_it * goes_on:
                start, place = path.at(then), then
            followed = path.rest(start, place)
        state.order(self._planner.order(due, start, goal, drifting, followed, self._rng))
        pursuit.refused = 0

    def _choose_goal(self, cycle: Cycle, pursuit: Pursuit, stand: LocalPoint) -> LocalPoint:
        """The goal that is nearest (nv,), of those that nothing is predicted on if there are any."""
        goals, path = pursuit.goals, pursuit.path
        boxes = self._obstacles.boxes([cycle.now, cycle.now + STREAM.predicted])
        taken = np.array([(self._paths.gaps(boxes, z) < -INSIDE * self._group.size).any() for z in goals], bool)
        if taken.all():
            cycle.reason = "goal_taken"
            taken[:] = False
        if path is not None:
            same = [k for k, goal in enumerate(goals) if self.is_same(path.goal, goal)]
            if same and not taken[same[0]]:
                chosen: LocalPoint = goals[same[0]]
                return chosen
        far = np.abs((goals - stand) / self._speeds).max(axis=1)
        nearest: LocalPoint = goals[np.argmin(np.where(taken, np.inf, far))]
        return nearest

    def is_same(self, z: LocalPoint, goal: LocalPoint) -> bool:
        """Return whether a point (nv,) is a goal (nv,), but for whole turns of joints that turn without end."""
        return bool((np.abs(self._group.unwrapped(goal, z) - z) <= GOAL_TOLERANCE).all())

    def _is_free(self, path: TimedPath, place: float, stand: LocalPoint) -> bool:
        points = path.rest(stand, place, place + STREAM.looked_at)
        clearance = self._paths.choose_clearance(STREAM.resting_looked_at, [stand, path.goal])
        return self._paths.is_free(NOTHING, STREAM.going, clearance, points)

    def is_at_goal(self, state: State, z: LocalPoint) -> bool:
        """Return whether a point (nv,) is the goal to which the followed path leads."""
        path = None if state.pursuit is None else state.pursuit.path
        return path is not None and bool((np.abs(z - path.goal) <= GOAL_TOLERANCE).all())
