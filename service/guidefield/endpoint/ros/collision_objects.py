"""Convert objects of the planning scene: moveit_msgs/CollisionObject to obstacles of ours, and back.

An object's pose is in its header's frame, its shapes' and named frames' in the object's. A plane is solid on the side
that its normal points away from. `primitive` reads constraints' regions, too: all but boxes and balls are cylinders.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin

from guidefield.endpoint.ros.refusals import ObjectRefused, number, placement, pose_message
from guidefield.geometry.surfaces import wire_pose
from guidefield.messages.scene import Box, Cylinder, HalfSpace, Mesh, Obstacle, Sphere

BOX, SPHERE, CYLINDER = 1, 2, 3  # kinds of shape_msgs/SolidPrimitive that are served, a new one in constraints.py, too
LONGEST_NAME = 200  # characters of an object's name; with "/" and a shape's number at most the 256 of our `Name`

Shape = Box | Sphere | Cylinder | Mesh | HalfSpace


@dataclass(frozen=True)
class SceneObject:
    """An object of the scene."""

    pose: Any  # in the world, or in the link that holds it; pinocchio.SE3
    shapes: tuple[tuple[Shape, Any], ...]  # each without a name and at the origin, and its place in the object
    frames: MappingProxyType[str, Any] = field(default_factory=lambda: MappingProxyType({}))  # named frames in it

    def obstacles(self, name: str) -> Iterator[Obstacle]:
        """Return its shapes as obstacles, in the frame of its pose; named as by `names`."""
        for one, (shape, there) in zip(self.names(name), self.shapes, strict=True):
            yield _place(shape, one, self.pose * there)

    def names(self, name: str) -> list[str]:
        """Return the names of its shapes as obstacles: the object's for one shape, numbered for several."""
        return [name] if len(self.shapes) == 1 else [f"{name}/{number}" for number in range(len(self.shapes))]


def object_of(obstacle: str, objects: Collection[str]) -> str | None:
    """Return the object of which an obstacle is a shape; None if it is of none."""
    name = obstacle.rpartition("/")[0]
    return next((one for one in (obstacle, name) if one in objects), None)


def shapes_of(message: Any, where: str) -> tuple[tuple[Shape, Any], ...]:
    """Return the shapes of a CollisionObject, and their places in it; a pose that isn't given is the identity.

    Raises Refused if a kind or a size isn't served.
    """
    found: list[tuple[Shape, Any]] = []
    kinds: tuple[tuple[str, str, Callable[[Any, str], Shape]], ...] = (
        ("primitives", "primitive_poses", primitive),
        ("meshes", "mesh_poses", _mesh),
        ("planes", "plane_poses", _plane),
    )
    for several, poses, shape in kinds:
        given = getattr(message, poses)
        for index, one in enumerate(getattr(message, several)):
            there = placement(given[index], f"{where}.{poses}[{index}]") if index < len(given) else pin.SE3.Identity()
            found.append((shape(one, f"{where}.{several}[{index}]"), there))
    return tuple(found)


def frames_of(message: Any, where: str) -> MappingProxyType[str, Any]:
    """Return the named frames of a CollisionObject; raises Refused if names and poses aren't equally many."""
    names, poses = message.subframe_names, message.subframe_poses
    if len(names) != len(poses):
        raise ObjectRefused(f"`{where}.subframe_names` has {len(names)} entries, `subframe_poses` {len(poses)}")
    there = [placement(pose, f"{where}.subframe_poses[{index}]") for index, pose in enumerate(poses)]
    return MappingProxyType(dict(zip(names, there, strict=True)))


def checked_id(name: str, where: str) -> str:
    """Return the name itself, if an object can have it; else raise Refused."""
    if not 0 < len(name) <= LONGEST_NAME:
        raise ObjectRefused(f"`{where}.id` must have 1 to {LONGEST_NAME} characters, got {name[:64]!r}")
    return name


