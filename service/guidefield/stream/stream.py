"""A stream in one process, driven by the caller's clock: observations go in, certified pieces come out.

Each update is a cycle: take observations, find a piece (`pieces.py`), which is proven together with its stop, and send
it, or say why there is none. With another order of work journals that are kept replay to other pieces. `SLACK` is how
far a robot may be off its piece beyond what is proven.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass
from types import TracebackType
from typing import Any, TypeVar, cast

import numpy as np

from guidefield.errors import GuidefieldError, InvalidConfiguration, InvalidGoal, MalformedRequest, at_path
from guidefield.kernels.collide import broadphase
from guidefield.kernels.jit.decorators import load
from guidefield.kernels.prove import search
from guidefield.kernels.stream import dodge, phases
from guidefield.kernels.timing import carried_rates
from guidefield.kernels.tree import rrt_connect, shortcut
from guidefield.messages import codec
from guidefield.messages.streams import Piece, Reason, StreamGoal, StreamOpen, StreamState, StreamUpdate
from guidefield.messages.values import ORIGIN
from guidefield.robot.model.configuration import configuration_from_wire
from guidefield.robot.model.joints import LocalPoint, LocalPoints
from guidefield.robot.model.model import RobotModel
from guidefield.scene.anchor import Anchor
from guidefield.scene.scene import Scene
from guidefield.stream.commit import Commit, CommitReason, CommitVerdict, Judge, join_commits
from guidefield.stream.obstacles import Obstacles
from guidefield.stream.opening import read_opening
from guidefield.stream.path_planner import BackgroundPlanner, FixedDelay, PathOrder, PathPlanner, TakeOver, find_goals
from guidefield.stream.pieces import Cycle, LeadsTo, PieceFinder
from guidefield.stream.settings import STREAM
from guidefield.stream.state import (
    MAX_COMMITS,
    Event,
    KeptObstacle,
    Phase,
    Snapshot,
    State,
    StreamWatcher,
    Watchers,
    random_state,
    restore_random,
)

_A = TypeVar("_A", bound=Piece | StreamState | None)

SLACK = 1e-6
"""Deviation of joints that is allowed beyond the tolerance, for rounded numbers [rad or m]: no proof covers it."""

# loaded when a stream opens: else its first update would wait for them, 30 to 60 ms
KERNELS = search, dodge, broadphase, phases, rrt_connect, shortcut


@dataclass(frozen=True)
class GoalSearch:
    """A search for configurations of a goal."""

    number: int
    found: Future[LocalPoints]  # the configurations, shape (k, nv)


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
        self._opened = opening = read_opening(self._inward(request), robot, scene, coarse)
        self.group, self.scene = opening.group, scene
        keeping = (request.min_clearance, request.tracking_tolerance)
        self._paths = PathPlanner(opening.group, opening.world, opening.bounds, *keeping)
        taking = taking or FixedDelay()
        beside = PathPlanner(opening.group, opening.world, opening.bounds, *keeping)
        self._planner = BackgroundPlanner(beside, taking.niceness)
        self._obstacles = Obstacles(scene, opening.assumption, opening.bodies_met, self.origin)
        for index, one in enumerate(request.obstacles):
            self._obstacles.take(self._obstacles.prepare(one, f"$.obstacles[{index}]", opening.group.robot.links))
        tolerances = np.full(opening.group.nv, request.tracking_tolerance)
        self._judge = Judge(opening.world, opening.bounds, request.min_clearance, tolerances, opening.cartesian_limits)
        self._rng = np.random.default_rng(request.seed)
        self._finder = PieceFinder(
            request, opening, self._judge, self._obstacles, self._paths, self._planner, taking, self._rng
        )
        self._state = State.at_rest(opening.start)
        self._seeking = 0
        self._pieces: deque[Piece] = deque(maxlen=MAX_COMMITS)
        self._watching = StreamWatcher()
        if request.goal is not None:
            try:
                self.aim_for(request.goal)
            except InvalidGoal as error:
                self.close()
                raise InvalidGoal("; ".join([error.message, *opening.touching]), **error.details) from None
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
        """Change the goal; null: to stand. A goal after a stop lets the robot go on.

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
        stream_goal: StreamGoal = codec.convert(goal, StreamGoal) if isinstance(goal, dict) else goal
        state = self._state
        state.sought, self._seeking = state.sought + 1, self._seeking + 1
        rng = np.random.default_rng([self.request.seed, state.sought])
        inward, near = self._inward(stream_goal), self.executing.ends

        def work(paths: PathPlanner) -> LocalPoints:
            return find_goals(inward, self.group, paths, near, rng)

        self._watching.seek(stream_goal)
        return GoalSearch(state.sought, self._planner.submit(work))

    def take_goal(self, search: GoalSearch | None) -> int:
        """Aim for what `seek` found from now on, and wait for it; None: to stand.

        Returns:
            The goal's number, which its pieces have.

        Raises:
            GuidefieldError: if the goal is ill-posed, or can't be reached; then the one before stays.
        """
        if search is not None:
            self._seeking -= 1
        goals = None if search is None else search.found.result()
        self._watching.change_goal(None if search is None else search.number)
        self._state.aim(goals)
        return self._state.goal

    def stop(self) -> None:
        """Have no piece follow the last one, until there is a goal again: the robot stops."""
        self._state.enter(Event.STOP)
        self._watching.halt()

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
            self._watching.end_update(update, None, error, noted=noted, took=self._has_taken(ordered))
            raise
        self._watching.end_update(update, answer, None, noted=noted, took=self._has_taken(ordered))
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
        return self._find_piece(Cycle(now, now + self.request.latency, state, executed, broken, seen))

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

    def _read_joints(self, update: StreamUpdate) -> LocalPoint:
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
        return group.unwrapped(group.to_local(group.part_of(q)), self.executing.state(update.time)[:, 0])

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

    def _stand_elsewhere(self, z: LocalPoint, base: Commit) -> Commit:
        """Go on from z (nv,), where the robot stands although its piece ended elsewhere."""
        stood = Commit.standing(z, self._state.now, base.number, self._state.goal)
        self._state.stand_at(stood)
        return stood

    def _find_piece(self, cycle: Cycle) -> Piece | StreamState:
        if self._state.phase is Phase.HALTED:
            return self._tell_none(cycle.now, "stopped", cycle.broken, cycle.base)
        found = self._finder.find(cycle)
        if found is not None:
            return self._send(cycle, *found)
        verdict = None if cycle.reason in ("standing", "at_goal") else cycle.verdict  # of a flight that was refused
        return self._tell_none(cycle.now, cycle.reason, cycle.broken, cycle.base, verdict)

    def _send(self, cycle: Cycle, commit: Commit, leads_to: LeadsTo) -> Piece:
        state = self._state
        number = max(state.commits) + 1
        at_goal = leads_to == "goal" and self._finder.is_at_goal(state, commit.ends)
        sent = Commit(
            number, commit.begins, commit.brakes, commit.stops, commit.start, commit.phases, commit.counts,
            commit.ends, cycle.base.number, state.goal, at_goal,
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
