"""The limits of a service, with their values, and the rules by which it answers queries."""

from __future__ import annotations

from guidefield.endpoint.allowances import LIST_COUNTS
from guidefield.endpoint.asked import LONGEST_CLIENT
from guidefield.endpoint.clients import GRACE
from guidefield.endpoint.endpoint import LATE, LATE_SHARE
from guidefield.endpoint.link import LEASE, LONGEST_MESSAGE, READ_WITHIN
from guidefield.endpoint.open_stream import OPENED_WITHIN, SILENCE
from guidefield.endpoint.readers import MOST_READS
from guidefield.endpoint.under_way import MOST_REMEMBERED, REMEMBERED
from guidefield.messages import codec
from guidefield.messages.certify_request import MOST_ROWS
from guidefield.messages.keys import STORE_TIME_LIMIT
from guidefield.messages.kinematics_requests import DEFAULT_TIME
from guidefield.messages.service_replies import DeliveryRule, LimitInfo
from guidefield.messages.store_requests import LARGEST_PAGE
from guidefield.messages.streams import MOST_OBSTACLES, MOST_UPDATE_BYTES
from guidefield.messages.triples import MAX_VERTICES
from guidefield.messages.values import LARGEST, LONGEST_TIME, MAX_URDF_CHARACTERS
from guidefield.pool.companion import MOST_WAITING, STUCK
from guidefield.pool.outbox import MOST_BYTES, MOST_BYTES_OF_CLIENT, MOST_LETTERS, OF_USER
from guidefield.pool.waiting import BACKSTOP, HELD_UP, TRIAL, Limits
from guidefield.robot.catalog.sent_meshes import MAX_MESH_BYTES, MAX_MESHES
from guidefield.run import LARGEST_RECORDING
from guidefield.stores.robots import MAX_BYTES, MAX_ROBOTS
from guidefield.stores.runs import Retention
from guidefield.stream_worker import MOST_SOUGHT


def limits_told(
    waiting: Limits, memory: int, retention: Retention, grace: float, streams: int
) -> tuple[LimitInfo, ...]:
    """Every limit of a service, with its value."""
    own = (
        _limit("queue", waiting.tasks, "requests", "that wait for a worker; more are SERVER_BUSY"),
        _limit("queue_of_client", waiting.tasks_of_client, "requests", "of one client that wait; more are SERVER_BUSY"),
        _limit("queue_size", waiting.bytes, "bytes", "that waiting requests take; more are SERVER_BUSY"),
        _limit("queue_size_of_client", waiting.bytes_of_client, "bytes", "of one client's; more are SERVER_BUSY"),
        _limit("memory", memory, "bytes", "that a worker takes; one that takes more is ended, its request CRASH"),
        _limit("kept_runs", retention.runs, "runs", "that are kept; the oldest are dropped first"),
        _limit("kept_size", retention.bytes, "bytes", "that kept runs take; the oldest are dropped first"),
        _limit("streams", streams, "streams", "that are open at once; more are SERVER_BUSY"),
        _limit("ending", grace, "s", "that work under way has at the end; plans then end with the best by then"),
    )
    return (*_OF_PAYLOADS, *_OF_TIME, *own, *_OF_STREAMS, *_OF_ANSWERS, *_OF_STORES)


def _limit(name: str, value: float, unit: str, what: str) -> LimitInfo:
    return LimitInfo(name=name, value=float(value), unit=unit, what=what)


