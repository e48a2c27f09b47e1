"""Bases of all messages, bounds of numbers (`LARGEST`), small values: vectors, placements, configurations, goals.

Fields, bounds, defaults are the wire. Docstrings of messages, `LARGEST`, `LONGEST_TIME`, `MAX_URDF_CHARACTERS` are in
docs/wire.md and the schemas: after a change, `tools/wire_page`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Annotated, Literal

import msgspec

Vector3 = tuple[float, float, float]
WorldPoint = Annotated[Vector3, msgspec.Meta(extra={"frame": "world"})]
"""A point in the world [m]: scene/anchor.py moves each field of this type, for robots far away."""
QuaternionXYZW = tuple[float, float, float, float]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=256)]
RunId = Annotated[str, msgspec.Meta(pattern=r"^[A-Za-z0-9_-]{1,64}$")]

PLANNING_TIME = 5.0
"""Default of the allowed time of a plan or certify request [s]."""
LONGEST_TIME = 3600.0
"""The largest allowed time of a request [s]."""
AllowedTime = Annotated[float, msgspec.Meta(gt=0.0, le=LONGEST_TIME)]

MAX_URDF_CHARACTERS = 4_000_000
UrdfCharacters = Annotated[str, msgspec.Meta(max_length=MAX_URDF_CHARACTERS)]
RootJoint = Literal["fixed", "planar", "free"]
"""The joint between the world and a robot's root link."""

ORIGIN: Vector3 = (0.0, 0.0, 0.0)
IDENTITY: QuaternionXYZW = (0.0, 0.0, 0.0, 1.0)
LARGEST = 1e9
"""Largest magnitude of a quantity, in SI units: squares and cubes of larger ones lose precision or overflow.

Not less than 2^29, below which `scene.py` lets packed points through; docs/stream.md tells it.
"""
SMALLEST_LIMIT = 1e-9
"""The smallest limit of a rate or a torque, in SI units: what is within a smaller one is rounding."""
Mass = Annotated[float, msgspec.Meta(ge=0.0, le=LARGEST)]
InertiaTensor = tuple[float, float, float, float, float, float]
"""Ixx, Ixy, Ixz, Iyy, Iyz, Izz [kg m^2]."""
NO_INERTIA: InertiaTensor = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
QUATERNION_TOLERANCE = 1e-6
"""Largest deviation of the norm of a quaternion from 1, in configurations, too: docs/certify.md promises it."""


