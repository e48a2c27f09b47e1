"""The objects that a request attaches to the robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import msgspec

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.errors import MalformedRequest, SceneInvalid, UnknownObject
from guidefield.geometry.bvh import bvh
from guidefield.geometry.placements import se3
from guidefield.memo import memoized
from guidefield.messages.requests import AttachedObject
from guidefield.messages.scene import HalfSpace, PointCloud
from guidefield.robot.group.attached import Held, with_held
from guidefield.robot.model.model import RobotModel
from guidefield.scene import obstacle
from guidefield.scene.cloud import MOST_IN_BODIES
from guidefield.scene.content import content_of
from guidefield.scene.points import are_many, count_of
from guidefield.scene.scene import Scene

MANY = 1000
"""Objects of fewer triangles and points are built within a hundredth of a second or two."""


@dataclass(frozen=True)
class _Asked:
    """Objects to attach, known by a hash."""

    content: bytes
    objects: Sequence[AttachedObject] = field(compare=False)


def holding(
    robot: RobotModel, attached: Sequence[AttachedObject], scene: Scene, deadline: Deadline = UNLIMITED
) -> RobotModel:
    """The robot with what it holds.

    The same robot with the same objects is made once, so that what is computed for it is computed once.

    Args:
        robot: The robot.
        attached: What it holds; an obstacle's own placement counts within the placement in its link.
        scene: Where it is; it must not have obstacles of the same names.
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
    return _made(robot, _asked(attached))


def are_large(attached: Sequence[AttachedObject]) -> bool:
    """Whether objects have so many triangles and points that building them takes long."""
    return are_many([one.obstacle for one in attached], MANY)


def _asked(attached: Sequence[AttachedObject]) -> _Asked:
    contents = [content_of(one.obstacle).all for one in attached]
    others = [(one.link, one.placement, one.touch_links) for one in attached]
    return _Asked(msgspec.msgpack.encode([contents, others]), attached)


@memoized
def _made(robot: RobotModel, asked: _Asked) -> RobotModel:
    return with_held(robot, [_held(one, index) for index, one in enumerate(asked.objects)])


def _held(one: AttachedObject, index: int) -> Held:
    try:
        body = obstacle.build(one.obstacle, index)
    except SceneInvalid as error:
        field = error.details["path"].removeprefix(f"$.obstacles[{index}]")
        details = {**error.details, "path": f"$.attached_objects[{index}].obstacle{field}"}
        raise SceneInvalid(f"`attached_objects[{index}]`: {error.message}", **details) from None
    placement = se3(one.placement.position, one.placement.quaternion_xyzw) * body.placement
    shape = body.shape
    if body.cloud is not None:
        shape = bvh(body.vertices, body.triangles)
    warnings = tuple(f"`attached_objects[{index}]`, {warning}" for warning in body.warnings)
    return Held(one.obstacle.name, shape, placement, one.link, tuple(one.touch_links), warnings)