_OF_PAYLOADS = (
    _limit("payload", codec.MAX_REQUEST_BYTES, "bytes", "of a query; a larger one is REQUEST_TOO_LARGE"),
    _limit("message", LONGEST_MESSAGE, "bytes", "that Zenoh takes; a larger one it drops, without an answer"),
    _limit("quantity", LARGEST, "SI units", "of any number, either way; more, NaN and infinities are refused"),
    _limit("urdf", MAX_URDF_CHARACTERS, "characters", "of a URDF or SRDF"),
    _limit("mesh_files", MAX_MESHES, "files", "that come with a robot"),
    _limit("mesh_file", MAX_MESH_BYTES, "bytes", "of one of them"),
    _limit("obstacle", MAX_VERTICES, "elements", "vertices, triangles or points, of one obstacle"),
    _limit("motion", MOST_ROWS, "rows", "of a motion to judge"),
    _limit("client_name", LONGEST_CLIENT, "bytes", "of a query's attachment that count"),
)
_OF_TIME = (
    _limit("kinematics_default", DEFAULT_TIME, "s", "that a kinematics request has without `allowed_time`"),
    _limit("longest_time", LONGEST_TIME, "s", "that a request may allow itself"),
    _limit("storing", STORE_TIME_LIMIT, "s", "for storing or describing a robot or scene, and for the list of robots"),
    _limit("late", LATE, "s", "after its time an answer comes, at most, where a robot is still loaded for it"),
    _limit("late_share", LATE_SHARE, "of the time allowed", "that may be added to that"),
    _limit("backstop", BACKSTOP, "s", "after its time a worker that still works is ended, and its request CRASH"),
    _limit("cancel_remembered", REMEMBERED, "s", "that a cancel is remembered which comes before its run or request"),
    _limit("cancels_remembered", MOST_REMEMBERED, "cancels", "that are remembered; the oldest are forgotten"),
    _limit("client_gone", GRACE, "s", "that a client's token may be gone before what it asked for ends"),
    _limit("link_cut", LEASE, "s", "that a link which was cut without a word may go unnoticed"),
)
_OF_STREAMS = (
    _limit("stream_silence", SILENCE, "s", "without an update, after which a stream ends and says so"),
    _limit("stream_opening", OPENED_WITHIN, "s", "that opening a stream may take"),
    _limit("stream_stuck", STUCK, "s", "that a stream's process may take for what it was sent; then it is ended"),
    _limit("stream_update", MOST_UPDATE_BYTES, "bytes", "of an update; a larger one is refused on `state`"),
    _limit("stream_waiting", MOST_WAITING, "updates", "that wait for a stream; more are refused on `state`"),
    _limit("stream_obstacles", MOST_OBSTACLES, "obstacles", "that a stream knows; those that are gone make room"),
    _limit("stream_goals", MOST_SOUGHT, "goals", "that are looked for at once; more are SERVER_BUSY"),
)
_OF_ANSWERS = (
    _limit("read_within", READ_WITHIN, "s", "for reading an answer; then Zenoh ends the link"),
    _limit("unread_of_client", MOST_BYTES_OF_CLIENT, "bytes", "of answers that wait for a client; more: SERVER_BUSY"),
    _limit("unread", MOST_BYTES, "bytes", "of answers that wait for all clients; more are SERVER_BUSY"),
    _limit("unread_answers", MOST_LETTERS, "answers", "that wait for all clients; more are SERVER_BUSY"),
    _limit("unread_of_user", OF_USER, "of these", "that one user may have"),
    _limit("list_counts", LIST_COUNTS, "queries", "as which a list, or all of `info`, counts beside `per_second`"),
    _limit("list_of_runs", LARGEST_PAGE, "runs", "on one page; `after` goes on"),
    _limit("reads", MOST_READS, "queries", "for files that wait for the disk; more are SERVER_BUSY"),
)
_OF_STORES = (
    _limit("robots", MAX_ROBOTS, "robots", "that are stored; more are refused"),
    _limit("robots_size", MAX_BYTES, "bytes", "that stored robots take; more are refused"),
    _limit("recording", LARGEST_RECORDING, "bytes", "of a recording; a larger one is dropped"),
)

DELIVERY = (
    DeliveryRule(
        name="one answer",
        rule="A query is answered exactly once: by a reply, or by an error as Zenoh's `reply_err`. A plan that was"
        " tried and not found is a reply with its status.",
    ),
    DeliveryRule(
        name="no answer",
        rule="No answer means that the instance or the link is gone, that the query's own time-out was too short, or"
        " that the message was larger than `message`. Ask again; another instance may answer.",
    ),
    DeliveryRule(
        name="order",
        rule="Answers come when they are ready, and in no order. A free worker takes a request of the user who has"
        " the fewest workers, of equal ones of whom the least was worked for since it came; of one user's clients one"
        " comes after the other, and of one client in order. Where the queue is full the last request of who has the"
        f" most is SERVER_BUSY. One more worker stands by for users who have none and wait for {HELD_UP:g} s; what it"
        f" works on for {TRIAL:g} s gives way to another such user, and begins anew; whoever gave way takes another"
        " one's place after twice as long each time.",
    ),
    DeliveryRule(
        name="time",
        rule="The time that a request allows counts from its arrival, queue and loading included. Give the query a"
        f" time-out that is at least {BACKSTOP:g} s longer, so that the service has the last word.",
    ),
    DeliveryRule(
        name="asked again",
        rule="A plan, judgement or kinematics request that comes again under the same id and in the same words is"
        " answered by the work under way; a run that has ended, by its kept reply. Reading is harmless to repeat; a"
        " repeated `?delete` finds nothing to delete.",
    ),
    DeliveryRule(
        name="cancel",
        rule="A cancel is answered at once. What it ends is answered as PREEMPTED, once: a plan by a reply with the"
        f" best by then, kinematics by an error. A cancel that comes first is remembered for {REMEMBERED:g} s.",
    ),
    DeliveryRule(
        name="gone client",
        rule="A client that declares `clients/<client>`, by the name in its queries' attachment, is missed: when the"
        f" token has been gone for {GRACE:g} s, whatever it asked for ends. Without a token work goes on.",
    ),
    DeliveryRule(
        name="progress",
        rule="Progress is published as it is made, without a history; a busy link may drop some. The answer doesn't"
        " depend on it.",
    ),
    DeliveryRule(
        name="streams",
        rule="An update is put, and answered on `pieces` or `state`, once: of updates that wait for their"
        " turn all but the newest are taken note of, and not answered. What is published for a stream waits for nobody:"
        " a client that doesn't read loses it, and its robot stops where its last piece does. A stream is told nothing"
        " about an update on the key of a stream that isn't open.",
    ),
    DeliveryRule(
        name="slow reader",
        rule=f"A client has {READ_WITHIN:g} s to read an answer, beside what the system keeps for it; then Zenoh ends"
        " its link. Nobody else waits for it.",
    ),
    DeliveryRule(
        name="start and end",
        rule="From the first second of a start to the end, `info`, lists and files are answered. What needs a worker is"
        " SERVER_BUSY before the service is ready and once it ends.",
    ),
)
"""The rules by which queries are answered."""
