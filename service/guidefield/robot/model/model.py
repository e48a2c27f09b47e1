"""The robot as a value: Pinocchio's model, the collision geometry that is judged, limits and where they come from."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from guidefield.errors import RobotInvalid, UnknownFrame
from guidefield.kernels.kinematics.forward_kinematics import JointTable
from guidefield.robot.model.frames import frame_index, joint_table
from guidefield.robot.model.spaces import RobotConfiguration

ROOT_JOINT = "root_joint"  # name of the joint by which a robot moves in the world, unless its root is fixed

NO_GEOMETRY = "has no collision geometry, so nothing can be said about collisions"
"""The fault of a robot that can be asked for kinematics alone."""


class JointKind(enum.StrEnum):
    """What a joint can do; URDF's words, and `spherical` for a ball joint."""

    REVOLUTE = "revolute"
    CONTINUOUS = "continuous"
    PRISMATIC = "prismatic"
    PLANAR = "planar"
    SPHERICAL = "spherical"
    FLOATING = "floating"


class LimitSource(enum.StrEnum):
    """Who said so."""

    REQUEST = "request"
    CARD = "card"
    URDF = "urdf"
    DEFAULT = "default"


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another, which follows none: value = multiplier * driver's unwrapped value + offset."""

    driver: str
    multiplier: float
    offset: float


@dataclass(frozen=True, eq=False)
class Joint:
    """One movable joint."""

    name: str
    kind: JointKind
    index: int  # pinocchio's joint index
    idx_q: int  # where its values stand in a configuration, and how many they are
    nq: int
    idx_v: int  # the same in the tangent space
    nv: int
    # limits, shape (nv,) [rad or m]; infinite where there are none. A revolute joint without limits is one that turns
    # on and on, but isn't the same after a whole turn, for others follow it
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray  # largest magnitudes, shape (nv,) [rad or m, per s and s^2]
    acceleration: np.ndarray
    velocity_source: LimitSource  # where those come from
    acceleration_source: LimitSource
    mimic: Mimic | None = None  # the joint that it follows, if it does; then it can't be planned for
    # whether the SRDF says that nothing drives it; it is planned for only where a request names it
    passive: bool = False
    velocity_owner: str | None = None  # the mimic joint whose limit those are, where it binds this joint
    acceleration_owner: str | None = None

    @property
    def is_driven(self) -> bool:
        """Whether it is planned for where a request doesn't name it."""
        return self.mimic is None and not self.passive

    @cached_property
    def limits(self) -> tuple[float, float] | None:
        """Lower and upper limit [rad or m] of a joint whose configuration is its one value; None of another."""
        if self.kind not in (JointKind.REVOLUTE, JointKind.PRISMATIC):
            return None
        return float(self.lower[0]), float(self.upper[0])


@dataclass(frozen=True)
class PairLeftOut:
    """Two links that are never tested against each other, and why."""

    links: tuple[str, str]
    reason: str


@dataclass(frozen=True)
class GeometryChoice:
    """How a collision shape is judged."""

    name: str  # `<link>_<number>`
    link: str
    shape: str  # the URDF's: box, cylinder, sphere, mesh
    judged_as: str  # primitive, convex hull or triangle mesh
    stand_off: float = 0.0  # how far the hull stands off the mesh [m]; 0 for a primitive


@dataclass(frozen=True)
class RobotSource:
    """Where a robot came from."""

    urdf_text: str  # its text; once loaded, with meshes as absolute paths. Of an MJCF, the URDF that was made from it
    urdf_path: Path | None
    root_joint: str = "fixed"
    files: tuple[Path, ...] = ()  # files that the text was made from, beside those that it names


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A robot, frozen after loading."""

    name: str  # its name in the catalog, or the URDF's own
    model: Any  # pinocchio model of every joint (mimic joints are joints of their own here)
    geometry: Any  # collision geometry with the pairs of links that count
    joints: tuple[Joint, ...]  # movable joints, and link names, in Pinocchio's order
    links: tuple[str, ...]
    tip: str  # frame that goals and guide planes are about, unless a request says otherwise
    groups: Mapping[str, tuple[str, ...]]  # named sets of joints, from the SRDF
    rest: RobotConfiguration  # configuration, shape (model.nq,), of joints that a request leaves out
    geometry_choices: tuple[GeometryChoice, ...]  # how each shape is judged, in the geometry's order
    pairs_left_out: tuple[PairLeftOut, ...]
    warnings: tuple[str, ...]  # what was odd but harmless, for every reply about it
    source: RobotSource
    # the same about a robot that comes with guidefield, told where it is described: its users can't mend it
    remarks: tuple[str, ...] = ()
    rest_state: str | None = None  # name of the SRDF's state that it is, as far as that goes
    held: tuple[str, ...] = ()  # names of the links that are objects it holds
    # of its reach over a usual one, 1 where that is usual: lengths that are chosen for it are that many times as large
    # (`size`)
    size: float = 1.0

    def joint(self, name: str) -> Joint | None:
        """The movable joint of that name, or None."""
        return self._joints_by_name.get(name)

    @cached_property
    def _joints_by_name(self) -> dict[str, Joint]:
        return {joint.name: joint for joint in reversed(self.joints)}

    def require_collision_geometry(self) -> None:
        """Refuse, by RobotInvalid, to speak about collisions of a robot without collision geometry."""
        if not self.geometry_choices:
            raise RobotInvalid(f"robot {self.name!r} {NO_GEOMETRY}", robot=self.name)

    def link_of_geometry(self, index: int) -> str:
        """Name of the link that a collision shape belongs to."""
        return self.geometry_choices[index].link

    def frame_id(self, name: str) -> int:
        """Return Pinocchio's index of a frame; UnknownFrame, with those there are, if there is none of that name."""
        index = self._frame_ids.get(name)
        if index is None:
            index = frame_index(self.model, name)
        if index is None:
            frames = [frame.name for frame in self.model.frames][1:]
            raise UnknownFrame(
                f"robot {self.name!r} has no frame {name!r}; it has {', '.join(frames)}", frame=name, available=frames
            )
        self._frame_ids[name] = index
        return index

    @cached_property
    def joint_table(self) -> JointTable:
        """The joints as kernels read them."""
        return joint_table(self.model)

    @cached_property
    def _frame_ids(self) -> dict[str, int]:
        """Indices of frames that were asked for: Pinocchio looks through all of them."""
        return {}
