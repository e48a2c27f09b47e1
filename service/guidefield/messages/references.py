"""The robot and the scene of a request: named, or sent with it."""

from __future__ import annotations

from guidefield.messages.scene import Scene
from guidefield.messages.values import Message, RootJoint, UrdfCharacters


class UrdfText(Message, tag_field="type", tag="urdf"):
    """A robot sent as text.

    Attributes:
        text: Its URDF; meshes must come from packages that the service allows.
        srdf: Its SRDF.
        root_joint: How its root link moves in the world.
    """

    text: UrdfCharacters
    srdf: UrdfCharacters | None = None
    root_joint: RootJoint = "fixed"


class UrdfFile(Message, tag_field="type", tag="urdf_file"):
    """A robot in local files: in Python and on the command line only, refused from the wire.

    Attributes:
        path: Its URDF.
        srdf_path: Its SRDF.
        package_dirs: Folders that hold the packages of its meshes.
        root_joint: How its root link moves in the world.
    """

    path: str
    srdf_path: str | None = None
    package_dirs: list[str] = []
    root_joint: RootJoint = "fixed"


RobotReference = str | UrdfText | UrdfFile
SceneReference = str | Scene
