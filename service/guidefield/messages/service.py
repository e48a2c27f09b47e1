"""The service about itself: the reply to `info`, the meaning of each status code, and the progress of a run.

keys.py fills `KeyInfo`, `endpoint/rules.py` limits and rules.

Names, meanings and defaults of fields, and statuses, are the wire. Docstrings of messages, and `MEANINGS`, are in
docs/wire.md and the schemas: after a change, `tools/wire_page`.
"""

from __future__ import annotations

from typing import Any, Literal

from guidefield.errors import ERRORS, Status
from guidefield.messages.identities import Quota
from guidefield.messages.values import (
    Message,
    Reply,
)


class ReadInfo(Message, tag_field="type", tag="info"):
    """Versions, the JSON Schema of every message, counters."""


class Histogram(Reply):
    """A histogram of durations: `counts[i]` up to `bounds[i]` [s], the last count beyond; and the sum [s]."""

    bounds: list[float]
    counts: list[int]
    sum: float


class Health(Reply):
    """The health of a service.

    Attributes:
        state: starting: only queries without a worker are answered; ready; ending: no new work begins.
        doing: Its present work in a sentence; empty if it is ready.
    """

    state: Literal["starting", "ready", "ending"] = "ready"
    doing: str = ""


class Disk(Reply):
    """The disk of the data folder: its free space and its size [bytes]."""

    free: int
    total: int


class LimitInfo(Reply):
    """One limit of a service.

    Attributes:
        name: Its name.
        value: Its value.
        unit: Its unit: s, bytes, or the counted things.
        what: The limited quantity, and the consequence of exceeding it.
    """

    name: str
    value: float
    unit: str
    what: str


class DeliveryRule(Reply):
    """One rule by which queries are answered.

    Attributes:
        name: Its subject.
        rule: The rule in a few sentences.
    """

    name: str
    rule: str


class UserFigures(Reply):
    """The requests and processor time of a user now.

    Attributes:
        waiting: Number of waiting requests.
        running: Number of running requests.
        processor: Recent processor time; time of 30 s ago counts half [s].
    """

    waiting: int = 0
    running: int = 0
    processor: float = 0.0


class Identity(Reply):
    """The identity of the caller, as far as the service knows it.

    Attributes:
        user: The user whose keys were queried; ``plain`` for keys without one.
        access_control: Whether the service's own configuration has access control. If neither it nor a router has,
            anybody can use anybody's keys, and all users of the plain keys are one user.
        quota: The quota of this user.
    """

    user: str
    access_control: bool
    quota: Quota


class CodeInfo(Reply):
    """One status code.

    Attributes:
        code: Its number.
        name: Its name.
        travels: As the status of a reply, as an error, as either, or never: only a client raises it.
        meaning: Its meaning in words.
        exception: Name of the Python exception of the error; null if it is never an error.
    """

    code: int
    name: str
    travels: Literal["reply", "error", "either", "never"]
    meaning: str
    exception: str | None = None


MEANINGS = {
    Status.SUCCESS: "certified, or judged free and within limits",
    Status.PLANNING_FAILED: "no connection was found",
    Status.INVALID_MOTION_PLAN: "the certificate refused the motion",
    Status.TIMED_OUT: "time was up; a plan has the best by then",
    Status.PREEMPTED: "cancelled; a plan has the best by then",
    Status.START_STATE_IN_COLLISION: "the start touches something",
    Status.START_STATE_VIOLATES_PATH_CONSTRAINTS: "the start violates a path constraint",
    Status.GOAL_IN_COLLISION: "every goal configuration touches something",
    Status.GOAL_VIOLATES_PATH_CONSTRAINTS: "every goal configuration violates a path constraint",
    Status.GOAL_CONSTRAINTS_VIOLATED: "the goal was not reached as asked",
    Status.INVALID_GROUP_NAME: "the joints can't be planned for",
    Status.INVALID_GOAL_CONSTRAINTS: "the goal doesn't fit robot, scene or planner",
    Status.INVALID_ROBOT_STATE: "unknown joint, wrong length, no unit quaternion",
    Status.INVALID_LINK_NAME: "no such link or frame",
    Status.INVALID_OBJECT_NAME: "no such obstacle, run or object",
    Status.COMMUNICATION_FAILURE: "nobody answers",
    Status.START_STATE_INVALID: "the start is beyond a limit",
    Status.GOAL_STATE_INVALID: "the goal is beyond a limit",
    Status.CRASH: "the worker died, not the service",
    Status.NO_IK_SOLUTION: "no configuration reaches the pose; `details` say why",
    Status.STUCK_IN_MINIMUM: "stuck before a guide plane",
    Status.GUIDE_PLANE_UNREACHABLE: "the tip can't reach a guide plane",
    Status.CLEARANCE_BELOW_MINIMUM: "no motion keeps `min_clearance`",
    Status.SCENE_INVALID: "the scene is unknown or can't be used",
    Status.ROBOT_INVALID: "the robot is unknown or can't be used",
    Status.SERVER_BUSY: "full queue, start or end of the service; ask again",
    Status.MALFORMED_REQUEST: "syntax, an unknown field, a wrong type",
    Status.REQUEST_TOO_LARGE: "the payload or a part is too large",
    Status.QUOTA_EXCEEDED: "the user's quota; ask again after `retry_after` [s]",
    Status.NOT_ALLOWED: "it is another user's",
    Status.STREAM_UNKNOWN: "no such stream is open",
    Status.DISK_REFUSED: "the service's disk is full, or fails",
    Status.FAILURE: "a bug, logged with its trace",
}
"""Meaning of each code."""
_EITHER = (Status.TIMED_OUT, Status.PREEMPTED)
"""Statuses that are replies to plans and judgements, and errors to anything else."""
_NEVER = (Status.COMMUNICATION_FAILURE,)


