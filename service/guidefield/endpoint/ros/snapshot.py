"""Robot and scene as ROS nodes described them at one moment, and how messages change them as in MoveIt.

A snapshot is an immutable value, of which the newest is kept: each request that is read gets one, so that later
messages don't change what it is about. A PlanningScene, RobotState or JointState counts as a whole or, refused, not at
all: each function returns another snapshot and changes none.
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import combinations
from types import MappingProxyType
from typing import Any

import msgspec
import pinocchio as pin

from guidefield.endpoint.ros.collision_objects import SceneObject, checked_id, frames_of, shapes_of
from guidefield.endpoint.ros.refusals import (
    FrameRefused,
    LinkRefused,
    ObjectRefused,
    Refused,
    StateRefused,
    number,
    placement,
)
from guidefield.errors import RobotInvalid, Status
from guidefield.geometry.surfaces import wire_pose
from guidefield.messages.conditions import AttachedObject
from guidefield.messages.scene import HalfSpace, Scene
from guidefield.messages.values import Placement
from guidefield.robot.model.configuration import configuration_from_wire, configuration_to_wire
from guidefield.robot.model.joints import Joint
from guidefield.robot.model.model import RobotModel

WORLD = "world"  # a name of the root's frame, in which obstacles are, unless the robot has a link of that name


class KnownRobot:
    """A robot as messages of ROS name it.

    Raises RobotInvalid if a joint has several coordinates, which these messages have no place for.
    """

    def __init__(self, name: str, model: RobotModel) -> None:
        several = [joint.name for joint in model.joints if joint.nv > 1]
        if several:
            raise RobotInvalid(f"over ROS robots with joints of one coordinate are served; {name!r} has {several[0]!r}")
        self.name = name
        self.model = model
        self.joints: dict[str, Joint] = {joint.name: joint for joint in model.joints if joint.mimic is None}
        self.mimics = {joint.name: joint for joint in model.joints if joint.mimic is not None}
        self.links = tuple(model.links)
        self.root = self.links[0]
        rest = configuration_to_wire(model.joints, model.rest)
        self.rest = {joint: float(rest[joint]) for joint in self.joints}  # type: ignore[arg-type]

    def group(self, name: str) -> list[str]:
        """Return the joints of a group; raises Refused if there is none of that name."""
        if name not in self.model.groups:
            groups = ", ".join(self.model.groups) or "no group"
            raise Refused(f"`group_name` {name[:64]!r} is unknown; there is {groups}", Status.INVALID_GROUP_NAME)
        return list(self.model.groups[name])

    def require_link(self, name: str, field: str) -> str:
        """Return the name itself, if it is a link's; else raise Refused."""
        if name not in self.links:
            raise LinkRefused(f"`{field}` {name[:64]!r} is no link of {self.name}: {', '.join(self.links)}")
        return name

    def is_root(self, frame: str) -> bool:
        """Return whether a frame is the world's: an empty name, the root link, or `WORLD`."""
        return frame in ("", self.root) or (frame == WORLD and WORLD not in self.links)

    def moves(self, link: str, joints: Iterable[str]) -> bool:
        """Return whether a link moves when some joints do, with their mimic joints."""
        driven = set(joints)
        driven |= {name for name, one in self.mimics.items() if one.mimic is not None and one.mimic.source in driven}
        model = self.model.model
        above = list(model.supports[model.frames[self.model.frame_id(link)].parentJoint])
        return any(model.names[joint] in driven for joint in above if joint)

    def placements(self, positions: Mapping[str, float], links: Iterable[str]) -> list[Any]:
        """Return links' places in the world, pinocchio.SE3 each, at joint values by name [rad or m]."""
        model = self.model.model
        data = model.createData()
        pin.forwardKinematics(model, data, configuration_from_wire(self.model, dict(positions)))
        return [pin.SE3(pin.updateFramePlacement(model, data, self.model.frame_id(link))) for link in links]

    def limits(self, joint: str) -> tuple[float, float]:
        """Return the least and the largest value of a joint [rad or m]; infinite if it has no limits."""
        one = self.joints[joint]
        lower, upper = float(one.lower[0]), float(one.upper[0])
        return (lower, upper) if math.isfinite(lower) and math.isfinite(upper) else (-math.inf, math.inf)