def primitive(message: Any, where: str) -> Shape:
    """Return the shape of a shape_msgs/SolidPrimitive.

    Raises Refused if it is a cone or a prism, or a size isn't positive.
    """
    wanted = {BOX: 3, SPHERE: 1, CYLINDER: 2}.get(message.type)
    if wanted is None:
        raise ObjectRefused(f"`{where}.type` {message.type} isn't served; box 1, sphere 2, cylinder 3 are")
    if len(message.dimensions) != wanted:
        raise ObjectRefused(
            f"`{where}.dimensions` must have {wanted} for type {message.type}, got {len(message.dimensions)}"
        )
    sizes = [number(size, f"{where}.dimensions[{index}]") for index, size in enumerate(message.dimensions.tolist())]
    if min(sizes) <= 0.0:
        raise ObjectRefused(f"`{where}.dimensions` must be positive, got {sizes}")
    if message.type == BOX:
        return Box(name="-", size=(sizes[0], sizes[1], sizes[2]))
    if message.type == SPHERE:
        return Sphere(name="-", radius=sizes[0])
    return Cylinder(name="-", length=sizes[0], radius=sizes[1])


def _mesh(message: Any, where: str) -> Shape:
    try:
        return Mesh(
            name="-",
            vertices=[(float(p.x), float(p.y), float(p.z)) for p in message.vertices],
            triangles=[_indices(triangle) for triangle in message.triangles],
        )
    except ValueError as error:
        raise ObjectRefused(f"`{where}`: {error}") from None


def _indices(triangle: Any) -> tuple[int, int, int]:
    a, b, c = triangle.vertex_indices.tolist()
    return a, b, c


def _plane(message: Any, where: str) -> Shape:
    a, b, c, d = (number(value, f"{where}.coef[{index}]") for index, value in enumerate(message.coef.tolist()))
    length = math.hypot(a, b, c)
    if length < 1e-6:  # no plane of use has so short a normal
        raise ObjectRefused(f"`{where}.coef` has no normal")
    return HalfSpace(name="-", normal=(a / length, b / length, c / length), offset=-d / length)


def _place(shape: Shape, name: str, there: Any) -> Obstacle:
    position, quaternion = wire_pose(there)
    if isinstance(shape, HalfSpace):
        normal = there.rotation @ np.array(shape.normal)
        offset = shape.offset + float(normal @ there.translation)
        return HalfSpace(name=name, normal=tuple(normal.tolist()), offset=offset)
    if isinstance(shape, Sphere):
        return msgspec.structs.replace(shape, name=name, position=position)
    return msgspec.structs.replace(shape, name=name, position=position, quaternion_xyzw=quaternion)


def message_of(name: str, thing: SceneObject, frame: str, *, geometry: bool = True) -> dict[str, Any]:
    """Return the CollisionObject of an object whose pose is in a frame."""
    message: dict[str, Any] = {
        "id": name,
        "header": {"frame_id": frame},
        "pose": pose_message(thing.pose),
        "subframe_names": list(thing.frames),
        "subframe_poses": [pose_message(there) for there in thing.frames.values()],
    }
    for shape, there in thing.shapes if geometry else ():
        several, poses, shaped = _shape_message(shape)
        message.setdefault(several, []).append(shaped)
        message.setdefault(poses, []).append(pose_message(there))
    return message


def _shape_message(shape: Shape) -> tuple[str, str, dict[str, Any]]:
    match shape:
        case Mesh(vertices=vertices, triangles=triangles):
            points = [{"x": x, "y": y, "z": z} for x, y, z in vertices]  # type: ignore[union-attr]
            faces = [{"vertex_indices": list(corners)} for corners in triangles]  # type: ignore[union-attr]
            return "meshes", "mesh_poses", {"triangles": faces, "vertices": points}
        case HalfSpace():
            return "planes", "plane_poses", {"coef": [*shape.normal, -shape.offset]}
        case Box():
            return "primitives", "primitive_poses", {"type": BOX, "dimensions": list(shape.size)}
        case Sphere():
            return "primitives", "primitive_poses", {"type": SPHERE, "dimensions": [shape.radius]}
    return "primitives", "primitive_poses", {"type": CYLINDER, "dimensions": [shape.length, shape.radius]}