def _code_info(status: Status) -> CodeInfo:
    kind = ERRORS.get(status)
    travels: Literal["reply", "error", "either", "never"] = "reply" if kind is None else "error"
    if status in _EITHER:
        travels = "either"
    if status in _NEVER:
        travels = "never"
    return CodeInfo(
        code=int(status),
        name=status.name,
        travels=travels,
        meaning=MEANINGS[status],
        exception=None if kind is None else kind.__name__,
    )


CODES = tuple(_code_info(status) for status in Status)
"""Every code."""


class KeyInfo(Reply):
    """One key of an instance, which is a running service.

    Attributes:
        key: Below the instance's, ``guidefield/<i>/``.
        what: Its purpose.
        how: Whether it is queried, put by clients, published for subscribers, or a liveliness token.
        worker: Whether a query waits for a worker: never, always, only with a payload, or while the recording is
            not rendered yet. A query without a worker is answered while the service starts and ends, too.
        parameters: The valid parameters, and their meanings.
        takes: Names of the messages of its payload; none: it takes no payload.
        gives: Names of the messages that it replies or publishes; none: bytes.
    """

    key: str
    what: str
    how: Literal["query", "put", "published", "token"] = "query"
    worker: Literal["never", "always", "with a payload", "while it is owed"] = "never"
    parameters: dict[str, str] = {}
    takes: list[str] = []
    gives: list[str] = []


class InfoReply(Reply):
    """The service and its figures.

    Attributes:
        version: Of guidefield.
        packages: Versions of its packages.
        schemas: JSON Schema of every message; empty in a brief reply, as are the packages, keys, codes, limits and
            rules.
        workers: Number of worker processes.
        busy: Number of busy ones.
        queue: Number of waiting requests.
        counters: Counts since the start.
        uptime: Time since the start [s].
        latency: From a query's arrival to its answer, by the first chunk of its key.
        memory: Resident memory of the workers, of the streams' processes and of that which renders recordings [bytes].
        keys: Every key with its parameters and messages; the names are those of the schemas.
        codes: Every status code.
        limits: Its limits.
        delivery: Its rules of delivery.
        health: Its health.
        own_memory: Resident memory of the service's own process, without the workers [bytes].
        disk: The disk of its runs, scenes and robots; null if it stores none.
        payload_limit: The largest payload that is decoded [bytes]; a larger one is refused.
        identity: Identity of the caller; null in this process.
        users: Present figures of users: for operators all users with any, for a user its own.
        streams: Number of open streams.
    """

    version: str
    packages: dict[str, str]
    schemas: dict[str, Any]
    workers: int
    queue: int
    counters: dict[str, int]
    uptime: float
    busy: int = 0
    latency: dict[str, Histogram] = {}
    memory: int = 0
    keys: list[KeyInfo] = []
    codes: list[CodeInfo] = []
    limits: list[LimitInfo] = []
    delivery: list[DeliveryRule] = []
    health: Health = Health()
    own_memory: int = 0
    disk: Disk | None = None
    payload_limit: int = 0
    identity: Identity | None = None
    users: dict[str, UserFigures] = {}
    streams: int = 0
    schema: int = 1


class Progress(Reply):
    """The progress of a run, published while it runs.

    Attributes:
        run_id: Its name.
        stage: Its present stage, such as load, guide, connect, relax, parameterize, certify.
        plane: Index of the guide plane that it approaches, if any.
        clearance: Distance of the robot to the obstacles at the last step [m]; None without obstacles, or before.
        best_clearance: The largest of those published by now [m].
        elapsed: Time since the request arrived [s].
        preparing: In the stage load, the part of robot or scene that is prepared: ``cutting link2, shape 3 of 8``.
    """

    run_id: str
    stage: str
    plane: int | None
    clearance: float | None
    best_clearance: float | None
    elapsed: float
    preparing: str | None = None
    schema: int = 1
