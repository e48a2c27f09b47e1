"""The limits of a service with their values, and its rules of delivery, as `info` and the wire page tell them.

A limit that a client can meet belongs here; names of limits and rules are the wire. Values are those of the modules
that enforce them; after a change of one, or of a rule, `tools/wire_page` makes docs/wire.md anew.
"""

from __future__ import annotations

from guidefield.endpoint.allowances import LIST_COUNTS
from guidefield.endpoint.endpoint import LATE, LATE_SHARE, MOST_READS
from guidefield.endpoint.link import LEASE, LONGEST_MESSAGE, READ_WITHIN
from guidefield.endpoint.streams import OPENED_WITHIN, SILENCE
from guidefield.endpoint.under_way import GRACE, LONGEST_CLIENT, MOST_REMEMBERED, REMEMBERED
from guidefield.messages import codec
from guidefield.messages.certify_request import MOST_ROWS
from guidefield.messages.keys import STORE_TIME_LIMIT
from guidefield.messages.kinematics import DEFAULT_TIME
from guidefield.messages.requests import LARGEST_PAGE
from guidefield.messages.scene import MAX_VERTICES
from guidefield.messages.service import DeliveryRule, LimitInfo
from guidefield.messages.streams import MOST_STREAM_OBSTACLES, MOST_UPDATE_BYTES
from guidefield.messages.values import LARGEST, LONGEST_TIME, MAX_URDF_CHARACTERS
from guidefield.pool.outbox import MAX_ANSWERS, MAX_CLIENT_BYTES, MAX_UNREAD_BYTES, USER_SHARE
from guidefield.pool.process import MAX_SILENCE_S, MAX_WAITING_MESSAGES
from guidefield.pool.waiting import BACKSTOP, STANDBY_WAIT_S, TRIAL_S, Limits
from guidefield.rendering import LARGEST_RECORDING
from guidefield.robot.mesh_files.sent_meshes import MAX_MESH_BYTES, MAX_MESHES
from guidefield.stores.robots import MAX_BYTES, MAX_ROBOTS
from guidefield.stores.runs import Retention
from guidefield.stream_worker import MAX_GOAL_SEARCHES


def list_limits(
    waiting: Limits, memory: int, retention: Retention, grace: float, streams: int
) -> tuple[LimitInfo, ...]:
    """Return every limit of a service, with its value."""
    own = (
        _limit("queue", waiting.tasks, "requests", "waiting requests; more: SERVER_BUSY"),
        _limit("queue_of_client", waiting.tasks_of_client, "requests", "of one client; more: SERVER_BUSY"),
        _limit("queue_size", waiting.bytes, "bytes", "waiting requests together; more: SERVER_BUSY"),
        _limit("queue_size_of_client", waiting.bytes_of_client, "bytes", "those of one client; more: SERVER_BUSY"),
        _limit("memory", memory, "bytes", "one worker; beyond it its request is CRASH"),
        _limit("kept_runs", retention.runs, "runs", "kept; the oldest go first"),
        _limit("kept_size", retention.bytes, "bytes", "kept runs together; the oldest go first"),
        _limit("streams", streams, "streams", "open at once; more: SERVER_BUSY"),
        _limit("ending", grace, "s", "for work under way at the end; plans then end early"),
    )
    return (*_OF_PAYLOADS, *_OF_TIME, *own, *_OF_STREAMS, *_OF_ANSWERS, *_OF_STORES)


def _limit(name: str, value: float, unit: str, what: str) -> LimitInfo:
    return LimitInfo(name=name, value=float(value), unit=unit, what=what)


