"""A client's side of a stream, without waiting: it sends updates, takes pieces, and follows their execution.

`streams.py` and `asynchronous.py` wait on top of it, each in its own way. `Execution` takes pieces by the rule in the
docstring of `Piece`: the service proves them for clients that do.
"""

from __future__ import annotations

import threading
import time
import uuid
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, cast

import msgspec
import zenoh

from guidefield.client import questions
from guidefield.client.exchange import Exchange
from guidefield.client.questions import Question
from guidefield.errors import GuidefieldError, NoService, StreamUnknown
from guidefield.messages import codec
from guidefield.messages.codec import Encoding
from guidefield.messages.identities import base_key
from guidefield.messages.replies import make_error, make_error_reply
from guidefield.messages.stream_requests import StreamAimed, StreamReply
from guidefield.messages.streams import MOST_STREAM_OBSTACLES, Piece, StreamGoal, StreamOpen, StreamState, StreamUpdate
from guidefield.messages.values import Positions

MAX_WAITING_PIECES = 64
"""The largest number of pieces that wait to begin; the oldest are dropped.

No fewer than a stream remembers: `MAX_COMMITS` of `stream/state.py`.
"""


@dataclass(frozen=True)
class Motion:
    """The state of a robot, in the order of a stream's `position_names`."""

    positions: tuple[float, ...]  # [rad or m]
    velocities: tuple[float, ...]  # [rad/s or m/s]
    accelerations: tuple[float, ...]  # [rad/s^2 or m/s^2]


class Execution:
    """The motion of a robot that takes a stream's pieces; not for several threads at once.

    A piece is executed from its begin, if it came before, and if the piece that it follows is executed then. Without
    such a piece the robot executes its last one to the end, and stands there.

    Args:
        start: Positions at which the robot stands first [rad or m].

    Attributes:
        late: Number of pieces that came after their begin.
    """

    def __init__(self, start: Sequence[float]) -> None:
        self.late = 0
        self._start = tuple(start)
        self._piece: Piece | None = None
        self._waiting: deque[Piece] = deque(maxlen=MAX_WAITING_PIECES)

    def take(self, piece: Piece, now: float) -> bool:
        """Take a piece unless it begins before now [s]; return whether it follows the piece that is executed then."""
        if piece.begins < now:
            self.late += 1
            return False
        self._go_on(now)
        number = self._number
        for waiting in self._waiting:
            if waiting.begins <= piece.begins and waiting.follows == number:
                number = waiting.number
        self._waiting.append(piece)
        return piece.follows == number

    def executing(self, now: float) -> int:
        """Return the number of the piece that is executed at a time [s]; 0: none yet. Times must not decrease."""
        self._go_on(now)
        return self._number

    def stops(self) -> float | None:
        """Return the end of the executed piece [s]; None: the robot stands at the start."""
        return None if self._piece is None else self._piece.stops

    def stands(self, now: float) -> bool:
        """Return whether the robot stands at a time [s]. Times must not decrease."""
        self._go_on(now)
        return self._piece is None or now >= self._piece.stops

    def at_goal(self, now: float) -> bool:
        """Return whether it stands at the goal of its piece at a time [s]. Times must not decrease."""
        return self.stands(now) and self._piece is not None and self._piece.reaches_goal

    def at(self, now: float) -> Motion:
        """Return the state of the robot at a time [s]. Times must not decrease."""
        self._go_on(now)
        still = (0.0,) * len(self._start)
        if self._piece is None:
            return Motion(self._start, still, still)
        trajectory = self._piece.trajectory
        if now >= trajectory.times[-1]:
            return Motion(tuple(trajectory.positions[-1]), still, still)
        k = max(0, bisect_right(trajectory.times, now) - 1)
        s, span = now - trajectory.times[k], trajectory.times[k + 1] - trajectory.times[k]
        positions, velocities = trajectory.positions[k], trajectory.velocities[k]
        rows = zip(positions, velocities, trajectory.accelerations[k], trajectory.accelerations[k + 1], strict=True)
        states = []
        for q, v, a, after in rows:
            jerk = (after - a) / span
            states.append((q + s * (v + s * (a / 2 + s * jerk / 6)), v + s * (a + s * jerk / 2), a + s * jerk))
        return Motion(*zip(*states, strict=True))

    @property
    def _number(self) -> int:
        return 0 if self._piece is None else self._piece.number

    def _go_on(self, now: float) -> None:
        while self._waiting and self._waiting[0].begins <= now:
            piece = self._waiting.popleft()
            if piece.follows == self._number:
                self._piece = piece


MAX_UNREAD_PIECES = 64  # the largest number of pieces that wait to be read; the oldest are dropped
LOST_SERVICE_S = 6.0
"""Time without the service after which its streams have ended, because a link may be cut for a moment [s].

The service ends them after the same time without the client: `GRACE` of `endpoint/under_way.py`.
"""

