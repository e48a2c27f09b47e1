"""A robot that a client stored under a name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from guidefield.messages.values import RootJoint


@dataclass(frozen=True)
class SentRobot:
    """A robot as it was sent, its mesh files on disk.

    Attributes:
        name: What the client calls it.
        content: Hash of all that was sent; the same content is the same robot.
        urdf, srdf: Its texts.
        meshes: Files by the URIs that the URDF has for them.
        root_joint: How it stands in the world.
    """

    name: str
    content: str
    urdf: str
    srdf: str | None
    meshes: Mapping[str, Path]
    root_joint: RootJoint
