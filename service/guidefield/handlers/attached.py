"""Attach a request's objects to the robot: each becomes a link, with its shape, collision pairs and inertia."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import coal
import msgspec
import numpy as np
import pinocchio as pin

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.errors import MalformedRequest, SceneInvalid, UnknownFrame, UnknownObject
from guidefield.geometry.convex import bvh
from guidefield.geometry.placements import se3
from guidefield.memo import memoized
from guidefield.messages.requests import AttachedObject
from guidefield.messages.scene import HalfSpace, PointCloud
from guidefield.messages.values import IDENTITY, ORIGIN, InertiaTensor, Vector3
from guidefield.robot.model.model import GeometryChoice, RobotModel, frame_index
from guidefield.robot.urdf.links import NO_LENGTH
from guidefield.scene import obstacle
from guidefield.scene.cloud import MOST_IN_BODIES
from guidefield.scene.content import are_many, content_of, count_of
from guidefield.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class HeldShape:
    """An object that a link holds."""

    name: str  # its name; no link's, frame's or collision shape's
    shape: Any  # bounded Coal geometry in its own frame
    placement: Any  # of the shape in the link's frame, a pinocchio.SE3
    link: str  # the link that holds it
    touch_links: tuple[str, ...] = ()  # links that it may touch besides
    warnings: tuple[str, ...] = ()  # its harmless peculiarities
    inertia: Any | None = None  # a pinocchio.Inertia in the link's frame; None where its mass isn't known


def add_held_links(robot: RobotModel, held: Sequence[HeldShape]) -> RobotModel:
    """The robot with a link for each held object, fixed to the link that holds it.

    It is tested against all links but that one, its `touch_links`, and those that move with it as one; and against
    other held objects that don't.

    Raises RobotInvalid if an object is held by a robot that has no collision geometry; UnknownFrame if a link that
    holds or may be touched isn't one of the robot's; UnknownObject if an object has the name of a link, of a frame, of
    a collision shape or of another object.
    """
    if held:
        robot.require_collision_geometry()
    model, geometry, links, choices = robot.model.copy(), robot.geometry.copy(), robot.links, robot.geometry_choices
    frames, shapes = {frame.name for frame in model.frames}, {shape.name for shape in geometry.geometryObjects}
    for index, one in enumerate(held):
        for link in (one.link, *one.touch_links):
            if link not in links:
                raise UnknownFrame(
                    f"the attached object {one.name!r} names link {link!r}; the robot has {', '.join(links)}",
                    link=link,
                    available=list(links),
                    path=f"$.attached_objects[{index}]",
                )
        for what, names in (("a link or another object", links), ("a frame", frames), ("a collision shape", shapes)):
            if one.name in names:
                message = f"the attached object {one.name!r} has the name of {what}: give it another"
                raise UnknownObject(message, object=one.name, path=f"$.attached_objects[{index}].obstacle.name")
        carrier = model.frames[frame_index(model, one.link)]
        joint, on_joint = carrier.parentJoint, carrier.placement.copy()
        placement = on_joint * one.placement
        del carrier  # it lies among the model's frames, which move when one is added
        # a link's frame: of a body with another one Pinocchio loses it where joints are locked
        frame = model.addFrame(pin.Frame(one.name, joint, placement, pin.FrameType.BODY), False)
        if one.inertia is not None:
            model.appendBodyToJoint(joint, one.inertia, on_joint)
        shape = pin.GeometryObject(one.name, joint, frame, placement, one.shape)
        added = geometry.addGeometryObject(shape)
        apart = {one.link, *one.touch_links}
        for other, choice in enumerate(choices):
            if choice.link not in apart and geometry.geometryObjects[other].parentJoint != joint:
                geometry.addCollisionPair(pin.CollisionPair(other, added))
        links = (*links, one.name)
        choices = (*choices, GeometryChoice(one.name, one.name, *_describe_kinds(one.shape)))
    warnings = (*robot.warnings, *(warning for one in held for warning in one.warnings))
    return dataclasses.replace(
        robot,
        model=model,
        geometry=geometry,
        links=links,
        geometry_choices=choices,
        warnings=warnings,
        held=(*robot.held, *(one.name for one in held)),
    )


def _describe_kinds(shape: Any) -> tuple[str, str]:
    """Return the kind of a shape, and the kind that it is judged as."""
    if isinstance(shape, coal.BVHModelBase):
        return "mesh", "triangle mesh"
    if isinstance(shape, coal.Convex):
        return "mesh", "convex hull"
    return type(shape).__name__.lower(), "primitive"


LARGE_COUNT = 1000  # triangles and points; objects of fewer are built within 20 ms, without a look at the deadline


@dataclass(frozen=True)
class _Attached:
    """Objects to attach, equal if their contents are: `memoized` builds a robot once for equal ones."""

    content: bytes
    objects: Sequence[AttachedObject] = field(compare=False)


def holding(
    robot: RobotModel, attached: Sequence[AttachedObject], scene: Scene, deadline: Deadline = UNLIMITED
) -> RobotModel:
    """The robot with the objects that a request attaches; the same object for the same ones, so that its tables stay.

    Args:
        attached: The objects; an obstacle's own placement counts within the placement in its link.
        scene: The scene, which must not have obstacles of the same names.
        deadline: Checked before objects of many triangles or points are built.

    Raises:
        MalformedRequest: if a half-space is to be held.
        SceneInvalid: if a shape can't be used, or a cloud has too many points.
        UnknownFrame: if a link isn't one of the robot's.
        UnknownObject: if a name is taken.
        DeadlineExpired: if the deadline passed before these.
    """
    if not attached:
        return robot
    taken = {one.name for one in scene.obstacles}
    for index, one in enumerate(attached):
        if isinstance(one.obstacle, HalfSpace):
            raise MalformedRequest(f"`attached_objects[{index}]` is a half-space: nothing can hold it")
        if isinstance(one.obstacle, PointCloud) and (count := count_of(one.obstacle.points)) > MOST_IN_BODIES:
            raise SceneInvalid(
                f"`attached_objects[{index}]`: a cloud that is held may have {MOST_IN_BODIES} points,"
                f" not {count}: thin it out"
            )
        if one.obstacle.name in taken:
            raise UnknownObject(
                f"`attached_objects[{index}]`, {one.obstacle.name!r}, is an obstacle of the scene too: remove it there",
                object=one.obstacle.name,
            )
    if are_large(attached):
        deadline.check("what the robot holds was built")
    return _build_robot(robot, _collect(attached))


def are_large(attached: Sequence[AttachedObject]) -> bool:
    """Return whether objects have enough triangles and points for building them to take long."""
    return are_many([one.obstacle for one in attached], LARGE_COUNT)


def _collect(attached: Sequence[AttachedObject]) -> _Attached:
    contents = [content_of(one.obstacle).all for one in attached]
    others = [(one.link, one.placement, one.touch_links, one.mass, one.centre_of_mass, one.inertia) for one in attached]
    return _Attached(msgspec.msgpack.encode([contents, others]), attached)


@memoized
def _build_robot(robot: RobotModel, asked: _Attached) -> RobotModel:
    return add_held_links(robot, [_build_held(one, index) for index, one in enumerate(asked.objects)])


def _build_held(one: AttachedObject, index: int) -> HeldShape:
    try:
        body = obstacle.build(one.obstacle, index)
    except SceneInvalid as error:
        field = error.details["path"].removeprefix(f"$.obstacles[{index}]")
        details = {**error.details, "path": f"$.attached_objects[{index}].obstacle{field}"}
        raise SceneInvalid(f"`attached_objects[{index}]`: {error.message}", **details) from None
    lengths = np.hstack([getattr(one.obstacle, field, ()) for field in ("size", "radius", "length")])
    if (least := lengths.min(initial=1.0)) < NO_LENGTH:
        raise SceneInvalid(
            f"`attached_objects[{index}]`: {body.name!r} has a length of {least:g} m, which is none: what is held must"
            f" have {NO_LENGTH:g} m",
            obstacle=body.name,
            path=f"$.attached_objects[{index}].obstacle",
        )
    placement = se3(one.placement.position, one.placement.quaternion_xyzw) * body.placement
    shape = body.shape
    if body.cloud is not None:
        shape = bvh(body.vertices, body.triangles)
    warnings = tuple(f"`attached_objects[{index}]`, {warning}" for warning in body.warnings)
    return HeldShape(
        one.obstacle.name, shape, placement, one.link, tuple(one.touch_links), warnings, _inertia_of(one, index)
    )


def _inertia_of(one: AttachedObject, index: int) -> Any | None:
    """The inertia of an object in the frame of the link that holds it; None where its mass isn't known."""
    if one.mass is None:
        return None
    inertia = payload_inertia(one.mass, one.centre_of_mass, one.inertia, f"attached_objects[{index}]")
    own = se3(getattr(one.obstacle, "position", ORIGIN), getattr(one.obstacle, "quaternion_xyzw", IDENTITY))
    return inertia.se3Action(se3(one.placement.position, one.placement.quaternion_xyzw) * own)


def payload_inertia(mass: float, centre: Vector3, inertia: InertiaTensor, where: str) -> Any:
    """A load as a pinocchio.Inertia; raises MalformedRequest if no body has such an inertia. `where` is its field."""
    xx, xy, xz, yy, yz, zz = inertia
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    smallest, middle, largest = np.linalg.eigvalsh(matrix).tolist()
    slack = 1e-9 * max(1e-3, largest)
    if smallest < -slack or smallest + middle < largest - slack:
        raise MalformedRequest(
            f"`{where}.inertia` is no body's: its principal moments {smallest:g}, {middle:g}, {largest:g} "
            "must not be negative, nor one larger than the sum of the others",
            path=f"$.{where}.inertia",
        )
    return pin.Inertia(mass, np.array(centre), matrix)
