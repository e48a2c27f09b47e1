"""The process of a stream: updates in, pieces and states out, each before the next one if it can be.

Theory of operation. One thread answers; another one, which yields to it, searches paths and configurations of goals.
A cycle takes all messages that have come by its begin: it answers the newest update, and only notes the observations of
earlier ones, so that none is answered late. Goals, stops and updates keep their order. `endpoint/streams.py` holds
the other end of the line, and takes each message that is sent here.
"""

from __future__ import annotations

import contextlib
import gc
import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from multiprocessing import connection
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from guidefield.engines import EngineSetup
from guidefield.errors import GuidefieldError, ServerBusy, convert_exception
from guidefield.first_start import compile_kernels, processor
from guidefield.messages import codec
from guidefield.messages.codec import Encoding
from guidefield.messages.replies import Done, ErrorReply, make_error_reply
from guidefield.messages.stream_requests import StreamAim, StreamAimed, StreamJudge, StreamJudged
from guidefield.messages.streams import Observation, StreamOpen, StreamState, StreamUpdate
from guidefield.messages.values import Placement
from guidefield.pool.process import Taken
from guidefield.system import configure_logging

if TYPE_CHECKING:
    from guidefield.stream.journal import Journal
    from guidefield.stream.stream import CertifiedStream, GoalSearch

MAX_MESSAGES_PER_CYCLE = 256  # so a cycle ends although a sender never pauses; with few, stale updates are answered
# number of goals whose configurations may be searched at the same time; docs/wire.md tells it: after a change,
# `tools/wire_page`
MAX_GOAL_SEARCHES = 8
NICENESS = -10  # of a stream's process, where the system allows one below 0; below `YIELDING` (stream/path_planner.py)
REHEARSAL_UPDATES = 3  # updates answered on a stream of trial before it opens; with fewer the first answers are late
FAR_AWAY = Placement((0.0, 0.0, 50.0))  # of an observed obstacle in those

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Update:
    """An update as it came."""

    payload: bytes
    encoding: Encoding


@dataclass(frozen=True)
class StreamQuery:
    """A query for another goal, for a judgement of the last piece, or to stop, as it came; numbered for its answer."""

    kind: Literal["aim", "judge", "stop"]
    number: int
    encoding: Encoding
    payload: bytes = b""


@dataclass(frozen=True)
class Open:
    """The stream is open."""

    robot: str
    position_names: tuple[str, ...]
    start: tuple[float, ...]
    goal: int
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class RefusedOpening:
    """The stream can't be opened; why."""

    error: ErrorReply


@dataclass(frozen=True)
class Publication:
    """A message to publish."""

    key: Literal["pieces", "state"]  # last part of its key, below the stream's
    payload: bytes  # as the client wrote what it opened the stream with
    executing: int  # number of the last piece
    stops: float  # when the robot stands [s]
    state: StreamState | None = None  # the state, where it is one


@dataclass(frozen=True)
class QueryAnswer:
    """The answer to a query."""

    number: int  # of the query
    is_reply: bool  # else an error
    payload: bytes
    goal: int  # the goal's number by then


@dataclass(frozen=True)
class StreamConversation:
    """The conversation of a stream's process."""

    setup: EngineSetup
    user: str
    request: StreamOpen
    encoding: Encoding

    def __call__(self, line: Connection) -> None:
        """In the process: open the stream, and answer until nobody is there."""
        configure_logging(self.setup.log_level, json=self.setup.json_logs)
        with contextlib.suppress(OSError):  # not everybody may
            os.setpriority(os.PRIO_PROCESS, 0, NICENESS)
        journal = self._journal()
        try:
            stream = self._open_stream(journal)
        except Exception as error:
            known = convert_exception(error)
            if known is not error:
                _log.exception("a stream could not be opened")
            line.send(RefusedOpening(make_error_reply(known)))
            return
        request = self.request
        line.send(
            Open(
                robot=request.robot if isinstance(request.robot, str) else type(request.robot).__name__,
                position_names=tuple(stream.group.position_names),
                start=tuple(stream.executing.ends.tolist()),
                goal=stream.goal_number,
                warnings=tuple(stream.warnings),
            )
        )
        gc.collect()
        gc.freeze()  # what is loaded stays; a collection need not look at it
        with stream, contextlib.suppress(EOFError, BrokenPipeError):
            _Answerer(stream, self.encoding, line).answer_all()
        if journal is not None:
            journal.close()

    def _journal(self) -> Journal | None:
        from guidefield.stream import journal
        from guidefield.stream.journal import Journal

        if self.request.recording == "off":
            return None
        stores = self.setup.engines().stores
        try:
            folder = journal.begin(stores.streams_of(self.user), str(self.request.stream_id))
        except OSError as error:
            _log.warning("a stream can't be kept: %s", error.strerror)
            return None
        made_with = {"guidefield": version("guidefield"), "processor": processor()}
        file_bytes = journal.file_bytes(stores.byte_quota_of(self.user))
        return Journal(folder, self.request, self.user, made_with, file_bytes)

    def _open_stream(self, journal: Journal | None) -> CertifiedStream:
        from guidefield.stream.path_planner import WhenReady

        compile_kernels(_log.info)
        engine = self.setup.engines().of(self.user)
        with engine.stream(self.request, WhenReady()) as rehearsed:
            _rehearse(rehearsed)
        return engine.stream(self.request, WhenReady(), journal)


