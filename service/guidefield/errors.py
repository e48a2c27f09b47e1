"""All exceptions of guidefield, each with its wire code and the values of its message.

Codes and class names are the wire and the public API; a new code needs a meaning in `messages/service.py` and advice in
`mcp_server.py`. A code with an exception travels as an error, others are outcomes in replies; a new exception also goes
into the package's `__all__`. `endpoint/ros/refusals.py` maps our own codes, -101 and below, to MoveIt's.
"""

from __future__ import annotations

import contextlib
import enum
import errno
import re
from collections.abc import Iterator
from typing import Any, ClassVar


class Status(enum.IntEnum):
    """Outcome codes of the wire; MoveIt's names and numbers where the meaning is the same."""

    SUCCESS = 1
    PLANNING_FAILED = -1
    INVALID_MOTION_PLAN = -2
    TIMED_OUT = -6
    PREEMPTED = -7
    START_STATE_IN_COLLISION = -10
    START_STATE_VIOLATES_PATH_CONSTRAINTS = -11
    GOAL_IN_COLLISION = -12
    GOAL_VIOLATES_PATH_CONSTRAINTS = -13
    GOAL_CONSTRAINTS_VIOLATED = -14
    INVALID_GROUP_NAME = -15
    INVALID_GOAL_CONSTRAINTS = -16
    INVALID_ROBOT_STATE = -17
    INVALID_LINK_NAME = -18
    INVALID_OBJECT_NAME = -19
    COMMUNICATION_FAILURE = -25
    START_STATE_INVALID = -26
    GOAL_STATE_INVALID = -27
    CRASH = -29
    NO_IK_SOLUTION = -31
    STUCK_IN_MINIMUM = -101
    GUIDE_PLANE_UNREACHABLE = -102
    CLEARANCE_BELOW_MINIMUM = -103
    SCENE_INVALID = -104
    ROBOT_INVALID = -105
    SERVER_BUSY = -106
    MALFORMED_REQUEST = -107
    REQUEST_TOO_LARGE = -108
    QUOTA_EXCEEDED = -109
    NOT_ALLOWED = -110
    STREAM_UNKNOWN = -111
    DISK_REFUSED = -112
    FAILURE = 99999


class GuidefieldError(Exception):
    """Base of all errors that travel as ``reply_err``.

    Attributes:
        message: One sentence: what was expected, what came, what is valid.
        details: The values of the message, as plain JSON data.
    """

    code: ClassVar[Status] = Status.FAILURE  # the wire code of this kind of error

    def __init__(self, message: str, **details: Any) -> None:
        super().__init__(message)
        self.message = message
        self.details: dict[str, Any] = details

    def __reduce__(self) -> tuple[Any, ...]:
        # Exceptions with keyword arguments don't pickle by themselves; workers send theirs to the endpoint.
        return (_rebuild, (type(self), self.message, self.details))


@contextlib.contextmanager
def at_path(path: str) -> Iterator[None]:
    """Prefix the paths of faults raised in a block with the `path` of its part of the request."""
    try:
        yield
    except GuidefieldError as error:
        inner = str(error.details.get("path", "$"))
        if inner.startswith("$"):
            error.details["path"] = path + inner[1:]
        raise


def _rebuild(kind: type[GuidefieldError], message: str, details: dict[str, Any]) -> GuidefieldError:
    return kind(message, **details)


class MalformedRequest(GuidefieldError):
    """The payload is not a request: syntax, unknown field, wrong type or length, NaN."""

    code = Status.MALFORMED_REQUEST


class RequestTooLarge(GuidefieldError):
    """The payload, or a part of it, exceeds a size limit."""

    code = Status.REQUEST_TOO_LARGE


class RobotInvalid(GuidefieldError):
    """The robot is unknown, or its description cannot be used."""

    code = Status.ROBOT_INVALID


class SceneInvalid(GuidefieldError):
    """The scene is unknown, or an obstacle or guide plane of it cannot be used."""

    code = Status.SCENE_INVALID


