"""Obstacles, guide planes and scenes: one schema for the wire and for stored files, with the largest counts of each.

Points and triangles are checked fast by the standard library, which the light client has. Names, defaults and meanings
of fields are the wire and users' files. Docstrings of messages, and the largest numbers here, are in docs/wire.md and
the schemas: after a change, `tools/wire_page`.
"""

from __future__ import annotations

import importlib
import math
import struct
import sys
from array import array
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
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
"""The largest number of vertices, triangles or points of an obstacle; docs/scenes.md tells it, too."""

Triangles = Annotated[list[Triangle], msgspec.Meta(min_length=1, max_length=MAX_VERTICES)] | Uint32Array

VALUES_PER_CHECK = 20_000
"""Points, triangles or numbers checked by one call, which holds the interpreter for a few milliseconds."""


def check_points(field: str, points: Points) -> int:
    """Check points, and return their number; raises ValueError if there are too many or none, or one isn't finite."""
    if isinstance(points, Float32Array):
        count = len(points.float32) // 12
        if points.float32[3::4].translate(None, _SMALL):
            _require_packed_finite(field, points.float32)
    else:
        count = len(points)
        for begin in range(0, count, VALUES_PER_CHECK):
            some = points[begin : begin + VALUES_PER_CHECK]
            if not math.hypot(*chain.from_iterable(some)) <= LARGEST:  # the norm of all is at least that of each
                for index, point in enumerate(some, begin):
                    require_finite(f"{field}[{index}]", point)
    if not 1 <= count <= MAX_VERTICES:
        raise ValueError(f"`{field}` must have 1 to {MAX_VERTICES} points, got {count}")
    return count


def _require_packed_finite(field: str, packed: bytes) -> None:
    """Raise ValueError for the first packed float32 that is NaN, infinite or too large."""
    for index, (value,) in enumerate(struct.iter_unpack("<f", packed)):
        if not -LARGEST <= value <= LARGEST:
            require_finite(f"{field}[{index // 3}]", (value,), index % 3)


def check_triangles(count: int, triangles: Triangles) -> None:
    """Check that triangles index existing vertices.

    Raises:
        ValueError: if an index is out of range, or packed triangles are too many or none.
    """
    if not isinstance(triangles, Uint32Array):
        for begin in range(0, len(triangles), VALUES_PER_CHECK):
            some = triangles[begin : begin + VALUES_PER_CHECK]
            if not _are_below(count, _pack_triangles(some)):  # a sixth of the time of `_require_below`
                _require_below(count, begin, some)
        return
    packed = triangles.uint32
    if not 1 <= len(packed) // 12 <= MAX_VERTICES:
        raise ValueError(f"`triangles` must have 1 to {MAX_VERTICES} triangles, got {len(packed) // 12}")
    if not _are_below(count, packed):
        flat = memoryview(packed).cast("I")
        _require_below(count, 0, zip(flat[0::3], flat[1::3], flat[2::3], strict=True))


def _require_below(count: int, first: int, triangles: Iterable[Iterable[int]]) -> None:
    for row, triangle in enumerate(triangles, first):
        for index in triangle:
            if not 0 <= index < count:
                raise ValueError(
                    f"`triangles[{row}]` names vertex {index}, but there are {count} vertices (0 to {count - 1})"
                )


_SMALL = bytes(sign | exponent for sign in (0, 0x80) for exponent in range(0x4E))
"""Highest bytes (sign and most of the exponent) of the float32 below 2^29 in magnitude; `LARGEST` is no less."""


_POSITIVE = bytes(range(0x80))
"""Highest bytes of the uint32 below 2^31."""


def _pack_triangles(triangles: Iterable[Iterable[int]]) -> bytes:
    """Pack indices of triangles as little-endian uint32; empty if one doesn't fit."""
    try:
        packed = array("I", chain.from_iterable(triangles))
    except (OverflowError, TypeError):
        return b""
    if sys.byteorder == "big":
        packed.byteswap()
    return packed.tobytes()


_BLOCK_BYTES = 2**16
"""Bytes compared as one long integer, which fits into the processor's cache; a multiple of 4."""