MOST_NAMES = 2_000  # names in a matrix, whose square reading takes; `MOST_BYTES` of a payload admits about 2,890


@dataclass(frozen=True)
class Matrix:
    """An allowed collision matrix, by names of links and objects."""

    pairs: MappingProxyType[frozenset[str], bool]  # whether two may touch
    defaults: MappingProxyType[str, bool]  # whether one may touch those without an entry in `pairs`

    @classmethod
    def read(cls, message: Any, where: str) -> Matrix:
        """Read a moveit_msgs/AllowedCollisionMatrix; raises Refused if it isn't square."""
        names, rows = message.entry_names, message.entry_values
        alone, allowed = message.default_entry_names, message.default_entry_values
        if len(names) > MOST_NAMES:
            raise Refused(f"`{where}.entry_names` has {len(names)} names, at most {MOST_NAMES} are read")
        if len(rows) != len(names):
            raise Refused(f"`{where}.entry_values` must have a row for each name, {len(names)}, got {len(rows)}")
        for index, row in enumerate(rows):
            if len(row.enabled) != len(names):
                many = f"{len(names)} values, got {len(row.enabled)}"
                raise Refused(f"`{where}.entry_values[{index}].enabled` must have {many}")
        if len(alone) != len(allowed):
            raise Refused(f"`{where}.default_entry_values` must have {len(alone)} values, got {len(allowed)}")
        pairs = {
            frozenset((names[i], names[j])): bool(rows[i].enabled[j]) for i, j in combinations(range(len(names)), 2)
        }
        defaults = dict(zip(alone, map(bool, allowed), strict=True))
        return cls(MappingProxyType(pairs), MappingProxyType(defaults))

    def allows(self, first: str, second: str) -> bool:
        """Return whether two may touch; without an entry, if the defaults of those that have one allow it."""
        pair = self.pairs.get(frozenset((first, second)))
        if pair is not None:
            return pair
        known = [self.defaults[name] for name in (first, second) if name in self.defaults]
        return bool(known) and all(known)

    def allowed(self, names: Collection[str]) -> list[tuple[str, str]]:
        """Return the pairs of some names that may touch."""
        if not any(self.defaults.values()):
            there = set(names)
            some = (tuple(sorted(pair)) for pair, may in self.pairs.items() if may and pair <= there)
            return sorted((pair[0], pair[1]) for pair in some if len(pair) == 2)
        return [pair for pair in combinations(sorted(names), 2) if self.allows(*pair)]

    def message(self, names: Iterable[str], left_out: Collection[frozenset[str]]) -> dict[str, Any]:
        """Return the moveit_msgs/AllowedCollisionMatrix of some names; pairs that are left out may touch, too."""
        order = sorted(names)
        rows = [[frozenset((one, other)) in left_out or self.allows(one, other) for other in order] for one in order]
        return {
            "entry_names": order,
            "entry_values": [{"enabled": row} for row in rows],
            "default_entry_names": list(self.defaults),
            "default_entry_values": list(self.defaults.values()),
        }


NONE_ALLOWED = Matrix(MappingProxyType({}), MappingProxyType({}))  # no pair may touch
SCENE = "planning_scene"  # the name of the scene in requests, each of which has the whole scene


@dataclass(frozen=True)
class AttachedThing:
    """An object that a link holds."""

    link: str
    thing: SceneObject  # its pose is in the link's frame
    touch_links: tuple[str, ...] = ()


