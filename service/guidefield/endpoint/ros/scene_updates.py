"""Apply messages to a snapshot of robot and scene, as MoveIt does: PlanningScene, RobotState and JointState.

A message counts as a whole or, refused, not at all: each function returns another snapshot and changes none.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import pinocchio as pin

from guidefield.endpoint.ros.collision_objects import SceneObject, checked_id, frames_of, shapes_of
from guidefield.endpoint.ros.refusals import FrameRefused, ObjectRefused, Refused, StateRefused, number, placement
from guidefield.endpoint.ros.snapshot import AttachedThing, Matrix, Snapshot

ADD, REMOVE, APPEND, MOVE = range(4)  # operations of a CollisionObject: numbers of moveit_msgs
MOST_OBJECTS = 10_000  # number of objects in a scene


def apply_scene(before: Snapshot, message: Any) -> Snapshot:
    """Return robot and scene after a PlanningScene, which changes them if `is_diff`, else replaces them.

    Raises Refused if something in it isn't served; then nothing of it counts.
    """
    _require_served(message)
    after = before
    if not message.is_diff:
        after = dataclasses.replace(after, objects={}, colors={})
    if message.name:
        after = dataclasses.replace(after, name=message.name)
    matrix = message.allowed_collision_matrix
    if not message.is_diff or matrix.entry_names or matrix.default_entry_names:
        after = dataclasses.replace(after, matrix=Matrix.read(matrix, "allowed_collision_matrix"))
    colors = {color.id: color.color for color in message.object_colors}
    after = dataclasses.replace(after, colors={**after.colors, **colors})
    state = message.robot_state
    if state.joint_state.name or state.attached_collision_objects or not message.is_diff:
        after = with_state(after, state, "robot_state")
    for index, one in enumerate(message.world.collision_objects):
        after = _with_object(after, one, f"world.collision_objects[{index}]")
    if len(after.objects) + len(after.held) > MOST_OBJECTS:
        raise ObjectRefused(f"`world.collision_objects`: at most {MOST_OBJECTS} are kept")
    return after


def with_state(before: Snapshot, state: Any, where: str) -> Snapshot:
    """Return robot and scene with a moveit_msgs/RobotState: joints that it leaves out keep their values.

    If the message is a diff, it changes the held objects, else it replaces them; an empty state changes nothing. Raises
    Refused if a joint, a link or an object in it isn't served.
    """
    if not state.is_diff and not state.joint_state.name and not state.attached_collision_objects:
        _require_single(state, where)
        return before
    positions = _positions(before, state, where)
    after = _with_positions(before, positions)
    if not state.is_diff:
        after = dataclasses.replace(after, held={})
    for index, one in enumerate(state.attached_collision_objects):
        at = f"{where}.attached_collision_objects[{index}]"
        if not state.is_diff and one.object.operation != ADD:
            raise ObjectRefused(f"`{at}.object.operation` must be ADD where `{where}.is_diff` is false")
        after = _with_held(after, one, at)
    return after


def apply_joint_state(before: Snapshot, message: Any) -> Snapshot:
    """Return robot and scene after a sensor_msgs/JointState; unknown joints and mimic joints are ignored.

    Raises Refused if a value isn't finite.
    """
    values = zip(message.name, message.position.tolist(), strict=False)
    known = {name: number(value, "position") for name, value in values if name in before.robot.joints}
    return _with_positions(before, {**before.positions, **known})


def _with_positions(before: Snapshot, positions: Mapping[str, float]) -> Snapshot:
    return dataclasses.replace(before, positions=positions, _places={})


def _require_single(state: Any, where: str) -> None:
    if state.multi_dof_joint_state.joint_names:
        raise StateRefused(f"`{where}.multi_dof_joint_state` isn't served: the robot has joints of one coordinate")


def _positions(before: Snapshot, state: Any, where: str) -> dict[str, float]:
    _require_single(state, where)
    names, values = state.joint_state.name, state.joint_state.position.tolist()
    if len(names) != len(values):
        raise StateRefused(
            f"`{where}.joint_state.position` must have a value for each name, {len(names)}, got {len(values)}"
        )
    robot, found = before.robot, dict(before.positions)
    for name, value in zip(names, values, strict=True):
        field = f"{where}.joint_state.position of {name[:64]}"
        if name in robot.joints:
            found[name] = number(value, field, StateRefused)
        elif name not in robot.followers:
            joints = ", ".join([*robot.joints, *robot.followers])
            raise StateRefused(f"`{where}.joint_state.name` {name[:64]!r} is no joint of {robot.name}: {joints}")
    return found


def _with_object(before: Snapshot, message: Any, where: str) -> Snapshot:
    if message.operation == REMOVE:
        return _without(before, message.id, where)
    name = checked_id(message.id, where)
    if message.operation == MOVE:
        return _with_moved(before, message, name, where)
    if message.operation not in (ADD, APPEND):
        raise ObjectRefused(f"`{where}.operation` {message.operation} is unknown")
    there, _ = before.frame(message.header.frame_id, f"{where}.header.frame_id")
    thing = _thing(message, there, where)
    present = before.objects.get(name)
    if message.operation == APPEND and present is not None:
        thing = _appended(present, thing)
    return dataclasses.replace(before, objects={**before.objects, name: thing})


def _thing(message: Any, frame: Any, where: str) -> SceneObject:
    shapes = shapes_of(message, where)
    if not shapes:
        raise ObjectRefused(f"`{where}` has no primitives, meshes or planes")
    pose = placement(message.pose, f"{where}.pose")
    if len(shapes) == 1 and pose == pin.SE3.Identity():
        ((shape, pose),) = shapes
        shapes = ((shape, pin.SE3.Identity()),)
    return SceneObject(frame * pose, shapes, frames_of(message, where))


def _appended(present: SceneObject, more: SceneObject) -> SceneObject:
    """Return an object with the shapes of another one too, which keep their place in the world."""
    onto = present.pose.inverse() * more.pose
    shapes = tuple((shape, onto * there) for shape, there in more.shapes)
    return dataclasses.replace(present, shapes=(*present.shapes, *shapes))


def _without(before: Snapshot, name: str, where: str) -> Snapshot:
    if not name:
        return dataclasses.replace(before, objects={})
    if name not in before.objects:
        raise ObjectRefused(f"`{where}.id` {name[:64]!r} is no object of the scene")
    return dataclasses.replace(before, objects={id_: one for id_, one in before.objects.items() if id_ != name})


def _with_moved(before: Snapshot, message: Any, name: str, where: str) -> Snapshot:
    if name not in before.objects:
        raise ObjectRefused(f"`{where}.id` {name[:64]!r} is no object of the scene")
    for field in ("primitives", "primitive_poses", "meshes", "mesh_poses", "planes", "plane_poses"):
        if getattr(message, field):
            raise ObjectRefused(f"`{where}.{field}` must be empty where an object is moved: give `pose`")
    there, _ = before.frame(message.header.frame_id, f"{where}.header.frame_id")
    pose = there * placement(message.pose, f"{where}.pose")
    moved = dataclasses.replace(before.objects[name], pose=pose)
    return dataclasses.replace(before, objects={**before.objects, name: moved})


def _with_held(before: Snapshot, message: Any, where: str) -> Snapshot:
    if message.object.operation == REMOVE:
        return _let_go(before, message, where)
    if message.object.operation not in (ADD, APPEND):
        raise ObjectRefused(f"`{where}.object.operation` must be ADD, APPEND or REMOVE for what is held")
    name = checked_id(message.object.id, f"{where}.object")
    link = before.robot.require_link(message.link_name, f"{where}.link_name")
    for touched in message.touch_links:
        before.robot.require_link(touched, f"{where}.touch_links")
    there = before.link(link)
    if message.object.primitives or message.object.meshes or message.object.planes:
        frame, _ = before.frame(message.object.header.frame_id, f"{where}.object.header.frame_id")
        thing = _thing(message.object, there.inverse() * frame, f"{where}.object")
    elif name in before.objects:
        thing = dataclasses.replace(before.objects[name], pose=there.inverse() * before.objects[name].pose)
    else:
        raise ObjectRefused(f"`{where}.object` has no shapes, and the scene has no {name[:64]!r}")
    present = before.held.get(name)
    if message.object.operation == APPEND and present is not None and present.link == link:
        thing = _appended(present.thing, thing)
    held = {**before.held, name: AttachedThing(link, thing, tuple(message.touch_links))}
    objects = {id_: one for id_, one in before.objects.items() if id_ != name}
    return dataclasses.replace(before, objects=objects, held=held)


def _let_go(before: Snapshot, message: Any, where: str) -> Snapshot:
    """Release held objects into the scene, where one of the same name stays."""
    name, link = message.object.id, message.link_name
    gone = [id_ for id_, one in before.held.items() if name in ("", id_) and link in ("", one.link)]
    if not gone and name:
        raise ObjectRefused(f"`{where}.object.id` {name[:64]!r} isn't held")
    objects = dict(before.objects)
    for id_ in gone:
        one = before.held[id_]
        objects.setdefault(id_, dataclasses.replace(one.thing, pose=before.link(one.link) * one.thing.pose))
    held = {id_: one for id_, one in before.held.items() if id_ not in gone}
    return dataclasses.replace(before, objects=objects, held=held)


def _require_served(message: Any) -> None:
    if message.fixed_frame_transforms:
        raise FrameRefused("`fixed_frame_transforms` isn't served: use the root's frame")
    if len(message.world.octomap.octomap.data):
        raise Refused("`world.octomap` isn't served: send a mesh or boxes")
    for index, padding in enumerate(message.link_padding):
        if padding.padding != 0.0:
            raise Refused(f"`link_padding[{index}].padding` must be 0, got {padding.padding}")
    for index, scale in enumerate(message.link_scale):
        if scale.scale != 1.0:
            raise Refused(f"`link_scale[{index}].scale` must be 1, got {scale.scale}")
