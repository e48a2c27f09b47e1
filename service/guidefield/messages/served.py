"""The keys of a service, their purposes, parameters and messages, and the meaning of each status code.

What is served is decided by `check` of messages/keys.py and by messages/stream_requests.py; from here they take
`SHARING` and, for the error about an unknown key, `SERVED`. Tests compare the two. Words here are in `info` and
docs/wire.md: after a change, `tools/wire_page`.
"""

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

SHARING = {
    "share": "lets every user read it, as `<user>:<name>`",
    "unshare": "ends that, but for operators",
}
"""The parameters that share; keys.py accepts these names."""
DELETE = {"delete": "forgets it"}


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


KEYS = (
    KeyInfo("plan", "plans a motion", worker="always", takes=["PlanRequest"], gives=["PlanReply"]),
    KeyInfo("certify", "judges a given motion", worker="always", takes=["CertifyRequest"], gives=["CertifyReply"]),
    KeyInfo(
        "kinematics",
        "kinematics, dynamics, distances, potentials",
        worker="always",
        takes=["ForwardKinematics", "InverseKinematics", "Clearance", "Potential", "Jacobian", "Dynamics"],
        gives=[
            *("ForwardKinematicsReply", "InverseKinematicsReply", "ClearanceReply"),
            *("JacobianReply", "DynamicsReply"),
            *("PointPotentialReply", "RobotPotentialReply"),
        ],
    ),
    KeyInfo("requests/<id>/cancel", "cancels a kinematics request", gives=["Done"]),
    KeyInfo("robots", "lists robots", worker="always", gives=["RobotsReply"]),
    KeyInfo(
        "robots/<name>",
        "describes a robot; with a payload stores it",
        worker="always",
        parameters=DELETE | SHARING,
        takes=["RobotFiles"],
        gives=["RobotReply", "Done"],
    ),
    KeyInfo("scenes", "lists scenes", gives=["ScenesReply"]),
    KeyInfo(
        "scenes/<name>",
        "reads a scene; with a payload stores or changes it",
        worker="with a payload",
        parameters={**DELETE, **SHARING, "version": "one of the last 16"},
        takes=["Scene", "SceneDiff"],
        gives=["SceneReply", "Done"],
    ),
    KeyInfo("scenes/<name>/changes", "changes of a stored scene", how="published", gives=["SceneChanged"]),
    KeyInfo(
        "runs",
        "lists kept runs, newest first",
        parameters={
            "status": "name of a status, RUNNING or UNREADABLE",
            "robot": "its name",
            "since": "begin [s since 1970]",
            "text": "part of the status's message",
            "limit": "up to 1000",
            "after": "`next` of the page before",
        },
        gives=["RunsReply"],
    ),
    KeyInfo(
        "runs/<id>",
        "request and reply of a run, also while it runs",
        parameters={"delete": "forgets it, its recording and proof", **SHARING},
        gives=["RunReply", "CertifyRunReply", "Done"],
    ),
    KeyInfo("runs/<id>/recording", "a run's recording, .rrd", worker="while it is owed"),
    KeyInfo("runs/<id>/proof", "a run's proof, .npz"),
    KeyInfo("runs/<id>/cancel", "cancels a run", gives=["Done"]),
    KeyInfo("runs/<id>/progress", "progress of a run", how="published", gives=["Progress"]),
    KeyInfo(
        "shared/runs/<user>:<id>/progress",
        "progress of a shared run, for every user",
        how="published",
        gives=["Progress"],
    ),
    KeyInfo(
        "streams",
        "lists open streams; with a payload opens one",
        worker="with a payload",
        takes=["StreamOpen"],
        gives=["StreamsReply", "StreamReply"],
    ),
    KeyInfo(
        "streams/<id>",
        "state of a stream",
        parameters={"delete": "ends it"},
        gives=["StreamReply", "Done"],
    ),
    KeyInfo(
        "streams/<id>/goal",
        "sets its goal",
        worker="with a payload",
        takes=["StreamAim"],
        gives=["StreamAimed"],
    ),
    KeyInfo(
        "streams/<id>/judge",
        "judges its last piece by the last observations",
        worker="with a payload",
        takes=["StreamJudge"],
        gives=["StreamJudged"],
    ),
    KeyInfo("streams/<id>/stop", "stops its robot", gives=["Done"]),
    KeyInfo(
        "streams/<id>/recording",
        "a kept stream, .rrd, made on demand",
        worker="always",
    ),
    KeyInfo("streams/<id>/update", "what its client sees", how="put", takes=["StreamUpdate"]),
    KeyInfo("streams/<id>/pieces", "pieces of motion, each with its stop", how="published", gives=["Piece"]),
    KeyInfo("streams/<id>/state", "why an update got no piece", how="published", gives=["StreamState"]),
    KeyInfo(
        "info",
        "state, figures, rules and schemas of the service",
        parameters={"brief": "state and figures only"},
        gives=["InfoReply"],
    ),
    KeyInfo("alive", "exists while requests are taken", how="token"),
    KeyInfo("clients/<client>", "declared by a client; when it is gone, its requests end", how="token"),
    KeyInfo("starting", "exists while the service starts", how="token"),
    KeyInfo("starting/<id>", "exists while a service looks whether another one has its name", how="token"),
)
"""Every key."""

SERVED = tuple(key.key for key in KEYS if key.how == "query")
"""The keys that can be queried, which the error about any other lists."""
