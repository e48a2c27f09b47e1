"""Requests about the robots, scenes and runs of a service, each with its reply: `Done` if it has none of its own.

A new one stands here, request and reply, and in the unions at the end; keys.py decodes it from a key, and `Engine`
answers it.

Names, order, defaults and meanings of fields are the wire and the Python API: a new one comes last. Docstrings of
messages, and the largest numbers here, are in docs/wire.md and the schemas: after a change, `tools/wire_page`.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

import msgspec

from guidefield.errors import Status
from guidefield.messages.certify_reply import (
    CertifyReply,
)
from guidefield.messages.certify_request import CertifyRequest
from guidefield.messages.conditions import (
    RobotReference,
)
from guidefield.messages.plan_reply import (
    PlanReply,
)
from guidefield.messages.plan_request import PlanRequest
from guidefield.messages.scene import Scene
from guidefield.messages.scene_changes import SceneDiff, Version
from guidefield.messages.values import (
    Message,
    Name,
    Positions,
    Reply,
    RootJoint,
    RunId,
    UrdfCharacters,
)


class ReadRobots(Message, tag_field="type", tag="robots"):
    """List the robots that can be planned for."""


class RobotSummary(Reply):
    """One line of the list of robots; those of one family are variants. `dof` excludes mimic joints."""

    name: str
    source: str
    family: str
    dof: int | None = None
    joint_kinds: dict[str, int] = {}
    mimics: int = 0
    groups: list[str] = []
    tip: str | None = None
    problem: str | None = None


class RobotsReply(Reply):
    """All robots of the catalog and the store."""

    robots: list[RobotSummary]
    schema: int = 1


class ReadRobot(Message, tag_field="type", tag="robot"):
    """Describe one robot: joints, limits and their sources, frames, groups, collision pairs."""

    robot: RobotReference


class JointInfo(Reply):
    """One joint.

    Attributes:
        name: Its name.
        kind: Its type, such as revolute or planar. A continuous joint is revolute, with whole turns that count, if one
            of its mimic joints is elsewhere after a turn: it slides, has limits, or turns half as far.
        lower, upper: Limits of its coordinates [rad or m]; null for none.
        velocity: Limits [rad/s or m/s].
        acceleration: Limits [rad/s^2 or m/s^2].
        velocity_source, acceleration_source: Sources of those limits.
        mimics: Its source joint, if it is a mimic joint; at the end of a chain of mimic joints.
        multiplier, offset: Its value is then multiplier * the source joint's, with whole turns, + offset [rad or m].
    """

    name: str
    kind: str
    lower: list[float | None]
    upper: list[float | None]
    velocity: list[float]
    acceleration: list[float]
    velocity_source: str
    acceleration_source: str
    mimics: str | None = None
    multiplier: float = 1.0
    offset: float = 0.0


class PairLeftOut(Reply):
    """A pair of links that isn't tested for collision, and the reason."""

    links: list[str]
    reason: str


class CoverInfo(Reply):
    """Bounding spheres of a shape, their largest distance beyond it [m], and the number of inscribed spheres."""

    spheres: int
    overhang: float
    inner_balls: int


class PartsInfo(Reply):
    """Convex parts that together contain a mesh, and their one-sided Hausdorff distance to it [m]."""

    count: int
    stand_off: float


class GeometryInfo(Reply):
    """One collision shape of a link, its form in collision checks, and a hull's Hausdorff distance to the mesh [m].

    Cover and parts are null until the first plan that needs them computes them.
    """

    name: str
    link: str
    shape: str
    judged_as: str
    stand_off: float = 0.0
    cover: CoverInfo | None = None
    parts: PartsInfo | None = None


class RobotReply(Reply):
    """All facts about a robot that a client needs to plan for it.

    Attributes:
        rest: Values of joints that a request leaves out.
        rest_state: Name of the SRDF's state in `rest`; null if there is none.
    """

    name: str
    joints: list[JointInfo]
    frames: list[str]
    links: list[str]
    groups: dict[str, list[str]]
    tip: str
    rest: Positions
    geometry: list[GeometryInfo]
    collision_pairs: list[list[str]]
    pairs_left_out: list[PairLeftOut]
    warnings: list[str]
    rest_state: str | None = None
    schema: int = 1


class Done(Reply):
    """The success of a command.

    Attributes:
        done: The command in words.
        warnings: Harmless peculiarities of the stored robot or scene.
        version: New version of the stored or changed scene.
    """

    done: str
    warnings: list[str] = []
    version: int | None = None
    schema: int = 1


class RobotFiles(Message):
    """A client's own robot: its URDF, its SRDF, and mesh files by their URIs in the URDF.

    Files that a mesh file names (materials, textures, buffers) are sent too, by the URI that their name leads to.
    """

    urdf: UrdfCharacters
    srdf: UrdfCharacters | None = None
    meshes: dict[Annotated[str, msgspec.Meta(min_length=1, max_length=1024)], bytes] = {}
    root_joint: RootJoint = "fixed"


class StoreRobot(Message, tag_field="type", tag="store_robot"):
    """Store a robot under a name that the catalog doesn't have; it replaces an earlier one of that name."""

    name: Name
    files: RobotFiles


class DeleteRobot(Message, tag_field="type", tag="delete_robot"):
    """Forget a stored robot."""

    name: Name


class ReadScenes(Message, tag_field="type", tag="scenes"):
    """List the scenes that can be named."""


