"""Obstacles, guide planes and scenes as declared data: one schema for the wire and the files."""

from __future__ import annotations

import functools
import math
import sys
from array import array
from collections.abc import Iterable
from itertools import chain
from typing import Annotated, Literal

import msgspec

from guidefield.messages.values import (
    IDENTITY,
    LARGEST,
    ORIGIN,
    Float32Array,
    Message,
    Name,
    NonNegative,
    Placement,
    Positive,
    QuaternionXYZW,
    Uint32Array,
    Vector3,
    require_finite,
    require_finite_number,
    require_unit_quaternion,
)

Points = list[Vector3] | Float32Array
Triangle = tuple[int, int, int]

MAX_VERTICES = 1_000_000
"""Most vertices, triangles or points that one obstacle may have."""

Triangles = Annotated[list[Triangle], msgspec.Meta(min_length=1, max_length=MAX_VERTICES)] | Uint32Array


class ObstacleTrajectory(Message):
    """Where a moving obstacle is: placements of its frame in the world at times [s]; at rest before them and after."""

    times: Annotated[list[float], msgspec.Meta(min_length=1, max_length=100_000)]
    placements: list[Placement]

    def __post_init__(self) -> None:
        require_finite("times", self.times)
        if len(self.times) != len(self.placements):
            raise ValueError(f"`placements` must be as many as `times` ({len(self.times)}), got {len(self.placements)}")
        if any(later <= earlier for earlier, later in zip(self.times, self.times[1:], strict=False)):
            raise ValueError("`times` must increase strictly")


class _Obstacle(Message, tag_field="type"):
    """What every obstacle has.

    Attributes:
        name: Its own, by which replies and `allowed_collisions` know it.
        charge: Of its surface, per area [1].
        trajectory: How it moves; null: it rests.
    """

    name: Name
    charge: NonNegative = 1.0
    trajectory: ObstacleTrajectory | None = None

    def __post_init__(self) -> None:
        require_finite_number("charge", self.charge)


class _Placed(_Obstacle, kw_only=True):
    """An obstacle with a placement of its own frame in the world.

    Attributes:
        position: Of its frame's origin [m, world].
        quaternion_xyzw: Its frame's rotation in the world.
    """

    position: Vector3 = ORIGIN
    quaternion_xyzw: QuaternionXYZW = IDENTITY

    def __post_init__(self) -> None:
        super().__post_init__()
        require_finite("position", self.position)
        require_unit_quaternion("quaternion_xyzw", self.quaternion_xyzw)


class Box(_Placed, tag="box", kw_only=True):
    """A box; `size` is its full extents along its own axes [m], the placement of its middle in the world."""

    size: tuple[Positive, Positive, Positive]

    def __post_init__(self) -> None:
        if math.hypot(self.charge, *self.position, *self.size) <= LARGEST:  # as is each of them: scenes have thousands
            require_unit_quaternion("quaternion_xyzw", self.quaternion_xyzw)
            return
        super().__post_init__()
        require_finite("size", self.size)


class Sphere(_Obstacle, tag="sphere", kw_only=True):
    """A ball of `radius` [m] about `position` [m, world]."""

    radius: Positive
    position: Vector3 = ORIGIN

    def __post_init__(self) -> None:
        super().__post_init__()
        require_finite("position", self.position)
        require_finite_number("radius", self.radius)


class Cylinder(_Placed, tag="cylinder", kw_only=True):
    """A cylinder of `radius` [m] with flat ends along its own z; `length` from end to end [m]."""

    radius: Positive
    length: Positive

    def __post_init__(self) -> None:
        super().__post_init__()
        require_finite_number("radius", self.radius)
        require_finite_number("length", self.length)


class Capsule(_Placed, tag="capsule", kw_only=True):
    """A capsule of `radius` [m] along its own z; `length` is that of the straight part, without the caps [m]."""

    radius: Positive
    length: Positive

    def __post_init__(self) -> None:
        super().__post_init__()
        require_finite_number("radius", self.radius)
        require_finite_number("length", self.length)


class Mesh(_Placed, tag="mesh", kw_only=True):
    """A triangle mesh in its own frame [m]; triangles counter-clockwise from outside. Closed, it is solid.

    Cracks between corners at most 1 mm apart are closed; an open mesh is a thin wall that something
    may be inside of. A warning in the reply says either.
    """

    vertices: Points
    triangles: Triangles

    def __post_init__(self) -> None:
        super().__post_init__()
        count = _check_points("vertices", self.vertices)
        triangles: Iterable[Iterable[int]]
        if isinstance(self.triangles, Uint32Array):
            packed = self.triangles.uint32
            if not 1 <= len(packed) // 12 <= MAX_VERTICES:
                raise ValueError(f"`triangles` must have 1 to {MAX_VERTICES} triangles, got {len(packed) // 12}")
            if _all_below(count, packed):
                return
            flat = memoryview(packed).cast("I")
            triangles = zip(flat[0::3], flat[1::3], flat[2::3], strict=True)
        else:
            triangles = self.triangles
            if _all_below(count, _packed(triangles)):  # of a million triangles this is found in a sixth of the time
                return
        for row, triangle in enumerate(triangles):
            for index in triangle:
                if not 0 <= index < count:
                    raise ValueError(
                        f"`triangles[{row}]` names vertex {index}, but there are {count} vertices (0 to {count - 1})"
                    )


