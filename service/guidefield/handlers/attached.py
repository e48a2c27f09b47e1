"""The objects that a request attaches to the robot."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import msgspec

from guidefield.errors import MalformedRequest, SceneInvalid, UnknownObject
from guidefield.geometry.placements import se3
from guidefield.messages.requests import AttachedObject
from guidefield.messages.scene import HalfSpace
from guidefield.robot.group.attached import Held, with_held
from guidefield.robot.model.model import RobotModel
from guidefield.scene import obstacle
from guidefield.scene.cloud import MOST_IN_BODIES
from guidefield.scene.facets import bvh
from guidefield.scene.scene import Scene


def holding(robot: RobotModel, attached: Sequence[AttachedObject], scene: Scene) -> RobotModel:
    """The robot with what it holds.

    The same robot with the same objects is made once, so that what is computed for it is computed once.

    Args:
        robot: The robot.
        attached: What it holds; an obstacle's own placement counts within the placement in its link.
        scene: Where it is; it must not have obstacles of the same names.

    Raises:
        MalformedRequest: if a half-space is to be held.
        SceneInvalid: if a shape can't be used.
        UnknownFrame: if a link isn't one of the robot's.
        UnknownObject: if a name is taken.
    """
    if not attached:
        return robot
    taken = {one.name for one in scene.obstacles}
    for index, one in enumerate(attached):
        if isinstance(one.obstacle, HalfSpace):
            raise MalformedRequest(f"`attached_objects[{index}]` is a half-space: nothing can hold it")
        if one.obstacle.name in taken:
            raise UnknownObject(
                f"`attached_objects[{index}]`, {one.obstacle.name!r}, is an obstacle of the scene too: remove it there",
                object=one.obstacle.name,
            )
    return _made(robot, msgspec.msgpack.encode(attached))


@functools.lru_cache(maxsize=32)
def _made(robot: RobotModel, attached: bytes) -> RobotModel:
    objects = msgspec.msgpack.decode(attached, type=list[AttachedObject])
    return with_held(robot, [_held(one, index) for index, one in enumerate(objects)])


def _held(one: AttachedObject, index: int) -> Held:
    try:
        body = obstacle.build(one.obstacle, index)
    except SceneInvalid as error:
        raise SceneInvalid(f"`attached_objects[{index}]`: {error.message}", **error.details) from None
    placement = se3(one.placement.position, one.placement.quaternion_xyzw) * body.placement
    shape = body.shape
    if body.cloud is not None:
        if len(body.cloud.points) > MOST_IN_BODIES:
            raise SceneInvalid(
                f"`attached_objects[{index}]`: a cloud that is held may have {MOST_IN_BODIES} points,"
                f" not {len(body.cloud.points)}: thin it out"
            )
        shape = bvh(body.vertices, body.triangles)
    warnings = tuple(f"`attached_objects[{index}]`, {warning}" for warning in body.warnings)
    return Held(one.obstacle.name, shape, placement, one.link, tuple(one.touch_links), warnings)