def _rehearse(stream: CertifiedStream) -> None:
    for cycle in range(REHEARSAL_UPDATES):
        now = cycle * stream.request.period
        seen = [Observation(one.obstacle.name, now, FAR_AWAY) for one in stream.request.obstacles[:1]]
        answer = stream.update(StreamUpdate(now, seen))
        for encoding in Encoding:
            codec.encode(answer, encoding)


class _Answerer:
    def __init__(self, stream: CertifiedStream, encoding: Encoding, line: Connection) -> None:
        self._stream, self._encoding, self._line = stream, encoding, line
        self._searches: dict[int, tuple[GoalSearch, Encoding]] = {}  # by the number of the query
        self._woken, self._wake = os.pipe()  # a byte for each search that has ended

    def answer_all(self) -> None:
        while True:
            connection.wait([self._line, self._woken])
            self._settle_goals()
            messages: list[Any] = []
            while len(messages) < MAX_MESSAGES_PER_CYCLE and self._line.poll(0.0):
                messages.append(self._line.recv())
            self._take(messages)
            if messages:
                self._line.send(Taken(len(messages)))

    def _take(self, messages: Sequence[Any]) -> None:
        newest = max((index for index, one in enumerate(messages) if isinstance(one, Update)), default=-1)
        answers = {"aim": self._aim, "judge": self._judge, "stop": self._halt}
        for index, one in enumerate(messages):
            if isinstance(one, Update):
                self._update(one, newest=index == newest)
            else:
                self._answer(one.number, one.encoding, partial(answers[one.kind], one))

    def _update(self, message: Update, *, newest: bool) -> None:
        time: float | None = None
        try:
            update: StreamUpdate = codec.decode(message.payload, StreamUpdate, message.encoding)
            time = update.time
            answer = self._stream.update(update) if newest else self._stream.note(update)
        except GuidefieldError as error:
            commit = self._stream.executing
            answer = make_state("refused", commit.number, commit.stops, error, update=time)
        if answer is not None:
            commit = self._stream.executing
            state = answer if isinstance(answer, StreamState) else None
            key: Literal["pieces", "state"] = "pieces" if state is None else "state"
            payload = codec.encode(answer, self._encoding)
            self._line.send(Publication(key, payload, commit.number, commit.stops, state))
        for _ in self._stream:  # pieces, which are sent already
            pass

    def _answer(self, number: int, encoding: Encoding, answer: Callable[[], msgspec.Struct | None]) -> None:
        """Answer a query at once, unless its answer comes later."""
        is_reply = True
        try:
            reply = answer()
        except GuidefieldError as error:
            is_reply, reply = False, make_error_reply(error)
        if reply is not None:
            self._line.send(QueryAnswer(number, is_reply, codec.encode(reply, encoding), self._stream.goal_number))

    def _judge(self, query: StreamQuery) -> StreamJudged:
        judge: StreamJudge = codec.decode(query.payload, StreamJudge, query.encoding)
        verdict = self._stream.judged(judge.time)
        commit = self._stream.executing
        pair = self._stream.pair_of(verdict)
        return StreamJudged(
            proven=verdict.free,
            executing=commit.number,
            stops=commit.stops,
            pair=pair,
            time=None if pair is None else verdict.time,
            evaluations=verdict.evaluations,
        )

    def _halt(self, _query: StreamQuery) -> Done:
        self._stream.stop()
        return Done(done="no piece follows the last one, until there is a goal again: the robot stops")

    def _aim(self, query: StreamQuery) -> StreamAimed | None:
        aim: StreamAim = codec.decode(query.payload, StreamAim, query.encoding)
        if aim.goal is None:
            return StreamAimed(goal=self._stream.take_goal(None))
        if len(self._searches) >= MAX_GOAL_SEARCHES:
            raise ServerBusy(f"configurations of {MAX_GOAL_SEARCHES} goals are looked for already", retry_after=0.1)
        search = self._stream.seek(aim.goal)
        self._searches[query.number] = search, query.encoding
        search.found.add_done_callback(lambda _: os.write(self._wake, b"."))
        return None

    def _settle_goals(self) -> None:
        for number, (search, encoding) in list(self._searches.items()):
            if not search.found.done():  # goals are taken in the order of their queries
                return
            os.read(self._woken, 1)
            del self._searches[number]
            self._answer(number, encoding, partial(self._aim_at, search))

    def _aim_at(self, search: GoalSearch) -> StreamAimed:
        return StreamAimed(goal=self._stream.take_goal(search))


def make_state(
    reason: Literal["refused", "ended"],
    executing: int,
    stops: float,
    error: GuidefieldError,
    *,
    update: float | None = None,
) -> StreamState:
    """Make the state of a stream that refuses an update, or is over."""
    reply = make_error_reply(error)
    return StreamState(
        update=update, reason=reason, pair=None, time=None, executing=executing, stops=stops, error=reply
    )