Answer = Piece | StreamState


class StreamLink:
    """A client's side of a stream; raises MalformedRequest if the request isn't one.

    `changed` is called, in a thread of Zenoh, when a piece or state has come, or the stream has ended.
    """

    def __init__(
        self,
        exchange: Exchange,
        request: StreamOpen | dict[str, Any] | None,
        fields: dict[str, Any],
        clock: Callable[[], float] | None,
        changed: Callable[[], None],
    ) -> None:
        began = time.monotonic()
        self.clock = clock or (lambda: time.monotonic() - began)
        self.request = questions.stream_open(request, fields)
        self._exchange, self._changed = exchange, changed
        self._obstacles = {one.obstacle.name: one for one in self.request.obstacles}
        self._subscribers: list[zenoh.Subscriber] = []
        self._token: zenoh.Subscriber | None = None
        self._timer: threading.Timer | None = None
        self._lock = threading.Lock()
        self._base = ""
        self._held: str | None = None  # the stream whose instance the exchange has to keep
        self._forget()

    def _forget(self) -> None:
        self.reply: StreamReply | None = None
        self.stream_id = self.request.stream_id or uuid.uuid4().hex
        self.execution = Execution(())
        self.latest: Answer | None = None
        self.state: StreamState | None = None
        self.ended: StreamState | None = None
        self.update_time: float | None = None  # time of the last update [s]
        self._pieces: deque[Piece] = deque(maxlen=MAX_UNREAD_PIECES)

    def start_opening(self) -> Question[StreamReply]:
        """Subscribe to the stream, and return the question that opens it."""
        session, key = self._exchange.session, f"{base_key('*', self._exchange.user)}/streams/{self.stream_id}"
        self._subscribers = [
            session.declare_subscriber(f"{key}/pieces", self._take_piece),
            session.declare_subscriber(f"{key}/state", self._take_state),
        ]
        return questions.open_stream(msgspec.structs.replace(self.request, stream_id=self.stream_id))

    def accept(self, reply: StreamReply) -> None:
        """Take the reply that opens the stream."""
        self.reply, instance = reply, self._exchange.instance_of(self.stream_id)
        self._exchange.hold(self.stream_id, instance)
        self._held = self.stream_id
        self._base = f"{base_key(instance, self._exchange.user)}/streams"
        with self._lock:
            self.execution = Execution(reply.start)
        self._watch(instance)

    def start_reopening(self, start: Positions) -> Question[StreamReply]:
        """Return the question that opens an ended stream again, with all declared obstacles."""
        self.silence()
        obstacles = list(self._obstacles.values())
        self.request = msgspec.structs.replace(self.request, start=start, obstacles=obstacles, stream_id=None)
        with self._lock:
            self._forget()
        return self.start_opening()

    def silence(self) -> None:
        """Stop listening."""
        token, self._token = self._token, None
        for subscriber in (*self._subscribers, *(() if token is None else (token,))):
            subscriber.undeclare()
        self._subscribers = []
        held, self._held = self._held, None
        if held is not None:
            self._exchange.release(held)
        self._schedule(None)

    def aim(self, goal: StreamGoal | dict[str, Any] | None) -> tuple[Question[StreamAimed], StreamGoal | None]:
        """Return the question for another goal, and that goal."""
        return questions.aim_stream(self.stream_id, goal)

    def set_goal(self, goal: StreamGoal | None) -> None:
        """Set the goal with which the stream would be opened again."""
        self.request = msgspec.structs.replace(self.request, goal=goal)

    def complete_update(self, update: StreamUpdate | dict[str, Any] | None, fields: dict[str, Any]) -> StreamUpdate:
        """Make an update of its fields; missing ones are the present time and the piece executed then.

        Raises:
            MalformedRequest: if it is no update.
            GuidefieldError: the error with which the stream has ended, if it has.
            StreamUnknown: if the stream isn't open, or closed.
        """
        if self.ended is not None:
            raise self.reason()
        self._require_opened()
        if not self._subscribers:
            raise StreamUnknown(f"stream {self.stream_id!r} is closed", stream=self.stream_id)
        if isinstance(update, StreamUpdate):
            return update
        given = {**(update or {}), **codec.plain_fields(fields)}
        given.setdefault("time", self.clock())
        if "executing" not in given:
            with self._lock:
                given["executing"] = self.execution.executing(given["time"])
        return cast(StreamUpdate, codec.convert(given, StreamUpdate))

    def send(self, update: StreamUpdate) -> None:
        """Send an update; on a busy link one that declares or removes obstacles waits, any other is dropped."""
        kept = bool(update.declare or update.gone)
        for one in update.declare:
            self._obstacles[one.obstacle.name] = one
        for name in update.gone:
            if len(self._obstacles) > MOST_STREAM_OBSTACLES:  # else it may be seen again
                self._obstacles.pop(name, None)
        with self._lock:
            self.update_time, self.latest = update.time, None
        self._exchange.session.put(
            f"{self._base}/{self.stream_id}/update",
            codec.encode(update, Encoding.MSGPACK),
            encoding=Encoding.MSGPACK.value,
            congestion_control=zenoh.CongestionControl.BLOCK if kept else zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
        )

    def answer(self) -> Answer | None:
        """Return the answer to the last update, or the state with which the stream ended; None: neither yet."""
        latest = self.latest
        if latest is None or self.update_time is None:
            return self.ended
        if isinstance(latest, StreamState) and (latest.reason == "ended" or latest.update is None):
            return latest
        return latest if latest.update is not None and latest.update >= self.update_time else None

    def pieces(self) -> list[Piece]:
        """Return the pieces that came since the last call and that the robot takes; StreamUnknown if not open yet."""
        self._require_opened()
        with self._lock:
            found = list(self._pieces)
            self._pieces.clear()
        return found

    def at(self, now: float) -> Motion:
        """Return the state of a robot that takes the pieces at a time [s]; StreamUnknown if not open yet."""
        self._require_opened()
        with self._lock:
            return self.execution.at(now)

    def _require_opened(self) -> None:
        if self.reply is None:
            raise StreamUnknown(
                f"stream {self.stream_id!r} isn't open yet: `with` opens it, for asyncio `async with`",
                stream=self.stream_id,
            )

    def reason(self) -> GuidefieldError:
        """Return the error with which it has ended."""
        if self.ended is None or self.ended.error is None:
            return StreamUnknown(f"stream {self.stream_id!r} isn't open", stream=self.stream_id)
        return make_error(self.ended.error)

    def _take_piece(self, sample: zenoh.Sample) -> None:
        piece = msgspec.msgpack.decode(sample.payload.to_bytes(), type=Piece)
        with self._lock:
            if self.execution.take(piece, self.clock()):
                self._pieces.append(piece)
            self.latest = piece
        self._changed()

    def _take_state(self, sample: zenoh.Sample) -> None:
        state = msgspec.msgpack.decode(sample.payload.to_bytes(), type=StreamState)
        with self._lock:
            self.latest = self.state = state
            if state.reason == "ended":
                self.ended = state
        self._changed()

    def _watch(self, instance: str) -> None:
        """End the stream when its service is gone, or has restarted without it."""
        stream_id, gone = self.stream_id, False

        def heard(token: zenoh.Sample) -> None:
            nonlocal gone
            if token.kind == zenoh.SampleKind.DELETE:
                gone = True
                self._schedule(LOST_SERVICE_S, self._lost, stream_id, instance)
            elif gone:
                gone = False
                self._schedule(0.0, self._ask_again, stream_id, instance)

        key = f"guidefield/{instance}/alive"
        self._token = self._exchange.session.liveliness().declare_subscriber(key, heard, history=True)
        if not self._exchange.is_there(instance):  # it went while it was answering
            gone = True
            self._schedule(LOST_SERVICE_S, self._lost, stream_id, instance)

    def _schedule(self, after: float | None, call: Callable[..., None] = lambda: None, *given: str) -> None:
        """Schedule a call in a thread after a time [s] in place of the last scheduled one; None only cancels."""
        timer = None if after is None else threading.Timer(after, call, given)
        with self._lock:
            before, self._timer = self._timer, timer
        if before is not None:
            before.cancel()
        if timer is not None:
            timer.daemon = True
            timer.start()

    def _lost(self, stream_id: str, instance: str) -> None:
        reason = f"service {instance!r} is gone, and stream {stream_id!r} with it: the robot stands at its last stop"
        self._over(stream_id, NoService(reason, instance=instance, stream=stream_id))

    def _ask_again(self, stream_id: str, instance: str) -> None:
        try:
            self._exchange.ask(questions.read_stream(stream_id)).result()
        except StreamUnknown:
            reason = f"service {instance!r} was gone, and knows nothing of stream {stream_id!r} any more"
            self._over(stream_id, StreamUnknown(reason, instance=instance, stream=stream_id))
        except GuidefieldError:
            if not self._exchange.is_there(instance):
                self._schedule(LOST_SERVICE_S, self._lost, stream_id, instance)

    def _over(self, stream_id: str, error: GuidefieldError) -> None:
        with self._lock:
            if self.ended is not None or self.stream_id != stream_id:
                return
            now = self.clock()
            executing, stops = self.execution.executing(now), self.execution.stops()
            self.ended = self.latest = self.state = StreamState(
                update=None,
                reason="ended",
                pair=None,
                time=None,
                executing=executing,
                stops=now if stops is None else stops,
                error=make_error_reply(error),
            )
        self._changed()