class InvalidGroup(GuidefieldError):
    """The group of joints cannot be planned for."""

    code = Status.INVALID_GROUP_NAME


class InvalidGoal(GuidefieldError):
    """The goal does not fit the robot, the scene or the planner."""

    code = Status.INVALID_GOAL_CONSTRAINTS


class InvalidConfiguration(GuidefieldError):
    """A configuration has an unknown joint, a wrong length or a quaternion that isn't one."""

    code = Status.INVALID_ROBOT_STATE


class UnknownFrame(GuidefieldError):
    """The robot has no such link or frame."""

    code = Status.INVALID_LINK_NAME


class UnknownObject(GuidefieldError):
    """The scene, the robot or the store has no such object."""

    code = Status.INVALID_OBJECT_NAME


class ServerBusy(GuidefieldError):
    """The queue is full; ask again later."""

    code = Status.SERVER_BUSY


class QuotaExceeded(GuidefieldError):
    """A quota of the user is exceeded: requests, time or space; `details` say when to ask again, if time helps."""

    code = Status.QUOTA_EXCEEDED


class NotAllowed(GuidefieldError):
    """The thing belongs to another user, who doesn't share it, or who alone may change it."""

    code = Status.NOT_ALLOWED


class StreamUnknown(GuidefieldError):
    """The stream isn't open."""

    code = Status.STREAM_UNKNOWN


class WorkerCrashed(GuidefieldError):
    """The process that worked on the request died; the service lives on."""

    code = Status.CRASH


class NoService(GuidefieldError):
    """No service of that name answers at that address; raised by the client, never sent."""

    code = Status.COMMUNICATION_FAILURE


class TimedOut(GuidefieldError):
    """The allowed time of a request was up; for a plan that is a reply instead."""

    code = Status.TIMED_OUT


class Preempted(GuidefieldError):
    """The request was cancelled, or its client is gone; for a plan that is a reply instead."""

    code = Status.PREEMPTED


class DiskRefused(GuidefieldError):
    """The service's disk can't be written or read."""

    code = Status.DISK_REFUSED


class InternalFailure(GuidefieldError):
    """A bug of ours; logged with its trace."""

    code = Status.FAILURE

    @classmethod
    def of(cls, bug: Exception) -> InternalFailure:
        """Return the error for a bug."""
        kind = type(bug).__name__
        text = strip_path(bug) if isinstance(bug, OSError) else bug
        return cls(f"a bug in guidefield stopped this request: {kind}: {text}", kind=kind)


ERRORS: dict[Status, type[GuidefieldError]] = {kind.code: kind for kind in GuidefieldError.__subclasses__()}
"""Exception by wire code, for clients that turn a ``reply_err`` back into an exception.

So each exception is a direct subclass of `GuidefieldError`, with a code of its own.
"""


def convert_exception(error: Exception) -> GuidefieldError:
    """Convert a foreign exception: out of memory or files, a disk error, or a bug; one of ours stays."""
    if isinstance(error, GuidefieldError):
        return error
    if isinstance(error, MemoryError) or (isinstance(error, OSError) and error.errno == errno.ENOMEM):
        return WorkerCrashed("the request needs more memory than there is")
    if not isinstance(error, OSError) or error.errno is None:
        return InternalFailure.of(error)
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return WorkerCrashed(f"the system refuses more open files: {strip_path(error)}")
    if isinstance(error, FileNotFoundError | ConnectionError):
        return InternalFailure.of(error)
    return DiskRefused(f"the disk refuses: {strip_path(error)}")


def strip_path(error: OSError) -> str:
    """Return the system's message without the path, which a client need not know."""
    return error.strerror or type(error).__name__


def strip_source(error: Exception) -> str:
    """Return the message of an error of Zenoh without its place in Zenoh's source."""
    return re.sub(r"!?\s+at \S+\.rs:\d+\.?", "", str(error))