def _are_below(count: int, packed: bytes) -> bool:
    """Return whether there are little-endian uint32, and all of them are below a count of at most 2^31."""
    some = (packed[begin : begin + _BLOCK_BYTES] for begin in range(0, len(packed), _BLOCK_BYTES))
    addend = int.from_bytes((2**31 - count).to_bytes(4, "little") * (min(_BLOCK_BYTES, len(packed)) // 4), "little")
    return bool(packed) and all(_is_block_below(addend, each) for each in some)


def _is_block_below(addend: int, packed: bytes) -> bool:
    """Compare a block as one integer: with 2^31 - count added to each, the highest bit of those not below is set."""
    if packed[3::4].translate(None, _POSITIVE):
        return False
    moved = int.from_bytes(packed, "little") + (addend & ((1 << (8 * len(packed))) - 1))
    return not moved.to_bytes(len(packed), "little")[3::4].translate(None, _POSITIVE)


MOST_OBSTACLES = 100_000
"""The largest number of obstacles of a scene; docs/scenes.md tells it, too."""
MOST_PLANES = 1_000
"""The largest number of guide planes of a scene, or of a request."""
LONGEST_TRAJECTORY = 100_000
"""The largest number of placements of a moving obstacle."""

Times = Annotated[list[float], msgspec.Meta(min_length=1, max_length=LONGEST_TRAJECTORY)]


class ObstacleTrajectory(Message):
    """The motion of an obstacle: placements of its frame in the world at times [s]; at rest before them and after."""

    times: Times
    placements: list[Placement]

    def __post_init__(self) -> None:
        require_finite("times", self.times)
        if len(self.times) != len(self.placements):
            raise ValueError(f"`placements` must be as many as `times` ({len(self.times)}), got {len(self.placements)}")
        if any(later <= earlier for earlier, later in zip(self.times, self.times[1:], strict=False)):
            raise ValueError("`times` must increase strictly")


class _Obstacle(Message, tag_field="type"):
    """Fields of every obstacle.

    Attributes:
        name: Its unique name in replies and `allowed_collisions`.
        charge: Of its surface, per area [1].
        trajectory: Its motion; null: it rests.
    """

    name: Name
    charge: NonNegative = 1.0
    trajectory: ObstacleTrajectory | None = None

    def __post_init__(self) -> None:
        require_finite_number("charge", self.charge)


class Placed(_Obstacle, kw_only=True):
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


class Box(Placed, tag="box", kw_only=True):
    """A box; `size` is its full extents along its own axes [m], the placement of its middle in the world."""

    size: tuple[Positive, Positive, Positive]

    def __post_init__(self) -> None:
        if math.hypot(self.charge, *self.position, *self.size) <= LARGEST:  # as is each of them: scenes have thousands
            require_unit_quaternion("quaternion_xyzw", self.quaternion_xyzw)
            return
        super().__post_init__()
        require_finite("size", self.size)


class Sphere(_Obstacle, tag="sphere", kw_only=True):
    """A sphere of `radius` [m] about `position` [m, world]."""

    radius: Positive
    position: Vector3 = ORIGIN

    def __post_init__(self) -> None:
        super().__post_init__()
        require_finite("position", self.position)
        require_finite_number("radius", self.radius)


class Cylinder(Placed, tag="cylinder", kw_only=True):
    """A cylinder of `radius` [m] with flat ends along its own z; `length` from end to end [m]."""

    radius: Positive
    length: Positive

    def __post_init__(self) -> None:
        super().__post_init__()
        require_finite_number("radius", self.radius)
        require_finite_number("length", self.length)


class Capsule(Placed, tag="capsule", kw_only=True):
    """A capsule of `radius` [m] along its own z; `length` is that of the straight part, without the caps [m]."""

    radius: Positive
    length: Positive

    def __post_init__(self) -> None:
        super().__post_init__()
        require_finite_number("radius", self.radius)
        require_finite_number("length", self.length)


class Mesh(Placed, tag="mesh", kw_only=True):
    """A triangle mesh in its own frame [m]; triangles counter-clockwise from outside. Closed, it is solid.

    Cracks between corners at most 1 mm apart are closed; an open mesh is a thin wall without an inside. A warning in
    the reply says either.
    """

    vertices: Points
    triangles: Triangles

    def __post_init__(self) -> None:
        super().__post_init__()
        check_triangles(check_points("vertices", self.vertices), self.triangles)


class Polygon(_Obstacle, tag="polygon", kw_only=True):
    """A flat, simple polygon [m, world]: a thin wall, charged once; it has no inside."""

    vertices: Annotated[list[Vector3], msgspec.Meta(max_length=10_000)]

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.vertices) < 3:
            raise ValueError(f"`vertices` must have at least 3 corners, got {len(self.vertices)}")
        check_points("vertices", self.vertices)


class HalfSpace(_Obstacle, tag="half_space", kw_only=True):
    """The half-space ``normal . x <= offset`` [m, world]; the normal, of any length but 0, points to the free side."""

    normal: Vector3
    offset: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_finite("normal", self.normal)
        require_finite_number("offset", self.offset)
        if sum(x * x for x in self.normal) < 1e-12:
            raise ValueError("`normal` must not be zero")


class PointCloud(_Obstacle, tag="point_cloud", kw_only=True):
    """Points [m, world], as spheres of `radius` [m]."""

    points: Points
    radius: Positive

    def __post_init__(self) -> None:
        super().__post_init__()
        check_points("points", self.points)
        require_finite_number("radius", self.radius)


Obstacle = Box | Sphere | Cylinder | Capsule | Mesh | Polygon | HalfSpace | PointCloud


class GuidePlane(Message):
    """A convex, planar polygon in free space that the tip has to reach [m, world]."""

    name: Name
    vertices: Annotated[list[Vector3], msgspec.Meta(max_length=1_000)]

    def __post_init__(self) -> None:
        if len(self.vertices) < 3:
            raise ValueError(f"`vertices` of a guide plane must have at least 3 corners, got {len(self.vertices)}")
        check_points("vertices", self.vertices)


GuidePlanes = Annotated[list[GuidePlane], msgspec.Meta(max_length=MOST_PLANES)]


class Scene(Message, weakref=True, dict=True):  # its dict holds FrozenFacts, and isn't encoded or copied
    """A named set of obstacles, and guide planes that lead through them."""

    name: Name
    schema: Literal[1] = 1
    frame: Literal["world"] = "world"
    obstacles: Annotated[list[Obstacle], msgspec.Meta(max_length=MOST_OBSTACLES)] = []
    guide_planes: GuidePlanes = []

    def __post_init__(self) -> None:
        _require_distinct("obstacles", [obstacle.name for obstacle in self.obstacles])
        _require_distinct("guide_planes", [plane.name for plane in self.guide_planes])

    @classmethod
    def read(
        cls,
        path: str | Path,
        *,
        name: str | None = None,
        scale: float = 1.0,
        up: Literal["x", "y", "z"] | None = None,
        radius: float | None = None,
        prefix: str = "",
        package_dirs: Sequence[str | Path] = (),
        xacro_args: Mapping[str, str | bool | float] | None = None,
        without: Collection[str] = (),
    ) -> Scene:
        """Read a scene from a file: a scene in JSON, a mesh, a cloud, MoveIt's `.scene`, URDF, xacro, SDF or MJCF.

        Each obstacle has the name that it has in the file; where several have the same, numbers follow it: `leg/0`.
        What is odd but harmless is a warning of Python's. The light client can't read any.

        Args:
            path: The file; its suffix says of which kind it is.
            name: Of the scene; None: the file's name.
            scale: Factor of all its lengths: 0.001 where they are in millimetres.
            up: The axis that is up in it; None: the one that its kind or itself says, else z.
            radius: Of the balls about the points of a cloud [m].
            prefix: Begins the name of each obstacle, where one would be called as a link of the robot that plans.
            package_dirs: Folders in which packages and models are, besides those about the file.
            xacro_args: Arguments of a xacro file by name.
            without: Names of obstacles, objects, models or links that are left out with all that hangs below them.

        Raises:
            SceneInvalid: if the file can't be read, or a part of it can't be judged; names the file and the part.

        Examples:
            >>> import numpy as np
            >>> np.savez("/tmp/scan.npz", points=np.zeros((1, 3)))
            >>> Scene.read("/tmp/scan.npz", radius=0.01).obstacles[0].name
            'scan'
        """
        try:  # by name: it is in a room above this one, which the light client hasn't
            reading = importlib.import_module("guidefield.scene_files.reading")
        except ModuleNotFoundError:
            raise ImportError(
                "Scene.read isn't in guidefield-client, which only asks: pip install guidefield"
            ) from None
        scene: Scene = reading.read_scene(
            path,
            name=name,
            scale=scale,
            up=up,
            radius=radius,
            prefix=prefix,
            package_dirs=package_dirs,
            xacro_args=xacro_args,
            without=without,
        )
        return scene


def _require_distinct(field: str, names: list[str]) -> None:
    seen: dict[str, int] = {}
    for index, name in enumerate(names):
        if name in seen:
            raise ValueError(f"`{field}[{index}].name` {name!r} is already the name of `{field}[{seen[name]}]`")
        seen[name] = index