class Polygon(_Obstacle, tag="polygon", kw_only=True):
    """A flat, simple polygon [m, world]: a thin wall, charged once; it has no inside."""

    vertices: Annotated[list[Vector3], msgspec.Meta(max_length=10_000)]

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.vertices) < 3:
            raise ValueError(f"`vertices` must have at least 3 corners, got {len(self.vertices)}")
        _check_points("vertices", self.vertices)


class HalfSpace(_Obstacle, tag="half_space", kw_only=True):
    """Everything with ``normal . x <= offset`` [m, world]; the normal, of any length but 0, points to the free side."""

    normal: Vector3
    offset: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_finite("normal", self.normal)
        require_finite_number("offset", self.offset)
        if sum(x * x for x in self.normal) < 1e-12:
            raise ValueError("`normal` must not be zero")


class PointCloud(_Obstacle, tag="point_cloud", kw_only=True):
    """Points [m, world] judged as spheres of `radius` [m]."""

    points: Points
    radius: Positive

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_points("points", self.points)
        require_finite_number("radius", self.radius)


Obstacle = Box | Sphere | Cylinder | Capsule | Mesh | Polygon | HalfSpace | PointCloud


class GuidePlane(Message):
    """A convex, planar polygon in free space that the tip has to reach [m, world]."""

    name: Name
    vertices: Annotated[list[Vector3], msgspec.Meta(max_length=1_000)]

    def __post_init__(self) -> None:
        if len(self.vertices) < 3:
            raise ValueError(f"`vertices` of a guide plane must have at least 3 corners, got {len(self.vertices)}")
        _check_points("vertices", self.vertices)


class Scene(Message, weakref=True, dict=True):  # its dict is for `own_scenes`: nothing of it travels or is copied
    """A named set of obstacles, and the guide planes that lead through them."""

    name: Name
    schema: Literal[1] = 1
    frame: Literal["world"] = "world"
    obstacles: Annotated[list[Obstacle], msgspec.Meta(max_length=100_000)] = []
    guide_planes: Annotated[list[GuidePlane], msgspec.Meta(max_length=1_000)] = []

    def __post_init__(self) -> None:
        _require_distinct("obstacles", [obstacle.name for obstacle in self.obstacles])
        _require_distinct("guide_planes", [plane.name for plane in self.guide_planes])


_SMALL = bytes(sign | exponent for sign in (0, 0x80) for exponent in range(0x4E))
"""Highest bytes (sign and most of the exponent) of the float32 below 2^29 in magnitude, which is within `LARGEST`."""


_POSITIVE = bytes(range(0x80))
"""Highest bytes of the uint32 below 2^31."""


def _packed(triangles: Iterable[Iterable[int]]) -> bytes:
    """Numbers of triangles as little-endian uint32; empty where one can't be."""
    try:
        packed = array("I", chain.from_iterable(triangles))
    except (OverflowError, TypeError):
        return b""
    if sys.byteorder == "big":
        packed.byteswap()
    return packed.tobytes()


_SOME = 2**16
"""So many bytes are looked at together: long integers of that length stay in the processor's cache."""


def _all_below(count: int, packed: bytes) -> bool:
    """Whether there are any, and all of some little-endian uint32 are below a count of at most 2^31."""
    some = (packed[begin : begin + _SOME] for begin in range(0, len(packed), _SOME))
    return bool(packed) and all(_some_below(count, each) for each in some)


def _some_below(count: int, packed: bytes) -> bool:
    """The same of some, all at once, as one long integer.

    With 2^31 - count added to each, the highest bit is set of those that aren't.
    """
    if packed[3::4].translate(None, _POSITIVE):
        return False
    moved = int.from_bytes(packed, "little") + _added(count, len(packed))
    return not moved.to_bytes(len(packed), "little")[3::4].translate(None, _POSITIVE)


@functools.lru_cache(maxsize=4)
def _added(count: int, size: int) -> int:
    """2^31 - count in each of the uint32 of so many bytes, as one long integer."""
    return int.from_bytes((2**31 - count).to_bytes(4, "little") * (size // 4), "little")


def _check_points(field: str, points: Points) -> int:
    """Number of points; ValueError where there are too many, none, or one isn't finite."""
    if isinstance(points, Float32Array):
        count = len(points.float32) // 12
        if points.float32[3::4].translate(None, _SMALL) and not all(
            abs(x) <= LARGEST for x in memoryview(points.float32).cast("f")
        ):
            raise ValueError(f"`{field}` must be finite numbers")
    else:
        count = len(points)
        if not math.hypot(*chain.from_iterable(points)) <= LARGEST:  # the norm of all is more than that of each
            for index, point in enumerate(points):
                require_finite(f"{field}[{index}]", point)
    if not 1 <= count <= MAX_VERTICES:
        raise ValueError(f"`{field}` must have 1 to {MAX_VERTICES} points, got {count}")
    return count


def _require_distinct(field: str, names: list[str]) -> None:
    seen: dict[str, int] = {}
    for index, name in enumerate(names):
        if name in seen:
            raise ValueError(f"`{field}[{index}].name` {name!r} is already the name of `{field}[{seen[name]}]`")
        seen[name] = index
