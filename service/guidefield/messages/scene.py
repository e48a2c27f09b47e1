"""Obstacles, guide planes and scenes: one schema for the wire and for stored files; `MOST_...` are refused beyond."""

from __future__ import annotations

import importlib
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from guidefield.messages.triples import Points, Triangles, check_points, check_triangles
from guidefield.messages.values import (
    IDENTITY,
    LARGEST,
    ORIGIN,
    Message,
    Name,
    NonNegative,
    Placement,
    Positive,
    QuaternionXYZW,
    Vector3,
    require_finite,
    require_finite_number,
    require_unit_quaternion,
)

MOST_OBSTACLES = 100_000
"""The largest number of obstacles of a scene."""
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
    """A sphere of `radius` [m] about `position` [m, world]."""

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