class Message(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of all messages of clients: frozen, strict about fields. Fields are positional, too: new ones come last.

    Attributes:
        schema: Version of this message.
    """


class Reply(msgspec.Struct, frozen=True, kw_only=True):
    """Base of all messages of the service: clients ignore unknown fields.

    Attributes:
        schema: Version of this message.
    """


class Float32Array(Message):
    """Points packed: triples of little-endian float32 [m], as bytes in MessagePack, base64 text in JSON."""

    float32: bytes

    def __post_init__(self) -> None:
        if len(self.float32) % 12:
            raise ValueError(f"`float32` must hold whole triples (12 bytes each), got {len(self.float32)} bytes")


class Uint32Array(Message):
    """Triangles packed: triples of little-endian uint32 that number vertices, bytes in MessagePack, base64 in JSON."""

    uint32: bytes

    def __post_init__(self) -> None:
        if len(self.uint32) % 12:
            raise ValueError(f"`uint32` must hold whole triples (12 bytes each), got {len(self.uint32)} bytes")


class Placement(Message):
    """A rigid placement of a frame in the world, or in the frame that holds it.

    Attributes:
        position: Of its origin [m].
        quaternion_xyzw: Its rotation, a unit quaternion (x, y, z, w).
    """

    position: Vector3 = ORIGIN
    quaternion_xyzw: QuaternionXYZW = IDENTITY

    def __post_init__(self) -> None:
        if not math.hypot(*self.position) <= LARGEST:  # as is each of them
            require_finite("position", self.position)
        require_unit_quaternion("quaternion_xyzw", self.quaternion_xyzw)


def require_finite(field: str, values: Iterable[float], first: int = 0) -> None:
    """Raise ValueError if a number, the first of which has an index, is NaN, infinite or beyond `LARGEST`."""
    for index, value in enumerate(values, first):
        if not -LARGEST <= value <= LARGEST:
            require_finite_number(f"{field}[{index}]", value)


def require_finite_number(field: str, value: float) -> None:
    """Raise ValueError if a number is NaN, infinite or beyond `LARGEST`."""
    if not abs(value) <= LARGEST:
        wanted = f"within {LARGEST:g}" if math.isfinite(value) else "a finite number"
        raise ValueError(f"`{field}` must be {wanted}, got {value}")


def require_limit(field: str, value: float | None) -> None:
    """Raise ValueError if a limit is NaN, infinite, beyond `LARGEST` or below `SMALLEST_LIMIT`; None is none."""
    if value is None:
        return
    require_finite_number(field, value)
    if value < SMALLEST_LIMIT:
        raise ValueError(f"`{field}` must be at least {SMALLEST_LIMIT:g}, got {value}")


def require_load(mass: float | None, centre_of_mass: Vector3, inertia: InertiaTensor) -> None:
    """Raise ValueError if a number isn't finite, or an inertia has no mass: it would count for nothing."""
    require_finite("centre_of_mass", centre_of_mass)
    require_finite("inertia", inertia)
    if mass is None and inertia != NO_INERTIA:
        raise ValueError("`inertia` needs a `mass`")


def require_unit_quaternion(field: str, quaternion: QuaternionXYZW) -> None:
    """Raise ValueError unless the norm of a quaternion is 1 within `QUATERNION_TOLERANCE`."""
    if abs(math.hypot(*quaternion) - 1.0) <= QUATERNION_TOLERANCE:  # trajectories have a hundred thousand
        return
    require_finite(field, quaternion)
    norm = math.sqrt(sum(x * x for x in quaternion))
    if norm == 0.0:
        raise ValueError(f"`{field}` is zero, which is no rotation: no rotation at all is [0, 0, 0, 1]")
    if abs(norm - 1.0) > QUATERNION_TOLERANCE:
        raise ValueError(
            f"`{field}` must be a unit quaternion within {QUATERNION_TOLERANCE:g}, its norm is {norm:.9g}: divide it by"
            " its norm"
        )


MOST_GOALS = 10_000
"""The largest number of configurations of a `JointSetGoal`."""

JointValue = float | list[float]
Positions = dict[str, JointValue]
"""A configuration: joint name to value.

Revolute and prismatic joints: a number [rad or m]; continuous: an angle [rad] modulo whole turns; planar: [x, y,
theta]; spherical: a unit quaternion (x, y, z, w); floating: [x, y, z, qx, qy, qz, qw]. A planar or floating root is
`root_joint`. Mimic joints are left out: they are at multiplier * value + offset. If a whole turn of a continuous joint
moves one of its mimic joints elsewhere, the joint is listed as revolute, and its whole turns count.
"""

Tolerance3 = tuple[NonNegative | None, NonNegative | None, NonNegative | None]
"""Tolerances along or about three axes; None leaves an axis free."""


def require_finite_positions(field: str, positions: Positions) -> None:
    """Raise ValueError if a joint value is NaN or infinite; `field` names the configuration."""
    try:
        if math.hypot(*positions.values()) <= LARGEST:  # type: ignore[arg-type] # as is each: there may be thousands
            return
    except TypeError:  # a joint has several coordinates
        pass
    for joint, value in positions.items():
        if isinstance(value, list):
            require_finite(f"{field}.{joint}", value)
        else:
            require_finite_number(f"{field}.{joint}", value)


def require_finite_configurations(field: str, configurations: Sequence[Positions]) -> None:
    """Raise ValueError if a joint value of a configuration is NaN or infinite; `field` names their list."""
    for index, positions in enumerate(configurations):
        require_finite_positions(f"{field}[{index}]", positions)


class JointsGoal(Message, tag_field="type", tag="joints"):
    """Reach one configuration.

    Attributes:
        positions: The configuration; joints left out keep their value at the start.
    """

    positions: Positions

    def __post_init__(self) -> None:
        require_finite_positions("positions", self.positions)


class JointSetGoal(Message, tag_field="type", tag="joint_set"):
    """Reach any one of several configurations.

    Attributes:
        positions: The configurations, each as in `JointsGoal`.
    """

    positions: Annotated[list[Positions], msgspec.Meta(min_length=1, max_length=MOST_GOALS)]

    def __post_init__(self) -> None:
        require_finite_configurations("positions", self.positions)


class PoseGoal(Message, tag_field="type", tag="pose"):
    """Bring the tip to a pose.

    Attributes:
        position: Of the tip [m, world].
        quaternion_xyzw: Its rotation in the world.
        position_tolerance: Largest offset along each axis of the goal's own frame [m]; null leaves an axis free.
        orientation_tolerance: Largest components of the rotation vector in that frame [rad]; null leaves one free.
    """

    position: WorldPoint
    quaternion_xyzw: QuaternionXYZW
    position_tolerance: Tolerance3 = (1e-4, 1e-4, 1e-4)
    orientation_tolerance: Tolerance3 = (1e-3, 1e-3, 1e-3)

    def __post_init__(self) -> None:
        require_finite("position", self.position)
        require_unit_quaternion("quaternion_xyzw", self.quaternion_xyzw)
        require_finite("position_tolerance", (x for x in self.position_tolerance if x is not None))
        require_finite("orientation_tolerance", (x for x in self.orientation_tolerance if x is not None))


class GuidePlaneGoal(Message, tag_field="type", tag="guide_plane"):
    """Reach the last guide plane with the tip, at any point of it and in any orientation."""


Goal = JointsGoal | JointSetGoal | PoseGoal | GuidePlaneGoal