@dataclass(frozen=True)
class Snapshot:
    """Robot and scene at one moment."""

    robot: KnownRobot
    positions: Mapping[str, float] = field(default_factory=dict)  # received values, by joint [rad or m]
    objects: Mapping[str, SceneObject] = field(default_factory=dict)  # objects of the scene, by id
    held: Mapping[str, AttachedThing] = field(default_factory=dict)  # objects that links hold, by id
    matrix: Matrix = NONE_ALLOWED
    colors: Mapping[str, Any] = field(default_factory=dict)  # of objects, as they came
    name: str = ""  # of the scene
    _places: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)  # of links, computed once

    @property
    def whole(self) -> dict[str, float]:
        """Return a value for each joint; joints whose value was never received have that of the robot's rest."""
        return {**self.robot.rest, **self.positions}

    @property
    def unheard(self) -> list[str]:
        """Return the joints whose value was never received."""
        return [joint for joint in self.robot.joints if joint not in self.positions]

    def link(self, name: str) -> Any:
        """Return a link's place in the world, pinocchio.SE3."""
        if name not in self._places:
            (self._places[name],) = self.robot.placements(self.whole, [name])
        return self._places[name]

    def frame(self, name: str, field: str) -> tuple[Any, str | None]:
        """Return a frame's place in the world, pinocchio.SE3, and the link with which it moves, None if it rests.

        Raises Refused, with the name of the `field`, if no frame has that name.
        """
        if self.robot.is_root(name):
            return pin.SE3.Identity(), None
        if name in self.robot.links:
            return self.link(name), name
        thing, _, own = name.partition("/") if name not in self.objects and name not in self.held else (name, "", "")
        found = self.held[thing].thing if thing in self.held else self.objects.get(thing)
        if found is None or (own and own not in found.frames):
            raise FrameRefused(
                f"`{field}` {name[:64]!r} is unknown: it is neither {self.robot.root!r}, a link of {self.robot.name},"
                " an object nor a named frame of one"
            )
        inside = found.pose * found.frames[own] if own else found.pose
        if thing in self.held:
            return self.link(self.held[thing].link) * inside, self.held[thing].link
        return inside, None

    def scene(self) -> Scene:
        """Return the objects as a scene of our requests; raises Refused if two shapes have the same name."""
        try:
            return Scene(SCENE, obstacles=[o for name, thing in self.objects.items() for o in thing.obstacles(name)])
        except ValueError as error:
            raise ObjectRefused(f"the planning scene: {error}") from None

    def attached(self) -> list[AttachedObject]:
        """Return held objects as our requests have them; raises Refused if one is a plane."""
        return [one for name, held in self.held.items() for one in _attached_objects(name, held)]

    def allowed(self) -> list[tuple[str, str]]:
        """Return the pairs that may touch, by names of links and obstacles."""
        shapes = {name: thing.names(name) for name, thing in self.objects.items()}
        shapes |= {name: held.thing.names(name) for name, held in self.held.items()}
        names = {link: [link] for link in self.robot.links} | shapes
        return [(a, b) for first, second in self.matrix.allowed(names) for a in names[first] for b in names[second]]


def _attached_objects(name: str, held: AttachedThing) -> Iterator[AttachedObject]:
    for (shape, there), own in zip(held.thing.shapes, held.thing.names(name), strict=True):
        if isinstance(shape, HalfSpace):
            raise ObjectRefused(f"object {name!r} has a plane: no link can hold it")
        position, quaternion = wire_pose(held.thing.pose * there)
        yield AttachedObject(
            obstacle=msgspec.structs.replace(shape, name=own),
            link=held.link,
            placement=Placement(position, quaternion),
            touch_links=list(held.touch_links),
        )


class KnownScene:
    """Holds the newest snapshot, which any thread may read or replace."""

    def __init__(self, first: Snapshot) -> None:
        self._now = first
        self._changing = threading.Lock()

    @property
    def now(self) -> Snapshot:
        """Return the newest snapshot."""
        return self._now

    def update(self, change: Callable[[Snapshot], Snapshot]) -> None:
        """Replace the snapshot by a changed one; if `change` raises, it stays."""
        with self._changing:
            self._now = change(self._now)


ADD, REMOVE, APPEND, MOVE = range(4)  # operations of a CollisionObject: numbers of moveit_msgs
MOST_OBJECTS = 10_000  # number of objects in a scene, with those that are held


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
        elif name not in robot.mimics:
            joints = ", ".join([*robot.joints, *robot.mimics])
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
        thing = _append_shapes(present, thing)
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


def _append_shapes(present: SceneObject, more: SceneObject) -> SceneObject:
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
    for shapes in ("primitives", "primitive_poses", "meshes", "mesh_poses", "planes", "plane_poses"):
        if getattr(message, shapes):
            raise ObjectRefused(f"`{where}.{shapes}` must be empty where an object is moved: give `pose`")
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
        thing = _append_shapes(present.thing, thing)
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


def _require_served(message: Any) -> None:  # what isn't refused must be applied: nothing else reads these fields
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
