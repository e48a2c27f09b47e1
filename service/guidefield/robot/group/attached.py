"""Objects that a link holds: bodies of the robot from then on, in its geometry, its charges and every check."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import pinocchio as pin

from guidefield.errors import UnknownFrame, UnknownObject
from guidefield.robot.model.frames import frame_index
from guidefield.robot.model.model import GeometryChoice, RobotModel


@dataclass(frozen=True, eq=False)
class Held:
    """An object that a link holds.

    Attributes:
        name: Its name; no link's, frame's or collision shape's.
        shape: Bounded Coal geometry in its own frame.
        placement: Of the shape in the link's frame, a pinocchio.SE3.
        link: The link that holds it.
        touch_links: Links that it may touch besides.
        warnings: What is odd about it but harmless.
    """

    name: str
    shape: Any
    placement: Any
    link: str
    touch_links: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def with_held(robot: RobotModel, held: Sequence[Held]) -> RobotModel:
    """The robot holding objects.

    Each is a link of its own, fixed to the one that holds it. It is tested against all links but those, those it may
    touch, and those that move with it as one; and against other held objects that don't.

    Raises:
        RobotInvalid: if an object is held by a robot that has no collision geometry.
        UnknownFrame: if a link that holds or may be touched isn't one of the robot's.
        UnknownObject: if an object has the name of a link, of a frame, of a collision shape or of another object.
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
        joint, placement = carrier.parentJoint, carrier.placement * one.placement
        del carrier  # it lies among the model's frames, which move when one is added
        # a link's frame: of a body with another one Pinocchio loses it where joints are locked
        frame = model.addFrame(pin.Frame(one.name, joint, placement, pin.FrameType.BODY), False)
        shape = pin.GeometryObject(one.name, joint, frame, placement, one.shape)
        added = geometry.addGeometryObject(shape)
        apart = {one.link, *one.touch_links}
        for other, choice in enumerate(choices):
            if choice.link not in apart and geometry.geometryObjects[other].parentJoint != joint:
                geometry.addCollisionPair(pin.CollisionPair(other, added))
        links = (*links, one.name)
        choices = (*choices, GeometryChoice(one.name, one.name, *_judged(one.shape)))
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


def _judged(shape: Any) -> tuple[str, str]:
    """What a shape is, and as what it is judged."""
    if isinstance(shape, coal.BVHModelBase):
        return "mesh", "triangle mesh"
    if isinstance(shape, coal.Convex):
        return "mesh", "convex hull"
    return type(shape).__name__.lower(), "primitive"
