"""Requests about stored robots, scenes and runs, and about the service itself."""

from __future__ import annotations

import math
from typing import Annotated

import msgspec

from guidefield.errors import Status
from guidefield.messages.conditions import RobotReference
from guidefield.messages.scene import Scene
from guidefield.messages.scene_changes import SceneDiff, Version
from guidefield.messages.values import Message, Name, RootJoint, RunId, UrdfCharacters

RUNNING = "RUNNING"
"""The status of a run that has not ended."""
UNREADABLE = "UNREADABLE"
"""The status of a run with a damaged reply; and its robot and scene if the request is damaged."""


class ReadRobots(Message, tag_field="type", tag="robots"):
    """List the robots that can be planned for."""


class ReadRobot(Message, tag_field="type", tag="robot"):
    """Describe one robot: joints, limits and their sources, frames, groups, collision pairs."""

    robot: RobotReference


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


class ReadScene(Message, tag_field="type", tag="scene"):
    """Read a stored scene: a version of it, or the newest."""

    name: Name
    version: Version | None = None


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


class ReadInfo(Message, tag_field="type", tag="info"):
    """Versions, the JSON Schema of every message, counters."""


LARGEST_PAGE = 1_000
"""The largest number of runs in a list."""


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


class ReadRun(Message, tag_field="type", tag="run"):
    """Read one run: its request, and its reply once there is one."""

    run_id: RunId


class DeleteRun(Message, tag_field="type", tag="delete_run"):
    """Forget one run with its recording and proof."""

    run_id: RunId


RunRequest = ReadRuns | ReadRun | DeleteRun
RobotRequest = ReadRobots | ReadRobot | StoreRobot | DeleteRobot
SceneRequest = ReadScenes | ReadScene | StoreScene | ChangeScene | DeleteScene
StoreRequest = RobotRequest | SceneRequest | ReadInfo | RunRequest