_OF_PAYLOADS = (
    _limit("payload", codec.MAX_REQUEST_BYTES, "bytes", "one query; more: REQUEST_TOO_LARGE"),
    _limit("message", LONGEST_MESSAGE, "bytes", "one message; Zenoh drops a larger one without an answer"),
    _limit("quantity", LARGEST, "SI units", "any number; more, NaN and infinities are refused"),
    _limit("urdf", MAX_URDF_CHARACTERS, "characters", "a URDF or SRDF"),
    _limit("mesh_files", MAX_MESHES, "files", "sent with a robot"),
    _limit("mesh_file", MAX_MESH_BYTES, "bytes", "one of them"),
    _limit("obstacle", MAX_VERTICES, "elements", "vertices, triangles or points of one obstacle"),
    _limit("motion", MOST_ROWS, "rows", "a motion to judge"),
    _limit("client_name", LONGEST_CLIENT, "bytes", "of a query's attachment that count"),
)
_OF_TIME = (
    _limit("kinematics_default", DEFAULT_TIME, "s", "for a kinematics request without `allowed_time`"),
    _limit("longest_time", LONGEST_TIME, "s", "that a request may allow itself"),
    _limit("storing", STORE_TIME_LIMIT, "s", "to store or describe robots and scenes"),
    _limit("late", LATE, "s", "of an answer after its time, at most, while a robot is loaded"),
    _limit("late_share", LATE_SHARE, "of the time allowed", "in addition"),
    _limit("backstop", BACKSTOP, "s", "after its request's time a worker is ended (CRASH)"),
    _limit("cancel_remembered", REMEMBERED, "s", "that a cancel is remembered if it precedes its request"),
    _limit("cancels_remembered", MOST_REMEMBERED, "cancels", "remembered; the oldest go first"),
    _limit("client_gone", GRACE, "s", "without a client's token before its requests end"),
    _limit("link_cut", LEASE, "s", "before a cut link is noticed"),
)
_OF_STREAMS = (
    _limit("stream_silence", SILENCE, "s", "without an update before a stream ends"),
    _limit("stream_opening", OPENED_WITHIN, "s", "for opening a stream"),
    _limit("stream_stuck", MAX_SILENCE_S, "s", "for a stream's process to take a message; then it ends"),
    _limit("stream_update", MOST_UPDATE_BYTES, "bytes", "one update; a larger one is refused on `state`"),
    _limit("stream_waiting", MAX_WAITING_MESSAGES, "updates", "waiting for one stream; more are refused on `state`"),
    _limit("stream_obstacles", MOST_STREAM_OBSTACLES, "obstacles", "known to one stream, without those that are gone"),
    _limit("stream_goals", MAX_GOAL_SEARCHES, "goals", "searched at once; more: SERVER_BUSY"),
)
_OF_ANSWERS = (
    _limit("read_within", READ_WITHIN, "s", "to read an answer; then Zenoh ends the link"),
    _limit("unread_of_client", MAX_CLIENT_BYTES, "bytes", "unread answers of one client; more: SERVER_BUSY"),
    _limit("unread", MAX_UNREAD_BYTES, "bytes", "unread answers together; more: SERVER_BUSY"),
    _limit("unread_answers", MAX_ANSWERS, "answers", "unread together; more: SERVER_BUSY"),
    _limit("unread_of_user", USER_SHARE, "of these", "for one user"),
    _limit("list_counts", LIST_COUNTS, "queries", "for which a list or a full `info` counts in `per_second`"),
    _limit("list_of_runs", LARGEST_PAGE, "runs", "on one page; `after` continues"),
    _limit("reads", MOST_READS, "queries", "for files, waiting for the disk; more: SERVER_BUSY"),
)
_OF_STORES = (
    _limit("robots", MAX_ROBOTS, "robots", "stored; more are refused"),
    _limit("robots_size", MAX_BYTES, "bytes", "stored robots together; more is refused"),
    _limit("recording", LARGEST_RECORDING, "bytes", "one recording; a larger one is dropped"),
)

DELIVERY = (
    DeliveryRule(
        name="one answer",
        rule="Each query gets exactly one answer: a reply, or an error as Zenoh's `reply_err`. A plan that isn't found"
        " is a reply with its status.",
    ),
    DeliveryRule(
        name="no answer",
        rule="If there is no answer, the instance or the link is gone, the query's own time-out was too short, or the"
        " message was larger than `message`. Ask again; another instance may answer.",
    ),
    DeliveryRule(
        name="order",
        rule="Answers come in no order. A free worker goes to the user with the fewest workers, then to the one with"
        " the least recent processor time; the clients of a user take turns, and the requests of a client start in"
        " order. If the queue is full, the last request of the user with the most is SERVER_BUSY. One more worker"
        f" serves users that have waited {STANDBY_WAIT_S:g} s without one; after {TRIAL_S:g} s, each time doubled, its"
        " request gives way to another such user's and starts anew.",
    ),
    DeliveryRule(
        name="time",
        rule="A request's time counts from its arrival, with queue and loading. Give the query a time-out at least"
        f" {BACKSTOP:g} s longer.",
    ),
    DeliveryRule(
        name="asked again",
        rule="A plan, judgement or kinematics request that is repeated with the same id and content is answered by the"
        " work under way, or by the kept reply of its run. A repeated `?delete` finds nothing to delete.",
    ),
    DeliveryRule(
        name="cancel",
        rule="A cancel is answered at once. The cancelled request is PREEMPTED: a plan by a reply with the best by"
        f" then, kinematics by an error. A cancel that precedes its request is remembered for {REMEMBERED:g} s.",
    ),
    DeliveryRule(
        name="gone client",
        rule="A client may declare the token `clients/<client>`, by the name in its queries' attachment. When the token"
        f" has been gone for {GRACE:g} s, the client's requests end. Without a token they go on.",
    ),
    DeliveryRule(
        name="progress",
        rule="Progress is published without a history; a busy link may drop some. The answer doesn't depend on it.",
    ),
    DeliveryRule(
        name="streams",
        rule="An update is put, and answered once, on `pieces` or `state`. Of waiting updates all observations count"
        " and only the newest is answered. A client that doesn't read loses what is published.",
    ),
    DeliveryRule(
        name="slow reader",
        rule=f"A client has {READ_WITHIN:g} s to read an answer, beside what the system buffers; then Zenoh ends its"
        " link. Nobody else waits.",
    ),
    DeliveryRule(
        name="start and end",
        rule="While the service starts and ends, `info`, lists and files are answered; requests for a worker are"
        " SERVER_BUSY.",
    ),
)
"""The rules by which queries are answered."""
