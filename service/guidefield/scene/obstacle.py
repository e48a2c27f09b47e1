"""One obstacle: its message turned into a Coal shape, a triangulation, and its share of the field's charges.

Its parts are made on demand by a `Recipe`, and must all mean one shape; a primitive's row for kernels is made at once
(`primitive.PLACED`, for kernels/collide, distance_tables.py). A further kind of obstacle needs an entry in `BUILDERS`
(or `PRIMITIVES`, if its row is known there, its Coal shape in collision), and one of the referee's. If it isn't
`messages.Placed`, obstacle_message.py, anchor.py and prove/tables.py move it; the first hashes what may be very many.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.errors import SceneInvalid
from guidefield.geometry import surfaces
from guidefield.geometry.cache import is_large
from guidefield.geometry.charged import pair_faces
from guidefield.geometry.distance_bodies import NO_TRIANGLES, Triangulated
from guidefield.geometry.mesh_surface import SolidBox, find_boxes
from guidefield.geometry.surfaces import se3, transform_points, unit
from guidefield.kernels.collide.primitive import BOX, CAPSULE, CYLINDER, HALF_SPACE, PLACED
from guidefield.memory import BYTES_PER_FACE, OBSTACLES, BoundedMap
from guidefield.messages import scene as messages
from guidefield.scene.cloud import Cloud, cloud_charges, cloud_specks, cloud_surface
from guidefield.scene.guide_plane import Sheet, axes_across, build_sheets
from guidefield.scene.obstacle_message import Content, ObstacleMotion, content_of, points_in, put_at
from guidefield.scene.obstacle_parts import (
    Charges,
    CroppedSurface,
    Facets,
    JudgedMesh,
    Recipe,
    extent_of,
    judge_mesh,
    solids_of,
)

HALF_SPACE_PATCH = 4.0  # side of the square that represents a half-space in drawings [m]

_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def _bounded_body(shape: Any) -> Any:
    shape.computeLocalAABB()
    return shape


def _box(message: messages.Box) -> bytes:
    x, y, z = message.size
    turned = unit(message.quaternion_xyzw)
    return PLACED.pack(BOX, *turned, *message.position, 0.5 * x, 0.5 * y, 0.5 * z, 0.0)


_BOX = Recipe(
    lambda m: (_bounded_body(coal.Box(*m.size)), se3(m.position, m.quaternion_xyzw)),
    lambda m: surfaces.box(m.size),
    lambda m, placement: Charges(boxes=np.array([[*placement.translation, *placement.rotation.T.ravel(), *m.size]])),
)


def _cylinder(message: messages.Cylinder) -> bytes:
    turned = unit(message.quaternion_xyzw)
    return PLACED.pack(CYLINDER, *turned, *message.position, 0.0, 0.0, 0.5 * message.length, message.radius)


def _charge_cylinder(message: messages.Cylinder, placement: Any) -> Charges:
    quads = transform_points(placement, surfaces.prism_quads(message.radius, message.length).reshape(-1, 3))
    return Charges(quads=quads.reshape(-1, 4, 3))


_CYLINDER = Recipe(
    lambda m: (_bounded_body(coal.Cylinder(m.radius, m.length)), se3(m.position, m.quaternion_xyzw)),
    lambda m: surfaces.cylinder(m.radius, m.length),
    _charge_cylinder,
)


def _sphere(message: messages.Sphere) -> bytes:
    return PLACED.pack(CAPSULE, *_UPRIGHT, *message.position, 0.0, 0.0, 0.0, message.radius)


_SPHERE = Recipe(
    lambda m: (_bounded_body(coal.Sphere(m.radius)), pin.SE3(np.eye(3), np.array(m.position))),
    lambda m: surfaces.sphere(m.radius),
    lambda m, _: Charges(spheres=np.array([[*m.position, m.radius]])),
)


def _capsule(message: messages.Capsule) -> bytes:
    turned = unit(message.quaternion_xyzw)
    return PLACED.pack(CAPSULE, *turned, *message.position, 0.0, 0.0, 0.5 * message.length, message.radius)


def _charge_capsule(message: messages.Capsule, placement: Any) -> Charges:
    half_axis = placement.rotation[:, 2] * (0.5 * message.length)
    ends = [*(placement.translation - half_axis), *(placement.translation + half_axis)]
    return Charges(capsules=np.array([[*ends, message.radius]]))


_CAPSULE = Recipe(
    lambda m: (_bounded_body(coal.Capsule(m.radius, m.length)), se3(m.position, m.quaternion_xyzw)),
    lambda m: surfaces.capsule(m.radius, m.length),
    _charge_capsule,
)


def _plane(message: messages.HalfSpace) -> tuple[np.ndarray, float]:
    """Return the unit normal (3,), and the offset along it [m]."""
    length = float(np.linalg.norm(message.normal))
    return np.array(message.normal) / length, message.offset / length


def _half_space(message: messages.HalfSpace) -> bytes:
    normal, offset = _plane(message)
    return PLACED.pack(HALF_SPACE, *_UPRIGHT, *(offset * normal), *normal, 0.0)


def _patch(message: messages.HalfSpace) -> tuple[np.ndarray, np.ndarray]:
    normal, offset = _plane(message)
    sides = axes_across(normal) * (0.5 * HALF_SPACE_PATCH)
    corners = offset * normal + np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ sides
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def _charge_half_space(message: messages.HalfSpace, _: Any) -> Charges:
    normal, offset = _plane(message)
    return Charges(planes=np.array([[*normal, offset]]))


_HALF_SPACE = Recipe(
    lambda m: (_bounded_body(coal.Halfspace(*_plane(m))), pin.SE3.Identity()), _patch, _charge_half_space
)

PRIMITIVES: dict[type[messages.Obstacle], tuple[Recipe, Callable[[Any], bytes]]] = {
    messages.Box: (_BOX, _box),
    messages.Sphere: (_SPHERE, _sphere),
    messages.Cylinder: (_CYLINDER, _cylinder),
    messages.Capsule: (_CAPSULE, _capsule),
    messages.HalfSpace: (_HALF_SPACE, _half_space),
}
"""Recipe of each kind, and the function that packs its message as `PLACED`."""


@dataclass(frozen=True, eq=False)
class Obstacle:
    """An obstacle at rest; one that moves, where it is at first."""

    message: messages.Obstacle
    recipe: Recipe
    placed: bytes = b""  # a primitive's, or box mesh's, row for kernels, `primitive.PLACED`; else empty
    warnings: tuple[str, ...] = ()  # harmless oddities of it
    motion: ObstacleMotion | None = None  # its motion; None at rest
    cloud: Cloud | None = None  # its points and their radius, if it is a cloud
    cropped: CroppedSurface | None = None  # its surface, if it is a part of another obstacle's; see `scene/crop.py`

    @property
    def name(self) -> str:
        """Its name in the scene."""
        return self.message.name

    @property
    def charge(self) -> float:
        """Charge per area."""
        return self.message.charge

    @property
    def solid(self) -> bool:
        """True if it has an inside; else it is a thin surface."""
        return self.recipe.solid

    @property
    def convex(self) -> bool:
        """True if Coal tests it as one convex body: distances are signed then."""
        return self.recipe.convex

    @property
    def _body(self) -> tuple[Any, Any]:
        return self.recipe.body(self.message) if self.recipe.facets is not None else self._kept_body

    @cached_property
    def _kept_body(self) -> tuple[Any, Any]:
        return self.recipe.body(self.message)

    @property
    def shape(self) -> Any:
        """Coal geometry in its own frame; of a cloud its points alone, see `rounding`.

        It takes long to make of very many triangles: see `facets`.
        """
        return self._body[0]

    @property
    def facets(self) -> Facets | None:
        """The triangles of `shape` if it isn't convex, made on demand and in patches; else None."""
        return self.recipe.facets

    @property
    def faces(self) -> int:
        """Number of triangles that Coal tests, for its memory; 0 if it is convex."""
        return 0 if self.recipe.facets is None else self.recipe.facets.count

    @property
    def box(self) -> np.ndarray:
        """Lower and upper corner of the box about `shape` along the axes of its own frame, shape (2, 3) [m].

        Of a cropped solid it is about all of it: what is wholly inside is found by it.
        """
        if self.cropped is not None and self.solid:
            return self.cropped.box
        if self.recipe.facets is not None:
            return self.recipe.facets.box
        self.shape.computeLocalAABB()
        return np.array([self.shape.aabb_local.min_, self.shape.aabb_local.max_])

    @property
    def placement(self) -> Any:
        """``T_world_shape``, a pinocchio.SE3."""
        return self._body[1] if self.recipe.placement is None else self.recipe.placement

    @property
    def endless(self) -> bool:
        """True if it is unbounded."""
        return isinstance(self.message, messages.HalfSpace)

    @property
    def rounding(self) -> float:
        """Radius by which the obstacle is larger than `shape` all around [m], and its distances smaller."""
        return 0.0 if self.cloud is None else self.cloud.radius

    def placement_at(self, time: float) -> Any:
        """Return ``T_world_shape`` at a time [s], a pinocchio.SE3."""
        if self.motion is None:
            return self.placement
        return self.motion.at(time) * self.motion.placements[0].actInv(self.placement)

    @cached_property
    def _triangulation(self) -> tuple[np.ndarray, np.ndarray]:
        vertices, triangles = self.recipe.surface(self.message)
        made = transform_points(self.placement, vertices), np.array(triangles)
        for array in made:
            array.setflags(write=False)
        return made

    @property
    def vertices(self) -> np.ndarray:
        """Vertices of a triangulation, shape (v, 3) [m, world], for drawing; of a half-space, of a patch of it."""
        return self._triangulation[0]

    @property
    def triangles(self) -> np.ndarray:
        """Its triangles, shape (t, 3), counter-clockwise from outside."""
        return self._triangulation[1]

    @cached_property
    def surfaces(self) -> tuple[Triangulated, ...]:
        """The triangles of a non-convex obstacle, in its own frame: those of each solid, or of the thin surface."""
        if self.cropped is not None:
            return self.cropped.parts
        vertices, triangles = self.recipe.surface(self.message)
        parts = solids_of(vertices, triangles) if self.solid else [triangles]
        return tuple((vertices, part, NO_TRIANGLES) for part in parts)

    @cached_property
    def boxes(self) -> list[SolidBox | None]:
        """For each of `surfaces` the box that it is, in its own frame, or None."""
        if not self.solid:
            return [None] * len(self.surfaces)
        return find_boxes(
            self.surfaces[0][0], [part if not len(beside) else beside[:0] for _, part, beside in self.surfaces]
        )

    @property
    def whole_surface(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices (v, 3) [m] and triangles (t, 3) in its own frame, of all of it even if it is cropped."""
        return self.recipe.surface(self.message) if self.cropped is None else self.cropped.whole()

    @property
    def whole_solids(self) -> list[np.ndarray]:
        """The triangles of each of its solids, shape (t, 3), as `whole_surface` has them; none of a thin surface."""
        if self.cropped is not None:
            return self.cropped.solids() if self.solid else []
        return [part for _, part, _ in self.surfaces] if self.solid else []

    @cached_property
    def charges(self) -> Charges:
        """Its share of the field, for a charge of 1 per area."""
        made = self.recipe.charged(self.message, self.placement)
        for array in vars(made).values():
            array.setflags(write=False)
        return made


def build_all(declared: Sequence[messages.Obstacle], contents: Mapping[int, Content]) -> tuple[Obstacle, ...]:
    """Build the obstacles of a scene, new polygons together. Raises SceneInvalid as `build`."""
    polygons = {index: one for index, one in enumerate(declared) if isinstance(one, messages.Polygon)}
    contents = {**contents, **{index: content_of(one) for index, one in polygons.items() if index not in contents}}
    new = [k for k, one in polygons.items() if one.trajectory is None and contents[k].all not in _KNOWN]
    sheets = dict(zip(new, build_sheets([polygons[index].vertices for index in new]), strict=True))
    return tuple(build(one, index, contents.get(index), sheets.get(index)) for index, one in enumerate(declared))


def build(
    message: messages.Obstacle, index: int, content: Content | None = None, sheet: Sheet | str | None = None
) -> Obstacle:
    """Build an obstacle from its message; from the same declaration it is the same object, unless it is a primitive.

    Its hash and, of a polygon at rest, its sheet may be given. Raises SceneInvalid if its shape can't be used or its
    kind isn't served; the error's details name the obstacle and, by its index in the scene, the path.
    """
    if type(message) in PRIMITIVES and message.trajectory is None:  # made in less time than looked up
        primitive = _primitive(message)
        large = size_warnings(message, None)
        return dataclasses.replace(primitive, warnings=large) if large else primitive
    content = content_of(message) if content is None else content
    known = _KNOWN.get(content.all)
    if known is not None:
        return known
    try:
        motion = None if message.trajectory is None else ObstacleMotion.of(message.trajectory)
        still = message if motion is None else put_at(message, motion.placements[0])
        is_moved = motion is not None and isinstance(still, messages.PointCloud)  # its points are others then
        if sheet is None:
            obstacle = BUILDERS[type(still)](still, content._replace(geometry=b"") if is_moved else content)
        else:
            obstacle = _sheet(still, sheet)
    except _UnusableError as error:
        raise SceneInvalid(
            f"obstacle {message.name!r}: {error.fault}",
            obstacle=message.name,
            path=f"$.obstacles[{index}]{error.field}",
        ) from None
    large = size_warnings(still, obstacle.recipe.extent)
    if motion is not None or large:
        obstacle = dataclasses.replace(obstacle, motion=motion, warnings=(*obstacle.warnings, *large))
    return _KNOWN.insert(content.all, obstacle, BYTES_PER_FACE * obstacle.faces)


_KNOWN: BoundedMap[bytes, Obstacle] = BoundedMap(OBSTACLES)
"""Obstacles by the hash of their declaration: one that is in the next scene again is not built again."""


class _UnusableError(Exception):
    def __init__(self, fault: str, field: str) -> None:
        super().__init__(fault)
        self.fault = fault
        self.field = field


def _primitive(message: Any, _: Content | None = None) -> Obstacle:
    recipe, placed = PRIMITIVES[type(message)]
    return Obstacle(message, recipe, placed(message))


def _mesh(message: messages.Mesh, content: Content) -> Obstacle:
    mesh = judge_mesh(message.vertices, message.triangles, content.geometry)
    if mesh is None:
        raise _UnusableError("the mesh has no triangle with an area", ".triangles")
    return _surface(message, mesh, se3(message.position, message.quaternion_xyzw))


def _sheet(message: messages.Obstacle, sheet: Sheet | str) -> Obstacle:
    if isinstance(sheet, str):
        raise _UnusableError(sheet, ".vertices")
    whole, charges = (sheet.vertices, sheet.triangles), sheet.charges
    facets = Facets(len(sheet.triangles), lambda: whole, box=sheet.box)
    recipe = Recipe(
        body=lambda _: (facets.whole, _ORIGIN),
        surface=lambda _: whole,
        charged=lambda *_: charges,
        solid=False,
        convex=False,
        facets=facets,
        placement=_ORIGIN,
        extent=float((sheet.box[1] - sheet.box[0]).max()),
    )
    return Obstacle(message, recipe)


_ORIGIN = pin.SE3.Identity()


def _point_cloud(message: messages.PointCloud, content: Content) -> Obstacle:
    points = points_in(message.points)
    points.setflags(write=False)
    cloud, placement = Cloud(points, message.radius), pin.SE3.Identity()
    known = content.geometry if is_large(len(points)) else b""
    facets = Facets(len(points), lambda: cloud_specks(points), known)
    recipe = Recipe(
        body=lambda _: (facets.whole, placement),
        surface=lambda _: cloud_surface(points, cloud.radius),
        charged=lambda *_: cloud_charges(points, cloud.radius),
        convex=False,
        facets=facets,
        placement=placement,
        extent=extent_of(points),
        content=known,
    )
    return Obstacle(message, recipe, cloud=cloud)


BUILDERS: dict[type[messages.Obstacle], Callable[[Any, Content], Obstacle]] = {
    **dict.fromkeys(PRIMITIVES, _primitive),
    messages.Mesh: _mesh,
    messages.Polygon: lambda message, _: _sheet(message, build_sheets([message.vertices])[0]),
    messages.PointCloud: _point_cloud,
}
"""Builder by kind of message; they raise `_UnusableError`."""


def _surface(message: messages.Obstacle, mesh: JudgedMesh, placement: Any) -> Obstacle:
    facets = Facets(mesh.count, mesh.surface, mesh.content) if mesh.hull is None else None
    placed = b""
    if mesh.hull is not None and (box := find_boxes(mesh.surface()[0], [mesh.surface()[1]])[0]) is not None:
        there = placement * pin.SE3(box.rotation, box.centre)
        x, y, z = box.halves.tolist()
        placed = PLACED.pack(BOX, *pin.SE3ToXYZQUAT(there)[3:], *there.translation, x, y, z, 0.0)

    def charged(*_: Any) -> Charges:
        vertices, triangles = mesh.surface()
        quads, rest = pair_faces(transform_points(placement, vertices), triangles)
        return Charges(triangles=rest, quads=quads)

    recipe = Recipe(
        body=lambda _: (mesh.hull if facets is None else facets.whole, placement),
        surface=lambda _: mesh.surface(),
        charged=charged,
        solid=mesh.solid,
        convex=mesh.hull is not None,
        facets=facets,
        placement=placement,
        extent=mesh.extent,
        content=mesh.content,
    )
    warnings = tuple(f"obstacle {message.name!r}: {warning}" for warning in mesh.warnings)
    return Obstacle(message, recipe, placed, warnings)


HARDLY_METRES = 100.0  # a larger obstacle was probably meant in millimetres [m]: service/docs/scenes.md says so


def size_warnings(message: messages.Obstacle, declared_extent: float | None) -> tuple[str, ...]:
    """Warn if an obstacle, or the extent of its points, is larger than `HARDLY_METRES` along an axis."""
    if declared_extent is not None:
        extent = declared_extent
    elif isinstance(message, messages.Box):
        extent = max(message.size)
    elif isinstance(message, messages.Sphere):
        extent = 2.0 * message.radius
    elif isinstance(message, messages.Cylinder | messages.Capsule):
        extent = max(message.length, 2.0 * message.radius)
    else:  # a half-space has no size
        return ()
    if extent <= HARDLY_METRES:
        return ()
    return (f"obstacle {message.name!r} is {extent:.4g} m large: are its numbers millimetres? Lengths are in metres",)
