"""Attach a request's objects to the robot as links with pairs and inertia; the situation between two steps.

Robots with equal objects are one object, so that tables are made once: whatever a message says of an object must enter
`_collect`, by which objects are equal.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import coal
import msgspec
import numpy as np
import pinocchio as pin

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.errors import MalformedRequest, SceneInvalid, UnknownFrame, UnknownObject
from guidefield.geometry.convex import balls_as_capsules, bvh
from guidefield.geometry.surfaces import se3, wire_pose
from guidefield.memo import memoized
from guidefield.messages import scene as messages
from guidefield.messages.requests import Attach, AttachedObject
from guidefield.messages.scene import HalfSpace, PointCloud
from guidefield.messages.values import IDENTITY, ORIGIN, InertiaTensor, Placement, Vector3
from guidefield.planner.sequence.step_sequence import AWAY, Touch
from guidefield.robot.model.joints import RobotConfiguration
from guidefield.robot.model.model import GeometryChoice, RobotModel, frame_index
from guidefield.robot.urdf.elements import NO_LENGTH
from guidefield.scene import obstacle, scene as scenes
from guidefield.scene.cloud import MOST_IN_BODIES
from guidefield.scene.obstacle_message import are_many, content_of, count_of, put_at
from guidefield.scene.scene import Scene

CARRIED = (messages.Placed, messages.Sphere)
"""Kinds, with a `position`, that can be picked up and put down; `Attach` of `messages/plan_request.py` lists them."""


@dataclass(frozen=True)
class HeldObject:
    """An object that is held."""

    attached: AttachedObject  # the object, with the link and placement by which it is held
    touch_objects: tuple[str, ...] = ()  # obstacles that it may touch where it is picked up and put down
    near: frozenset[str] = frozenset()  # those that it hasn't been `AWAY` from since it was picked up

    @property
    def name(self) -> str:
        """Its name."""
        return self.attached.obstacle.name


@dataclass(frozen=True, eq=False)
class StepSituation:
    """The situation in which a step begins."""

    robot: RobotModel  # the robot, with nothing in its hands
    root: Any  # its placement in the world, pinocchio.SE3
    scene: Scene  # the obstacles as they stand, without what is held
    q: RobotConfiguration  # configuration of the whole robot, shape (nq,)
    objects: tuple[HeldObject, ...] = field(default=())  # what is held

    @property
    def held_names(self) -> tuple[str, ...]:
        """Names of the objects that are held."""
        return tuple(one.name for one in self.objects)

    @property
    def touches(self) -> tuple[Touch, ...]:
        """Held objects, each with an obstacle that it may touch where it is picked up and put down."""
        return tuple((one.name, other) for one in self.objects for other in one.touch_objects)

    @cached_property
    def _data(self) -> Any:
        data = self.robot.model.createData()
        pin.framesForwardKinematics(self.robot.model, data, self.q)
        return data

    def frame(self, name: str) -> Any:
        """Placement of a frame of the robot in the world, pinocchio.SE3."""
        return self.root * self._data.oMf[self.robot.frame_id(name)]

    def place(self, one: HeldObject) -> messages.Obstacle:
        """A held object as an obstacle where it is."""
        attached = one.attached
        own = se3(
            getattr(attached.obstacle, "position", ORIGIN),
            getattr(attached.obstacle, "quaternion_xyzw", IDENTITY),
        )
        in_link = se3(attached.placement.position, attached.placement.quaternion_xyzw)
        return put_at(attached.obstacle, self.frame(attached.link) * in_link * own)

    def move(self, q: RobotConfiguration, time: float, min_clearance: float) -> StepSituation:
        """The same with the robot at a configuration, shape (nq,), at a time [s]; `near` is without those left."""
        there = dataclasses.replace(self, q=q)
        objects = [
            dataclasses.replace(one, near=frozenset(name for name in one.near if there.gap(one, name, time) < away))
            for away in [max(AWAY, min_clearance)]
            for one in self.objects
        ]
        return dataclasses.replace(there, objects=tuple(objects))

    def gap(self, one: HeldObject, other: str, time: float) -> float:
        """Distance of a held object from an obstacle at a time [s]; 0 or less in contact [m]."""
        against = self.scene.obstacle(other)
        assert against is not None, "what may be touched is an obstacle"
        body = obstacle.build(self.place(one), 0)
        placed = [coal.Transform3s(at.rotation, at.translation) for at in (body.placement, against.placement_at(time))]
        result = coal.DistanceResult()
        shapes = balls_as_capsules(body.shape, against.shape)
        coal.distance(shapes[0], placed[0], shapes[1], placed[1], coal.DistanceRequest(), result)
        return float(result.min_distance) - against.rounding

    def rests_from(self, name: str) -> float:
        """The time at which an obstacle comes to rest [s]; 0 if it doesn't move, or isn't there."""
        found = self.scene.obstacle(name)
        return 0.0 if found is None or found.motion is None else found.motion.end

    def without(self, name: str) -> StepSituation:
        """The same with a held object put down where it is; raises UnknownObject if no such object is held."""
        one = next((one for one in self.objects if one.name == name), None)
        if one is None:
            raise UnknownObject(
                f"{name!r} is not held; held are: {', '.join(self.held_names) or 'nothing'}",
                object=name,
                available=list(self.held_names),
            )
        if not isinstance(one.attached.obstacle, CARRIED):
            kind = type(one.attached.obstacle).__struct_config__.tag
            raise MalformedRequest(f"{name!r} is a {kind}: it can be held, but not be put down", object=name)
        obstacles = [*self.scene.message.obstacles, self.place(one)]
        objects = tuple(other for other in self.objects if other is not one)
        return dataclasses.replace(self, scene=_with(self.scene, obstacles), objects=objects)

    def holding(self, attach: Attach, link: str) -> StepSituation:
        """The same with an obstacle picked up where it is; one that moves, where it comes to rest.

        Raises UnknownObject if there is no such obstacle, or one that it may touch; UnknownFrame if a link isn't one of
        the robot's; MalformedRequest if it is of a kind that can't be picked up.
        """
        names = [one.name for one in self.scene.obstacles]
        for name in (attach.object, *attach.touch_objects):
            if name not in names:
                raise UnknownObject(
                    f"the scene has no obstacle {name!r} then; it has {', '.join(names) or 'none'}",
                    object=name,
                    available=names,
                )
        found = self.scene.obstacle(attach.object)
        assert found is not None, "it is one of them"
        if not isinstance(found.message, CARRIED):
            kind = type(found.message).__struct_config__.tag
            raise MalformedRequest(f"{attach.object!r} is a {kind}: nothing can pick it up", object=attach.object)
        holder = attach.link or link
        for name in (holder, *attach.touch_links):
            if name not in self.robot.links:
                available = list(self.robot.links)
                raise UnknownFrame(
                    f"the robot has no link {name!r}; it has {', '.join(available)}", link=name, available=available
                )
        placement = Placement(*wire_pose(self.frame(holder).inverse()))
        message = found.message if found.motion is None else put_at(found.message, found.motion.at(found.motion.end))
        mass = attach.mass, attach.centre_of_mass, attach.inertia
        attached = AttachedObject(message, holder, placement, attach.touch_links, *mass)
        others = tuple(name for name in attach.touch_objects if name != attach.object)
        held = HeldObject(attached, others, frozenset(others))
        left = [one for one in self.scene.message.obstacles if one.name != attach.object]
        return dataclasses.replace(self, scene=_with(self.scene, left), objects=(*self.objects, held))

    def link_of(self, frame: str) -> str:
        """The link that carries a frame."""
        if frame in self.robot.links:
            return frame
        model = self.robot.model
        index = self.robot.frame_id(frame)
        for link in model.frames:  # the link below a joint stands where the joint's frame does
            if link.type == pin.FrameType.BODY and link.parentFrame == index:
                return str(link.name)
        raise AssertionError("a frame is that of a link or of a joint, which has a link below it")


def _with(scene: Scene, obstacles: list[messages.Obstacle]) -> Scene:
    return scenes.build(msgspec.structs.replace(scene.message, obstacles=obstacles))


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
        link_frame = model.frames[frame_index(model, one.link)]
        joint, on_joint = link_frame.parentJoint, link_frame.placement.copy()
        placement = on_joint * one.placement
        del link_frame  # it lies among the model's frames, which move when one is added
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
    """Return the kind of a shape, and the kind that it is tested as."""
    if isinstance(shape, coal.BVHModelBase):
        return "mesh", "triangle mesh"
    if isinstance(shape, coal.Convex):
        return "mesh", "convex hull"
    return type(shape).__name__.lower(), "primitive"


LARGE_COUNT = 1000  # triangles and points: fewer are built in 20 ms, before a request's time or with no look at it


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
def _build_robot(robot: RobotModel, attached: _Attached) -> RobotModel:
    return add_held_links(robot, [_build_held(one, index) for index, one in enumerate(attached.objects)])


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