class ScenesReply(Reply):
    """The names of all scenes."""

    scenes: list[str]
    schema: int = 1


class ReadScene(Message, tag_field="type", tag="scene"):
    """Read a stored scene: a version of it, or the newest."""

    name: Name
    version: Version | None = None


class SceneReply(Reply):
    """A scene of the package, or a stored one.

    Attributes:
        scene: The scene.
        version: Number of times that it was stored or changed; null: it is part of the package and never changes.
    """

    scene: Scene
    version: int | None = None
    schema: int = 1


class StoreScene(Message, tag_field="type", tag="store_scene"):
    """Store a scene under its name."""

    name: Name
    scene: Scene

    def __post_init__(self) -> None:
        if self.scene.name != self.name:
            raise ValueError(f"the scene is named {self.scene.name!r}, but it is stored as {self.name!r}")


class ChangeScene(Message, tag_field="type", tag="change_scene"):
    """Change a stored scene: remove, move and add obstacles."""

    name: Name
    diff: SceneDiff


class DeleteScene(Message, tag_field="type", tag="delete_scene"):
    """Forget a stored scene."""

    name: Name


RUNNING = "RUNNING"
"""The status of a run that has not ended."""
UNREADABLE = "UNREADABLE"
"""The status of a run with a damaged reply; and its robot and scene if the request is damaged."""
LARGEST_PAGE = 1_000
"""The largest number of runs in a list; docs/service.md and keys.py tell it, too."""


class ReadRuns(Message, tag_field="type", tag="runs"):
    """List the stored runs, newest first.

    Attributes:
        status: Only those of this status: the name of one, or RUNNING, or UNREADABLE.
        robot: Only those of this robot.
        since: Only those begun at this time or later [s since 1970].
        text: Only those with this text in the message of their status; case doesn't matter for ASCII.
        limit: The largest number of runs.
        after: The `next` of the last page, to continue after it; null: from the newest on.
    """

    status: str | None = None
    robot: str | None = None
    since: float | None = None
    text: Annotated[str, msgspec.Meta(min_length=1, max_length=200)] | None = None
    limit: Annotated[int, msgspec.Meta(ge=1, le=LARGEST_PAGE)] = LARGEST_PAGE
    after: str | None = None

    def __post_init__(self) -> None:
        names = (*Status.__members__, RUNNING, UNREADABLE)
        if self.status is not None and self.status not in names:
            raise ValueError(f"`status` must be one of {', '.join(names)}, got {self.status[:64]!r}")
        if self.since is not None and not math.isfinite(self.since):
            raise ValueError(f"`since` must be seconds since 1970, got {self.since}")
        if self.after is not None and not (self.after.isascii() and self.after.isdigit() and len(self.after) < 19):
            raise ValueError(f"`after` must be the `next` of a list of runs, got {self.after[:64]!r}")


class RunSummary(Reply):
    """One line of the list of runs.

    Attributes:
        run_id: Its name.
        status: Name of its final status, RUNNING until then; UNREADABLE if its file is damaged.
        robot: Name of the robot; "urdf" if it was sent. UNREADABLE, as the scene, if the request is damaged.
        scene: Name of the scene.
        began: Begin [s since 1970].
        ended: End [s since 1970]; null until then.
        message: The status in a sentence.
        bytes: Size of request, reply, recording and proof.
        recording: "rendered"; "owed" until it is rendered from the run's log, at the latest when it is read; "lost" if
            the log is damaged; "none" if there is none.
    """

    run_id: str
    status: str
    robot: str
    scene: str
    began: float
    ended: float | None = None
    message: str = ""
    bytes: int = 0
    recording: Literal["none", "owed", "rendered", "lost"] = "none"


class RunsReply(Reply):
    """The stored runs, newest first.

    Attributes:
        runs: A page of the list.
        total: The number of runs on all pages.
        next: The `after` of the next page; null: this is the last.
    """

    runs: list[RunSummary]
    total: int = 0
    next: str | None = None
    schema: int = 1


class ReadRun(Message, tag_field="type", tag="run"):
    """Read one run: its request, and its reply once there is one."""

    run_id: RunId


class ErrorReply(Reply):
    """An error as it travels, in ``reply_err``; the fields are those of `Outcome`."""

    code: int
    name: str
    message: str
    details: dict[str, Any] = {}


class RunReply(Reply):
    """One run.

    Attributes:
        run_id: Its name.
        began: Begin [s since 1970].
        request: The request.
        reply: The reply, once there is one.
        error: The error that ended it instead.
    """

    run_id: str
    began: float
    request: PlanRequest
    reply: PlanReply | None = None
    error: ErrorReply | None = None
    schema: int = 1


class CertifyRunReply(Reply):
    """One run of a certify request; its fields are those of `RunReply`."""

    run_id: str
    began: float
    request: CertifyRequest
    reply: CertifyReply | None = None
    error: ErrorReply | None = None
    schema: int = 1


class DeleteRun(Message, tag_field="type", tag="delete_run"):
    """Forget one run with its recording and proof."""

    run_id: RunId


StoredRequest = (
    ReadRobots
    | ReadRobot
    | StoreRobot
    | DeleteRobot
    | ReadScenes
    | ReadScene
    | StoreScene
    | ChangeScene
    | DeleteScene
    | ReadRuns
    | ReadRun
    | DeleteRun
)
AnyRunReply = RunReply | CertifyRunReply
StoredReply = RobotReply | RobotsReply | ScenesReply | SceneReply | RunsReply | AnyRunReply | Done
