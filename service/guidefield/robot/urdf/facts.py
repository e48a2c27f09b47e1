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
    """One joint as written."""

    name: str
    kind: str  # its type, a key of `JOINT_DOF`
    parent: str
    child: str
    line: int  # where it stands in the text
    # its `<limit>` [rad or m], 0 where an entry is left out; None without `<limit>`, and for types that have no range
    lower: float | None
    upper: float | None
    velocity: float | None  # the same [rad/s or m/s; N m or N], 0 where they are negative or left out
    effort: float | None
    # normal of the plane of a planar joint, of any length; None for other types
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
    """A URDF that has been checked."""

    name: str
    root: str  # the link that has no parent
    links: tuple[str, ...]  # link names in the order of the text
    joints: Mapping[str, JointFacts]  # joints by name, in the order of the text
    collisions: Mapping[str, tuple[CollisionFacts, ...]]  # collision shapes by link; links without any are left out
    # followers: name to (name of the joint followed, multiplier, offset). A joint that is followed may itself follow
    # another; there are no cycles
    mimics: Mapping[str, tuple[str, float, float]]
    warnings: tuple[str, ...]  # what is odd but harmless
    meshes: Mapping[str, str]  # the URI of each mesh file, by the path that stands in `text` now
    # the URDF as checked, for the parsers that come next: without comments, numbers separated by single spaces, mesh
    # files as absolute paths, and without those `<visual>` whose mesh can't be read
    text: str
