"""The situation between two steps, a `Situation` of planner/sequence/course.py: robot, held objects, obstacles."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import coal
import msgspec
import pinocchio as pin

from guidefield.errors import MalformedRequest, UnknownFrame, UnknownObject
from guidefield.geometry.convex import balls_as_capsules
from guidefield.geometry.placements import se3, wire_pose
from guidefield.messages import scene as messages
from guidefield.messages.requests import Attach, AttachedObject
from guidefield.messages.values import IDENTITY, ORIGIN, Placement
from guidefield.planner.sequence.course import AWAY, Touch
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.spaces import RobotConfiguration
from guidefield.scene import obstacle, scene as scenes
from guidefield.scene.motion import put_at
from guidefield.scene.scene import Scene

CARRIED = (messages.Box, messages.Sphere, messages.Cylinder, messages.Capsule, messages.Mesh)
"""Kinds of obstacles that can be picked up and put down."""


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
        """When an obstacle comes to rest [s]; 0 if it doesn't move, or isn't there."""
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

    def holding(self, asked: Attach, link: str) -> StepSituation:
        """The same with an obstacle picked up where it is; one that moves, where it comes to rest.

        Raises UnknownObject if there is no such obstacle, or one that it may touch; UnknownFrame if a link isn't one of
        the robot's; MalformedRequest if it is of a kind that can't be picked up.
        """
        names = [one.name for one in self.scene.obstacles]
        for name in (asked.object, *asked.touch_objects):
            if name not in names:
                raise UnknownObject(
                    f"the scene has no obstacle {name!r} then; it has {', '.join(names) or 'none'}",
                    object=name,
                    available=names,
                )
        found = self.scene.obstacle(asked.object)
        assert found is not None, "it is one of them"
        if not isinstance(found.message, CARRIED):
            kind = type(found.message).__struct_config__.tag
            raise MalformedRequest(f"{asked.object!r} is a {kind}: nothing can pick it up", object=asked.object)
        holder = asked.link or link
        for name in (holder, *asked.touch_links):
            if name not in self.robot.links:
                available = list(self.robot.links)
                raise UnknownFrame(
                    f"the robot has no link {name!r}; it has {', '.join(available)}", link=name, available=available
                )
        placement = Placement(*wire_pose(self.frame(holder).inverse()))
        message = found.message if found.motion is None else put_at(found.message, found.motion.at(found.motion.end))
        mass = asked.mass, asked.centre_of_mass, asked.inertia
        attached = AttachedObject(message, holder, placement, asked.touch_links, *mass)
        others = tuple(name for name in asked.touch_objects if name != asked.object)
        held = HeldObject(attached, others, frozenset(others))
        left = [one for one in self.scene.message.obstacles if one.name != asked.object]
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
