"""Every status code of the wire: its meaning, its Python exception, and whether it travels as reply or error."""

from __future__ import annotations

from typing import Literal

from guidefield.errors import ERRORS, Status
from guidefield.messages.values import Reply


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
    Status.SUCCESS: "a certified motion, or a motion that is judged to be free and within limits",
    Status.PLANNING_FAILED: "no connection was found",
    Status.INVALID_MOTION_PLAN: "the certificate refused every motion, or the one that was given",
    Status.TIMED_OUT: "time was up; a plan's reply has the best by then",
    Status.PREEMPTED: "it was cancelled; a plan's reply has the best by then",
    Status.START_STATE_IN_COLLISION: "the start touches something",
    Status.START_STATE_VIOLATES_PATH_CONSTRAINTS: "the start violates a path constraint",
    Status.GOAL_IN_COLLISION: "every goal configuration touches something",
    Status.GOAL_VIOLATES_PATH_CONSTRAINTS: "every goal configuration violates a path constraint",
    Status.GOAL_CONSTRAINTS_VIOLATED: "the goal was not reached as asked",
    Status.INVALID_GROUP_NAME: "the joints can't be planned for",
    Status.INVALID_GOAL_CONSTRAINTS: "the goal doesn't fit the robot, the scene or the planner",
    Status.INVALID_ROBOT_STATE: "an unknown joint, a wrong length, no unit quaternion",
    Status.INVALID_LINK_NAME: "there is no such link or frame",
    Status.INVALID_OBJECT_NAME: "there is no such obstacle, run or object",
    Status.COMMUNICATION_FAILURE: "nobody answers",
    Status.START_STATE_INVALID: "the start is beyond a limit",
    Status.GOAL_STATE_INVALID: "the goal is beyond a limit",
    Status.CRASH: "the worker died; the service lives on",
    Status.NO_IK_SOLUTION: "no configuration reaches the pose; `details` say why",
    Status.STUCK_IN_MINIMUM: "the guided planner got stuck before a guide plane",
    Status.GUIDE_PLANE_UNREACHABLE: "the tip can't reach a guide plane",
    Status.CLEARANCE_BELOW_MINIMUM: "no motion keeps `min_clearance`",
    Status.SCENE_INVALID: "the scene is unknown or can't be used",
    Status.ROBOT_INVALID: "the robot is unknown or can't be used",
    Status.SERVER_BUSY: "too much waits already, or the service starts or ends; ask again later",
    Status.MALFORMED_REQUEST: "syntax, an unknown field, a wrong type",
    Status.REQUEST_TOO_LARGE: "the payload, or a part of it, is too large",
    Status.QUOTA_EXCEEDED: "more than this user may have; `retry_after` says when to ask again [s]",
    Status.NOT_ALLOWED: "it is another user's, who doesn't share it, or alone may change it",
    Status.STREAM_UNKNOWN: "no such stream is open, or not any more",
    Status.DISK_REFUSED: "the service's disk is full, or can't be written or read",
    Status.FAILURE: "a bug, logged with its trace",
}
"""Meaning of each code."""


_EITHER = (Status.TIMED_OUT, Status.PREEMPTED)
"""Replies to plans and judgements, errors to anything else."""
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
