"""The keys of an instance, their purposes, parameters and messages."""

from __future__ import annotations

from typing import Literal

from guidefield.messages.values import Reply

SHARING = {
    "share": "lets every user read it, as `<user>:<name>`",
    "unshare": "lets nobody else read it any more, but operators",
}
DELETE = {"delete": "forgets it; without a payload"}


class KeyInfo(Reply):
    """One key of an instance.

    Attributes:
        key: Below the instance's, ``guidefield/<i>/``.
        what: Its purpose.
        how: Whether it is queried, put by clients, published for subscribers, or a liveliness token.
        worker: Whether a query waits for a worker: never, always, only with a payload, or while the recording is
            owed. A query without a worker is answered while the service starts and ends, too.
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
    KeyInfo(
        "certify", "judges a motion that is given", worker="always", takes=["CertifyRequest"], gives=["CertifyReply"]
    ),
    KeyInfo(
        "kinematics",
        "answers at configurations, poses or points, one or many",
        worker="always",
        takes=["ForwardKinematics", "InverseKinematics", "Clearance", "Potential", "Jacobian", "Dynamics"],
        gives=[
            *("ForwardKinematicsReply", "InverseKinematicsReply", "ClearanceReply"),
            *("JacobianReply", "DynamicsReply"),
            *("PointPotentialReply", "RobotPotentialReply"),
        ],
    ),
    KeyInfo("requests/<id>/cancel", "ends one kinematics request early, by its request_id", gives=["Done"]),
    KeyInfo("robots", "lists the robots that can be named", worker="always", gives=["RobotsReply"]),
    KeyInfo(
        "robots/<name>",
        "describes one robot; with a payload stores it",
        worker="always",
        parameters=DELETE | SHARING,
        takes=["RobotFiles"],
        gives=["RobotReply", "Done"],
    ),
    KeyInfo("scenes", "lists the scenes that can be named", gives=["ScenesReply"]),
    KeyInfo(
        "scenes/<name>",
        "reads one scene; with a payload stores or changes it",
        worker="with a payload",
        parameters={**DELETE, **SHARING, "version": "reads this one of the last 16 versions"},
        takes=["Scene", "SceneDiff"],
        gives=["SceneReply", "Done"],
    ),
    KeyInfo("scenes/<name>/changes", "what changes about a stored scene", how="published", gives=["SceneChanged"]),
    KeyInfo(
        "runs",
        "lists the kept runs, newest first",
        parameters={
            "status": "only those that ended so: the name of a status, RUNNING or UNREADABLE",
            "robot": "only those of a robot",
            "since": "only those begun since then [s since 1970]",
            "text": "only those with this text in the message of their status",
            "limit": "at most so many, up to 1000",
            "after": "goes on where a list ended, by its `next`",
        },
        gives=["RunsReply"],
    ),
    KeyInfo(
        "runs/<id>",
        "request and reply of one run, also while it runs",
        parameters={"delete": "forgets it, with its recording and proof", **SHARING},
        gives=["RunReply", "CertifyRunReply", "Done"],
    ),
    KeyInfo("runs/<id>/recording", "the recording of one run, an .rrd file", worker="while it is owed"),
    KeyInfo("runs/<id>/proof", "the proof of one run that asked for it, an .npz file"),
    KeyInfo("runs/<id>/cancel", "ends one run early", gives=["Done"]),
    KeyInfo("runs/<id>/progress", "how far one run is, while it runs", how="published", gives=["Progress"]),
    KeyInfo(
        "shared/runs/<user>:<id>/progress",
        "the same of a run that its user shares, below `guidefield/<i>` for everybody",
        how="published",
        gives=["Progress"],
    ),
    KeyInfo(
        "streams",
        "lists the streams that are open; with a payload opens one",
        worker="with a payload",
        takes=["StreamOpen"],
        gives=["StreamsReply", "StreamReply"],
    ),
    KeyInfo(
        "streams/<id>",
        "how one stream is",
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
        "whether its last piece is still proven by what was seen last; plans nothing",
        worker="with a payload",
        takes=["StreamJudge"],
        gives=["StreamJudged"],
    ),
    KeyInfo("streams/<id>/stop", "has its robot stop", gives=["Done"]),
    KeyInfo(
        "streams/<id>/recording",
        "what is kept of one stream, open or over, as an .rrd file that is made when it is asked for",
        worker="always",
    ),
    KeyInfo("streams/<id>/update", "what its client sees, put by it", how="put", takes=["StreamUpdate"]),
    KeyInfo("streams/<id>/pieces", "pieces of motion, each with its stop", how="published", gives=["Piece"]),
    KeyInfo("streams/<id>/state", "why an update got no piece", how="published", gives=["StreamState"]),
    KeyInfo(
        "info",
        "what the service is and does; also while it starts and ends",
        parameters={"brief": "the figures only: without versions, keys, codes, limits, rules and schemas"},
        gives=["InfoReply"],
    ),
    KeyInfo("alive", "is there as long as requests are taken", how="token"),
    KeyInfo("clients/<client>", "declared by a client; when it is gone, what it asked for ends", how="token"),
    KeyInfo("starting", "is there while it starts", how="token"),
)
"""Every key."""

SERVED = tuple(key.key for key in KEYS if key.how == "query")
"""The keys that can be queried."""
