"""References of a request to its robot and scene: by name, or sent with it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from guidefield.messages.scene import Scene
from guidefield.messages.scene_changes import RequestScene
from guidefield.messages.values import Message, RootJoint, UrdfCharacters


class UrdfText(Message, tag_field="type", tag="urdf"):
    """A robot sent as text.

    Attributes:
        text: Its URDF; meshes must come from packages that the service allows.
        srdf: Its SRDF.
        root_joint: Joint between the world and its root link.
    """

    text: UrdfCharacters
    srdf: UrdfCharacters | None = None
    root_joint: RootJoint = "fixed"


class UrdfFile(Message, tag_field="type", tag="urdf_file"):
    """A robot in local files; only in Python and on the command line, refused from the wire.

    Attributes:
        path: Its URDF, a file that ends in `.xacro`, or an MJCF.
        srdf_path: Its SRDF.
        package_dirs: Folders that hold the packages of its meshes.
        root_joint: Joint between the world and its root link.
        xacro_args: Arguments of a `.xacro` file by name.
    """

    path: str
    srdf_path: str | None = None
    package_dirs: list[str] = []
    root_joint: RootJoint = "fixed"
    xacro_args: dict[str, str | bool | int | float] = {}


ROBOT_DESCRIPTIONS = "robot_descriptions:"
"""Prefix of robots of the package robot_descriptions; only in Python and on the command line."""

RobotReference = str | UrdfText | UrdfFile
if TYPE_CHECKING:
    SceneReference = str | Scene
else:  # the decoder makes a RequestScene of both forms, and `settle_scene` a plain one if it is whole
    SceneReference = str | RequestScene


def settle_scene(request: msgspec.Struct) -> None:
    """Replace a RequestScene without a base by the plain scene, while its request is constructed."""
    scene = getattr(request, "scene", None)
    if isinstance(scene, RequestScene) and scene.base is None:
        msgspec.structs.force_setattr(request, "scene", scene.declared)
