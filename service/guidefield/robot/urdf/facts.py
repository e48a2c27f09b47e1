"""Facts about a URDF that has been checked: its links, joints and collision shapes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

JOINT_DOF = {"revolute": 1, "continuous": 1, "prismatic": 1, "fixed": 0, "floating": 6, "planar": 3}
"""Degrees of freedom of each type of joint that a URDF can have."""

SCALAR_JOINTS = ("revolute", "continuous", "prismatic")
"""Types of joints with one value, which can follow a joint and be followed."""


@dataclass(frozen=True)
class JointFacts:
    """One joint as written.

    Attributes:
        kind: Its type, a key of `JOINT_DOF`.
        line: Where it stands in the text.
        lower, upper: Its `<limit>` [rad or m], 0 where an entry is left out; None without `<limit>`, and for types that
            have no range.
        velocity, effort: The same [rad/s or m/s; N m or N], 0 where they are negative or left out.
        axis: Normal of the plane of a planar joint, of any length; None for other types.
    """

    name: str
    kind: str
    parent: str
    child: str
    line: int
    lower: float | None
    upper: float | None
    velocity: float | None
    effort: float | None
    axis: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class CollisionFacts:
    """One `<collision>` as written: the link it belongs to, its shape, its mesh file if it is one, and its line."""

    link: str
    shape: str
    mesh: Path | None
    line: int


@dataclass(frozen=True)
class UrdfFacts:
    """A URDF that has been checked.

    Attributes:
        root: The link that has no parent.
        links: Link names in the order of the text.
        joints: Joints by name, in the order of the text.
        collisions: Collision shapes by link; links without any are left out.
        mimics: Followers: name to (name of the joint followed, multiplier, offset). A joint that is followed may itself
            follow another; there are no cycles.
        warnings: What is odd but harmless.
        meshes: The URI of each mesh file, by the path that stands in `text` now.
        text: The URDF as checked, for the parsers that come next: without comments, numbers separated by single
            spaces, mesh files as absolute paths, and without those `<visual>` whose mesh can't be read.
    """

    name: str
    root: str
    links: tuple[str, ...]
    joints: Mapping[str, JointFacts]
    collisions: Mapping[str, tuple[CollisionFacts, ...]]
    mimics: Mapping[str, tuple[str, float, float]]
    warnings: tuple[str, ...]
    meshes: Mapping[str, str]
    text: str
