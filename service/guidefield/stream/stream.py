"""A stream in one process, driven by the caller's clock: observations go in, certified pieces come out.

Each update is a cycle: take observations, follow the path to the goal by a proven piece, else flee from what comes
close, else say why there is none. No piece is sent that the judge hasn't proven together with its stop. With another
order of work, or of random draws, journals that are kept replay to other pieces.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Any, TypeVar, cast

import numpy as np

from guidefield.errors import (
    GuidefieldError,
    InvalidConfiguration,
    InvalidGoal,
    MalformedRequest,
    at_path,
)
from guidefield.kernels.collide import drift
from guidefield.kernels.jit.compilers import load
from guidefield.kernels.prove import search
from guidefield.kernels.stream import dodge, judge, way
from guidefield.kernels.timing import carried_rates
from guidefield.kernels.tree import rrt_connect, shortcut
from guidefield.messages import codec
from guidefield.messages.streams import Piece, Reason, StreamGoal, StreamOpen, StreamState, StreamUpdate
from guidefield.messages.values import ORIGIN
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.configuration import configuration_from_wire
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.spaces import ChartPoint, ChartPoints
from guidefield.scene.anchor import Anchor
from guidefield.scene.scene import Scene
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
from guidefield.stream.opening import read_opening
from guidefield.stream.path_planner import (
    INSIDE,
    NOTHING,
    BackgroundPlanner,
    FixedDelay,
    PathOrder,
    PathPlanner,
    TakeOver,
    find_goals,
)
from guidefield.stream.settings import STREAM, WITHIN
from guidefield.stream.state import (
    MAX_COMMITS,
    Event,
    KeptObstacle,
    Phase,
    Pursuit,
    Snapshot,
    State,
    StreamWatcher,
    Watchers,
    random_state,
    restore_random,
)

_A = TypeVar("_A", bound=Piece | StreamState | None)

GOAL_TOLERANCE = 1e-6  # a configuration this close to a goal has reached it [rad or m]
TRAVELLED_IN = 20  # parts in which the travel of the robot is bounded, before what appears can have come
SLACK = 1e-6
"""Deviation of joints that is allowed beyond the tolerance, for rounded numbers [rad or m]: no proof covers it."""

KERNELS = (
    search,
    dodge,
    drift,
    judge,
    rrt_connect,
    shortcut,
    way,
)  # loaded when a stream opens: else its first update would wait for them, 30 to 60 ms


@dataclass(frozen=True)
class GoalSearch:
    """A search for configurations of a goal."""

    number: int
    found: Future[ChartPoints]  # the configurations, shape (k, nv)


class CertifiedStream:
    """A stream of pieces, each of which ends in a proven stop. It reads no clock: the same updates get the same bits.

    Args:
        taking: The rule by which paths planned beside the cycle are taken over; None: after `planning_time`.
        watching: A watcher of its queries and answers; None: none.

    Raises:
        GuidefieldError: if the request is ill-posed.
    """

    def __init__(
        self,
        request: StreamOpen,
        robot: RobotModel,
        scene: Scene,
        taking: TakeOver | None = None,
        watching: StreamWatcher | None = None,
    ) -> None:
        for kernels in (*KERNELS, *([carried_rates] if request.cartesian_limits else [])):
            load(kernels)
        anchor, self.request = Anchor.of(request, lambda _: robot), request
        coarse = () if anchor is None else anchor.coarse_warnings(request, scene)
        self._inward: Callable[[Any], Any] = (lambda message: message) if anchor is None else anchor.inward
        self.origin = ORIGIN if anchor is None else anchor.place
        scene = scene if anchor is None else anchor.see(scene)
        self._opened = asked = read_opening(self._inward(request), robot, scene, coarse)
        self.group, self.scene = asked.group, scene
        keeping = (request.min_clearance, request.tracking_tolerance)
        self._paths = PathPlanner(asked.group, asked.world, asked.bounds, *keeping)
        self._taking: TakeOver = taking or FixedDelay()
        beside = PathPlanner(asked.group, asked.world, asked.bounds, *keeping)
        self._planner = BackgroundPlanner(beside, self._taking.niceness)
        self._obstacles = Obstacles(scene, asked.assumption, asked.bodies_met, self.origin)
        for index, one in enumerate(request.obstacles):
            self._obstacles.take(self._obstacles.prepare(one, f"$.obstacles[{index}]", asked.group.robot.links))
        tolerances = np.full(asked.group.nv, request.tracking_tolerance)
        self._judge = Judge(asked.world, asked.bounds, request.min_clearance, tolerances, asked.cartesian_limits)
        self._rng = np.random.default_rng(request.seed)
        self._speeds = asked.bounds.rates[:, 0]
        self._state = State.at_rest(asked.start)
        self._seeking = 0
        self._pieces: deque[Piece] = deque(maxlen=MAX_COMMITS)
        self._watching = StreamWatcher()
        if request.goal is not None:
            try:
                self.aim_for(request.goal)
            except InvalidGoal as error:
                self.close()
                raise InvalidGoal("; ".join([error.message, *asked.touching]), **error.details) from None
            except BaseException:
                self.close()
                raise
        self._watching = watching or StreamWatcher()
        self._rest_if_wanted()

    def watch(self, watching: StreamWatcher) -> None:
        """Have one more watcher hear of it."""
        self._watching = Watchers(self._watching, watching)

    def close(self) -> None:
        """End the stream; what was sent last is executed to its end."""
        self._state.enter(Event.CLOSE)
        self._planner.close()

    @property
    def warnings(self) -> tuple[str, ...]:
        """Harmless peculiarities of the request, and of shapes that were declared since."""
        return (*self._opened.warnings, *self._obstacles.warnings)

    def __enter__(self) -> CertifiedStream:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> Iterator[Piece]:
        while self._pieces:
            yield self._pieces.popleft()

    @property
    def executing(self) -> Commit:
        """The commit that was sent last, as values."""
        return self._state.commits[self._state.last]

    @property
    def goal_number(self) -> int:
        """Number of the goal that was set last; 0: there was none."""
        return self._state.goal

    def aim_for(self, goal: StreamGoal | dict[str, Any] | None) -> int:
        """Change the goal; null: to stand. Going on after a stop is asked for in the same way.

        Returns:
            The goal's number, which its pieces have.

        Raises:
            GuidefieldError: if it is ill-posed, or can't be reached.
        """
        return self.take_goal(None if goal is None else self.seek(goal))

    def seek(self, goal: StreamGoal | dict[str, Any]) -> GoalSearch:
        """Search for the configurations of a goal beside the cycle, from where the robot will stand.

        Each search has to be given to `take_goal`, in the order of the calls, also if it failed.
        """
        self._state.require_open()
        asked: StreamGoal = codec.convert(goal, StreamGoal) if isinstance(goal, dict) else goal
        state = self._state
        state.sought, self._seeking = state.sought + 1, self._seeking + 1
        rng = np.random.default_rng([self.request.seed, state.sought])
        work = partial(_search_goals, self._inward(asked), self.group, self.executing.ends, rng)
        self._watching.seek(asked)
        return GoalSearch(state.sought, self._planner.submit(work))

    def take_goal(self, sought: GoalSearch | None) -> int:
        """Aim for what `seek` found from now on, and wait for it; None: to stand.

        Returns:
            The goal's number, which its pieces have.

        Raises:
            GuidefieldError: if the goal is ill-posed, or can't be reached; then the one before stays.
        """
        if sought is not None:
            self._seeking -= 1
        goals = None if sought is None else sought.found.result()
        self._watching.aimed(None if sought is None else sought.number)
        self._state.aim(goals)
        return self._state.goal

    def stop(self) -> None:
        """Have no piece follow the last one, until there is a goal again: the robot stops."""
        self._state.enter(Event.STOP)
        self._watching.halted()

    def update(self, update: StreamUpdate | dict[str, Any] | None = None, /, **fields: Any) -> Piece | StreamState:
        """Tell what is seen, and get the next piece, or why there is none.

        Args:
            fields: As in `StreamUpdate`.

        Raises:
            GuidefieldError: if the update is ill-posed. What was sent before holds.
            StreamUnknown: if the stream is closed.
        """
        self._state.require_open()
        if not isinstance(update, StreamUpdate):
            update = cast(StreamUpdate, codec.convert({**(update or {}), **codec.plain_fields(fields)}, StreamUpdate))
        return self._report(update, self._answer_update, noted=False)

    def _report(self, update: StreamUpdate, work: Callable[[StreamUpdate], _A], *, noted: bool) -> _A:
        """Work on an update, and tell the watchers of it."""
        self._watching.begin_update()
        ordered = self._state.ordered
        try:
            answer = work(update)
        except GuidefieldError as error:
            self._watching.updated(update, None, error, noted=noted, took=self._has_taken(ordered))
            raise
        self._watching.updated(update, answer, None, noted=noted, took=self._has_taken(ordered))
        self._rest_if_wanted()
        return answer

    def _has_taken(self, ordered: PathOrder | None) -> bool:
        return ordered is not None and self._state.ordered is not ordered

    def _answer_update(self, update: StreamUpdate) -> Piece | StreamState:
        state = self._state
        if update.time <= state.now:
            return self._tell_state(update.time, "late")
        measured = None if update.joints is None else self._read_joints(update)
        self._require_followed(update)
        state.fresh |= self._take_observations(update)
        state.begin(update.time)
        now = update.time
        base = state.find_base(update.executing, now)
        state.current = base.number
        broken = self._find_break(now)
        off = 0.0
        if measured is not None:
            begun = state.find_executed(now)[0]
            if now >= base.stops:
                measured = self.group.unwrapped(measured, base.ends)
            off = float(np.abs(measured - begun.state(now)[:, 0]).max())
        if off > self.request.tracking_tolerance + SLACK:
            if measured is None or now < base.stops:
                return self._tell_none(now, "tracking", broken, base)
            base = self._stand_elsewhere(measured, base)
        if now - self._obstacles.oldest > self.request.age_limit:
            return self._tell_none(now, "stale", broken, base)
        executed, seen = state.find_executed(now), self._obstacles.see(STREAM.reserve)
        return self._find_piece(_Cycle(now, now + self.request.latency, executed, broken, seen))

    def _find_break(self, now: float) -> CommitVerdict | None:
        """The refusal of what is executed from now on; None: it is still proven, or no obstacle is new."""
        fresh, self._state.fresh = self._state.fresh, False
        if not fresh or now >= self._state.commits[self._state.current].stops:
            return None
        verdict = self.judged(now)
        return None if verdict.free else verdict

    def _tell_none(
        self,
        now: float,
        reason: Reason,
        broken: CommitVerdict | None,
        base: Commit,
        verdict: CommitVerdict | None = None,
    ) -> StreamState:
        """The state where there is no piece; an obstacle before the executed piece comes before other reasons."""
        if broken is not None:
            return self._tell_state(now, "appeared", broken, base)
        return self._tell_state(now, reason, verdict, base)

    def note(self, update: StreamUpdate) -> StreamState | None:
        """Take what an update says of obstacles and answer nothing, for a newer one is there already.

        Returns:
            The state of an update that comes too late; None otherwise.

        Raises:
            GuidefieldError: as `update`.
        """
        return self._report(update, self._take_note, noted=True)

    def _take_note(self, update: StreamUpdate) -> StreamState | None:
        if update.time <= self._state.now:
            return self._tell_state(update.time, "late")
        self._state.fresh |= self._take_observations(update)
        self._state.begin(update.time)
        return None

    def _rest_if_wanted(self) -> None:
        if not self._seeking:
            self._watching.may_rest(self.snapshot, planning=self._state.phase is Phase.PLANNING)

    def snapshot(self) -> Snapshot:
        """Return all that it goes on from; a path that is being planned is given up, and planned again later."""
        state = self._state
        if state.phase is Phase.PLANNING and state.pursuit is not None:
            state.enter(Event.TAKE)
            state.pursuit.refused = STREAM.refused
        known = self._obstacles.known.values()
        obstacles = tuple(KeptObstacle(one.declared, one.seen, one.gone) for one in known)
        return Snapshot(state.copy(), random_state(self._rng), obstacles)

    def resume(self, kept: Snapshot) -> None:
        """Go on from a snapshot of a stream that was opened with the same request, but for its goal and obstacles.

        Raises:
            GuidefieldError: if an obstacle of it can't be used here.
        """
        self._state = kept.state.copy()
        restore_random(self._rng, kept.random)
        self._obstacles.known.clear()
        for index, one in enumerate(kept.obstacles):
            links = self.group.robot.links
            self._obstacles.take(self._obstacles.prepare(one.declared, f"$.obstacles[{index}]", links))
            if one.seen is not None:
                self._obstacles.observe(one.seen)
            self._obstacles.known[one.declared.obstacle.name].gone = one.gone

    def judged(self, time: float) -> CommitVerdict:
        """Judge whether what is executed is still proven from a time on [s], by the last observations.

        These are the last update's; the piece that answered it counts, if there was one.
        """
        executed = join_commits(self._state.find_executed(time))
        return self._judge.judge(executed, self._obstacles.see(STREAM.reserve), STREAM.evaluations, since=time)

    def _take_observations(self, update: StreamUpdate) -> bool:
        """Take an update's observations; return whether an obstacle is new."""
        declared = [
            self._obstacles.prepare(one, f"$.declare[{index}]", self.group.robot.links)
            for index, one in enumerate(update.declare)
        ]
        self._obstacles.require(declared, update)
        for one in declared:
            self._obstacles.take(one)
        for name in update.gone:
            self._obstacles.lose(name)
        fresh = False
        for seen in update.obstacles:
            fresh |= self._obstacles.observe(seen)
        return fresh or bool(update.declare)

    def _read_joints(self, update: StreamUpdate) -> ChartPoint:
        assert update.joints is not None, "it has"
        group = self.group
        with at_path("$.joints"):
            q = configuration_from_wire(group.robot, update.joints, base=group.q_reference)
        planned = {joint.name for joint in group.joints}
        given = set(update.joints) & planned
        if given != planned:
            raise InvalidConfiguration(
                f"`$.joints` must have every joint that moves; missing are {', '.join(sorted(planned - given))}",
                path="$.joints",
            )
        return group.unwrapped(group.chart(group.part_of(q)), self.executing.state(update.time)[:, 0])

    def _require_followed(self, update: StreamUpdate) -> None:
        """Refuse an update that no piece could follow."""
        number = update.executing
        if number is not None and number not in self._state.commits:
            raise MalformedRequest(
                f"`executing` must be the number of one of the last {MAX_COMMITS} pieces, got {number}; the last is"
                f" {self._state.last}",
                path="$.executing",
            )
        if len(self._state.find_pending(self._state.last, update.time)) >= MAX_COMMITS:
            raise MalformedRequest(
                f"{MAX_COMMITS - 1} pieces haven't begun yet, and more can't be remembered: send updates further apart,"
                " or ask for less `latency`",
                path="$.time",
            )

    def _stand_elsewhere(self, z: ChartPoint, base: Commit) -> Commit:
        """Go on from z (nv,), where the robot stands although its piece ended elsewhere."""
        stood = Commit.standing(z, self._state.now, base.number, self._state.goal)
        self._state.stand_at(stood)
        return stood

    def _find_piece(self, cycle: _Cycle) -> Piece | StreamState:
        if self._state.phase is Phase.HALTED:
            return self._tell_none(cycle.now, "stopped", cycle.broken, cycle.base)
        state = np.ascontiguousarray(cycle.base.state(cycle.begins)[:, :3])
        still = self._make_commit(cycle, state, np.zeros(self.group.nv), None)
        pursuit = self._state.pursuit
        found = self._follow(cycle, pursuit, state, still)
        # a robot that comes to the goal stands there first: the piece that leads there is proven
        arriving = cycle.reason == "at_goal" and cycle.now < cycle.base.stops
        if (found is None and not arriving) or cycle.threatened:
            found = self._flee(cycle, state, still) or found
        if found is None and cycle.reason in ("too_close", "no_way") and not state[:, 1:].any():
            found = self._leave(cycle, state, still)
        if pursuit is not None:
            pursuit.refused = 0 if found is not None else pursuit.refused + 1
        if found is not None:
            return self._send(cycle, *found)
        verdict = None if cycle.reason in ("standing", "at_goal") else cycle.verdict  # of a flight that was refused
        return self._tell_none(cycle.now, cycle.reason, cycle.broken, cycle.base, verdict)

    def _make_commit(self, cycle: _Cycle, state: np.ndarray, velocities: np.ndarray, last: ChartPoint | None) -> Commit:
        """The commit of a piece from a state (nv, 3) towards velocities (nv,), or lower ones for limits in space."""
        goals, slowed = np.full(self.group.nv, np.inf) if last is None else last, 0
        while True:
            bounds = self._opened.bounds
            commit = plan_commit(state, velocities, goals, bounds, cycle.begins, self.request.piece, WITHIN)
            if slowed == STREAM.slowed or not velocities.any():
                return commit
            if (share := self._judge.speed_share(commit)) <= 1.0:
                return commit
            velocities, slowed = velocities * (STREAM.in_space / share), slowed + 1

    def _follow(
        self, cycle: _Cycle, pursuit: Pursuit | None, state: np.ndarray, still: Commit
    ) -> tuple[Commit, str] | None:
        """A proven piece along the path to the goal, or None; then the cycle knows why."""
        if pursuit is None:
            cycle.reason = "standing"
            return None
        if cycle.base.at_goal and cycle.base.goal == self._state.goal:
            cycle.reason = "at_goal"
            return None
        way = self._update_way(cycle, pursuit, still.ends)
        since = pursuit.place
        for share in STREAM.speeds:
            aim = way.aim(still.ends, since, STREAM.ahead * share, way.due(cycle.begins + STREAM.early))
            pursuit.place = aim.place
            largest = float((np.abs(aim.direction) / self._speeds).max())
            velocities = aim.direction * (share / largest) if largest > 0.0 else aim.direction
            commit = self._make_commit(cycle, state, velocities, aim.last)
            if (commit.ends == state[:, 0]).all() and not state[:, 1:].any():
                if self._is_at_goal(commit.ends):
                    cycle.reason = "at_goal"
                    return None
                break
            closing = aim.last is not None and bool((aim.last == way.goal).all())  # then there is nothing to go on to
            if self._prove(cycle, commit, reserved=not closing):
                flees = share <= STREAM.threatened and self._is_threatened(
                    cycle, commit.ends, way, pursuit.place, share
                )
                stays = closing and flees and self._paths.is_goal_free(self._obstacles.drifting(cycle.now), way.goal)
                cycle.threatened = flees and not stays
                return commit, "goal"
        if cycle.verdict is None or pursuit.unfound:
            cycle.reason = "no_way"
        return None

    def _is_threatened(self, cycle: _Cycle, end: ChartPoint, way: TimedPath, place: float, share: float) -> bool:
        """Return whether what is foreseen comes close to a piece's end (nv,), and to where the path leads by then.

        The piece ends at a place of the path [s].
        """
        boxes = self._obstacles.boxes([cycle.now + STREAM.foreseen])
        then = min(place + STREAM.foreseen * share, way.due(cycle.now + STREAM.foreseen))
        places = (end, way.at(max(then, place)))
        near = STREAM.threat * self.group.size
        return bool((measure_pressures(self._paths.lanes, boxes, np.array(places), near) > 0.0).all())

    def _flee(self, cycle: _Cycle, state: np.ndarray, still: Commit) -> tuple[Commit, str] | None:
        """A proven piece away from what is predicted to come close, or None."""
        boxes = self._obstacles.boxes([cycle.now + STREAM.foreseen])
        if not len(boxes):
            return None
        near = STREAM.near * self.group.size
        lanes = self._paths.lanes
        before = float(measure_pressures(lanes, boxes, still.ends[None], near)[0])
        if before <= 0.0:
            return None
        directions = draw_flights(pressure_slope(lanes, boxes, still.ends, near), self._speeds, self._rng)
        commits = [self._make_commit(cycle, state, velocities, None) for velocities in directions]
        after = measure_pressures(lanes, boxes, np.array([one.ends for one in commits]), near).tolist()
        tried = [(now, k, one) for k, (now, one) in enumerate(zip(after, commits, strict=True)) if now < before]
        return self._choose_flight(cycle, tried, reserved=False)

    def _leave(self, cycle: _Cycle, state: np.ndarray, still: Commit) -> tuple[Commit, str] | None:
        """A proven piece from where the robot stands to where it keeps more from what rests, or None."""
        before = self._paths.count_kept(still.ends)
        if before == len(STREAM.leaving):
            return None
        tried: list[tuple[float, int, Commit]] = []
        for velocities in draw_flights(np.zeros(self.group.nv), self._speeds, self._rng):
            for towards_it in (velocities, -velocities):
                commit = self._make_commit(cycle, state, towards_it, None)
                after = self._paths.count_kept(commit.ends)
                if after > before:
                    tried.append((-after, len(tried), commit))
        return self._choose_flight(cycle, tried, reserved=True)

    def _choose_flight(
        self, cycle: _Cycle, tried: list[tuple[float, int, Commit]], *, reserved: bool
    ) -> tuple[Commit, str] | None:
        """Return the first proven commit by cost and order, or None."""
        for _, _, commit in sorted(tried, key=lambda one: one[:2])[: STREAM.flights]:
            if self._prove(cycle, commit, reserved):
                if self._state.pursuit is not None:
                    self._state.pursuit.place = 0.0  # the path may be nearest elsewhere then
                return commit, "away"
        return None

    def _prove(self, cycle: _Cycle, commit: Commit, reserved: bool) -> bool:
        """Return whether a commit is proven; the cycle keeps the first refusal."""
        verdict = self._judge.judge(commit, cycle.seen, STREAM.evaluations, reserved=reserved)
        cycle.evaluations = verdict.evaluations
        if verdict.free and not self._is_seen_far_enough(cycle, commit):
            verdict = CommitVerdict(CommitReason.UNDECIDED, verdict.evaluations, -1, commit.stops)
        if not verdict.free and cycle.verdict is None:
            cycle.verdict = verdict
        return verdict.free

    def _is_seen_far_enough(self, cycle: _Cycle, commit: Commit) -> bool:
        """Return whether an obstacle that isn't observed yet can't reach the robot before it stands."""
        asked = self.request
        if asked.appear_distance is None:
            return True
        until = join_commits([*cycle.executed, commit])
        gone = self._judge.bound_travel(until, cycle.seen, cycle.now, commit.stops, TRAVELLED_IN)
        come = asked.appear_speed * (commit.stops - cycle.now + asked.clock_error)
        return gone + come < asked.appear_distance

    def _update_way(self, cycle: _Cycle, pursuit: Pursuit, stand: ChartPoint) -> TimedPath:
        """The path to follow; takes a planned one over, and orders the next one, if it is time."""
        state, goal = self._state, self._choose_goal(cycle, pursuit, stand)
        if (ordered := state.ordered) is not None and self._taking.takes(ordered, cycle.now):
            found = ordered.found.result()
            pursuit.unfound = found.nowhere
            if found.way is not None and self._is_same(ordered.goal, goal):
                pursuit.follow(TimedPath(found.way.points, self._speeds, ordered.due + STREAM.lag + found.way.times))
            state.enter(Event.TAKE)
        if pursuit.way is None or not self._is_same(pursuit.way.goal, goal):
            pursuit.follow(TimedPath(np.array([stand, goal]), self._speeds))
        assert pursuit.way is not None, "one is followed"
        if state.phase is Phase.FOLLOWING:
            self._order_if_due(cycle, pursuit, pursuit.way, stand, goal)
        return pursuit.way

    def _order_if_due(
        self, cycle: _Cycle, pursuit: Pursuit, way: TimedPath, stand: ChartPoint, goal: ChartPoint
    ) -> None:
        """Have a path planned where the one that is followed isn't free of what rests, or something moves.

        It begins on the path that is followed, where the robot could stand when it is taken over; or where it could
        stand now, if it isn't on its path.
        """
        state, speeds = self._state, self._speeds
        due = cycle.now + self.request.planning_time
        drifting = self._obstacles.drifting(due + STREAM.lag)
        goes = pursuit.refused < STREAM.refused and self._is_free(way, pursuit.place, stand)
        again = len(drifting.boxes) > 0 and cycle.now >= state.planned + self.request.planning_time + STREAM.again
        if goes and not again:
            return
        start, followed = stand, None
        if goes:
            place = way.nearest(stand, pursuit.place, pursuit.place + STREAM.looked_at)
            share = float((np.abs(cycle.base.state(cycle.begins)[:, 1]) / speeds).max())
            goes_on = self.request.planning_time * min(1.0, share)
            then = max(place, min(place + goes_on, way.due(due + STREAM.early)))
            if (np.abs(way.at(then) - stand) / speeds).max() <= STREAM.on_it * goes_on:
                start, place = way.at(then), then
            followed = way.rest(start, place)
        state.order(self._planner.order(due, start, goal, drifting, followed, self._rng))
        pursuit.refused = 0

    def _choose_goal(self, cycle: _Cycle, pursuit: Pursuit, stand: ChartPoint) -> ChartPoint:
        """The goal that is nearest (nv,), of those that nothing is predicted on if there are any."""
        goals, way = pursuit.goals, pursuit.way
        boxes = self._obstacles.boxes([cycle.now, cycle.now + STREAM.predicted])
        taken = np.array([(self._paths.gaps(boxes, z) < -INSIDE * self.group.size).any() for z in goals], bool)
        if taken.all():
            cycle.reason = "goal_taken"
            taken[:] = False
        if way is not None:
            same = [k for k, goal in enumerate(goals) if self._is_same(way.goal, goal)]
            if same and not taken[same[0]]:
                chosen: ChartPoint = goals[same[0]]
                return chosen
        far = np.abs((goals - stand) / self._speeds).max(axis=1)
        nearest: ChartPoint = goals[np.argmin(np.where(taken, np.inf, far))]
        return nearest

    def _is_same(self, z: ChartPoint, goal: ChartPoint) -> bool:
        """Return whether a chart point (nv,) is a goal (nv,), but for whole turns of joints that turn without end."""
        return bool((np.abs(self.group.unwrapped(goal, z) - z) <= GOAL_TOLERANCE).all())

    def _is_free(self, way: TimedPath, place: float, stand: ChartPoint) -> bool:
        points = way.rest(stand, place, place + STREAM.looked_at)
        clearance = self._paths.choose_clearance(STREAM.resting_looked_at, [stand, way.goal])
        return self._paths.is_free(NOTHING, STREAM.going, clearance, points)

    def _is_at_goal(self, z: ChartPoint) -> bool:
        way = None if self._state.pursuit is None else self._state.pursuit.way
        return way is not None and bool((np.abs(z - way.goal) <= GOAL_TOLERANCE).all())

    def _send(self, cycle: _Cycle, commit: Commit, leads_to: Any) -> Piece:
        state = self._state
        number = max(state.commits) + 1
        sent = Commit(
            number, commit.begins, commit.brakes, commit.stops, commit.start, commit.phases, commit.counts,
            commit.ends, cycle.base.number, state.goal, leads_to == "goal" and self._is_at_goal(commit.ends),
        )  # fmt: skip
        state.add(sent, cycle.executed)
        piece = Piece(
            number=number,
            update=cycle.now,
            follows=sent.follows,
            goal=sent.goal,
            begins=sent.begins,
            brakes=sent.brakes,
            stops=sent.stops,
            leads_to=leads_to,
            reaches_goal=sent.at_goal,
            position_names=self.group.position_names,
            trajectory=sent.trajectory(),
            evaluations=cycle.evaluations,
        )
        self._pieces.append(piece)
        return piece

    def _tell_state(
        self, time: float, reason: Reason, verdict: CommitVerdict | None = None, base: Commit | None = None
    ) -> StreamState:
        commit = self.executing if base is None else base
        return StreamState(
            update=time,
            reason=reason,
            pair=None if verdict is None else self.pair_of(verdict),
            time=None if verdict is None or verdict.pair < 0 else verdict.time,
            executing=commit.number,
            stops=commit.stops,
        )

    def pair_of(self, verdict: CommitVerdict) -> tuple[str, str] | None:
        """The bodies that a verdict couldn't prove apart: a link, and a link or an obstacle; None for other reasons."""
        if verdict.pair < 0 or verdict.reason is CommitReason.LIMITS:
            return None
        names, own = self._opened.world.body_names, self._opened.world.pairs.own
        if verdict.pair < len(own):
            first, second = own[verdict.pair]
            return names[first], names[second]
        obstacles = self._obstacles.names
        row, obstacle = divmod(verdict.pair - len(own), len(obstacles))
        return names[self._opened.world.pairs.moving[row]], obstacles[obstacle]


def _search_goals(
    goal: StreamGoal, group: PlanningGroup, near: ChartPoint, rng: np.random.Generator, paths: PathPlanner
) -> ChartPoints:
    return find_goals(goal, group, paths, near, rng)


class _Cycle:
    """The data of one update's answer: the executed commits and observations; and the reasons so far."""

    def __init__(
        self, now: float, begins: float, executed: list[Commit], broken: CommitVerdict | None, seen: SeenObstacles
    ) -> None:
        self.now, self.begins, self.executed, self.base = now, begins, executed, executed[-1]
        self.broken, self.seen = broken, seen
        self.reason: Reason = "too_close"
        self.verdict: CommitVerdict | None = None
        self.threatened = False
        self.evaluations = 0
