"""The robot as a value: Pinocchio's model with its joints and frames, the collision geometry that counts, and limits.

Links and joints may share a name, and then the link's frame is meant. A model whose joints are turned, replaced or
locked keeps the indices of its frames.

Lengths that were chosen (margins, steps, spacings) are stated for a usual arm, and scale with a robot's size. A Panda,
a UR5, a Fetch and a Baxter reach 1.1 to 1.5 m: all lengths were chosen with them. So robots of about their reach have
the size 1, to the last bit; others the ratio of their reach to a usual one. What a user gives, and what is promised in
metres, stays as it is. Other numbers of what is usual make other motions, and other hulls and tested pairs;
they are in docs/robots.md, "Size".
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.errors import RobotInvalid, UnknownFrame
from guidefield.geometry.cache import Arrays
from guidefield.kernels.kinematics.forward_kinematics import (
    CONTINUOUS,
    FLOATING,
    PLANAR,
    PRISMATIC,
    REVOLUTE,
    SPHERICAL,
    JointTable,
)
from guidefield.robot.model.joints import Joint, RobotConfiguration

ROOT_JOINT = "root_joint"  # name of the joint by which a robot moves in the world, unless its root is fixed

NO_GEOMETRY = "has no collision geometry, so nothing can be said about collisions"
"""The fault of a robot that is good for kinematics alone."""

USUAL_REACH = 1.15  # reach of a robot of size 1 [m]

LEAST_USUAL, MOST_USUAL = 0.75, 2.5
"""Robots that reach no less and no more than this have that size, too [m]: those that lengths were chosen with."""

USUAL_RADIUS, LEAST_RADIUS, MOST_RADIUS = 0.25, 0.05, 1.0
"""For robots of which nothing but the root turns, such as a gantry, a box that slides or one that flies, the same three
numbers of the radius of the largest moving body [m]: how far they go is no matter of their size."""

POINT_EXTENT = 1e-5  # robots that extend less far are points, as bodies of size zero are, and have the size 1 [m]

MARGIN = 2e-3
"""Margin that the planner keeps beyond the requested clearance [m], at size 1.

It is 200 times the certificate's resolution, and next to nothing of free space. With it the certificate refuses a tenth
as many of a tree's shortened paths as without, because shortcuts end where they graze something and samples overlook
corners; paths are 0.5 % longer (`tools/bench connect`). It holds for steps of the guided planner, motions among moving
obstacles, and links that are in contact at the stated rest. `least_floor` of `planner/optimize/settings.py`, the lowest
clearance of the optimiser, has the same value written out, and so has service/docs/algorithm.md.
"""

NEARLY_ALONG_X = 0.9
"""If a planar joint's axis has more of x, its plane is spanned from y: the same in docs/robots.md and the referee."""

FREE = ("JointModelPlanar", "JointModelFreeFlyer")  # Pinocchio's names of joints that turn a whole robot

CODES = {
    "JointModelPlanar": PLANAR,
    "JointModelSpherical": SPHERICAL,
    "JointModelFreeFlyer": FLOATING,
    "JointModelRevoluteUnaligned": REVOLUTE,
    "JointModelRevoluteUnboundedUnaligned": CONTINUOUS,
    "JointModelPrismaticUnaligned": PRISMATIC,
    **{f"JointModelR{axis}": REVOLUTE for axis in "XYZ"},
    **{f"JointModelRUB{axis}": CONTINUOUS for axis in "XYZ"},
    **{f"JointModelP{axis}": PRISMATIC for axis in "XYZ"},
}
"""Kind of joint, as the kernels have it, by Pinocchio's name of it."""


def joint_table(model: Any) -> JointTable:
    """Build the kernels' tables of a model's joints, in its order; row 0 is the world."""
    n = model.njoints
    parents, kinds, idx_q, idx_v, nv = (np.zeros(n, np.int64) for _ in range(5))
    axes, placements = np.zeros((n, 3)), np.zeros((n, 3, 4))
    for index in range(1, n):
        joint = model.joints[index]
        short = joint.shortname()
        parents[index], kinds[index] = model.parents[index], CODES[short]
        idx_q[index], idx_v[index], nv[index] = joint.idx_q, joint.idx_v, joint.nv
        axes[index] = axis_of(joint) if joint.nv == 1 else 0.0
        placement: pin.SE3 = model.jointPlacements[index]
        placements[index] = np.c_[placement.rotation, placement.translation]
    for array in (parents, kinds, axes, placements, idx_q, idx_v, nv):
        array.setflags(write=False)
    return JointTable(parents, kinds, axes, placements, idx_q, idx_v, nv)


def axis_of(joint: Any) -> np.ndarray:
    """Return the axis of a Pinocchio joint with one degree of freedom, shape (3,)."""
    data = joint.createData()
    joint.calc(data, np.zeros(joint.idx_q + joint.nq))
    subspace = np.asarray(data.S, float).ravel()
    axis: np.ndarray = subspace[:3] if np.any(subspace[:3]) else subspace[3:]
    return axis


def joint_indices(model: Any) -> dict[str, int]:
    """Return Pinocchio's index of each joint by name, but of the world, which it calls `universe`."""
    return {name: index for index, name in enumerate(model.names) if index}


def frame_index(model: Any, name: str) -> int | None:
    """Return Pinocchio's index of a link's frame, else of any other frame of that name; None if there is none."""
    if model.existFrame(name, pin.FrameType.BODY):
        return int(model.getFrameId(name, pin.FrameType.BODY))
    for index, frame in enumerate(model.frames):
        if frame.name == name and index:
            return index
    return None


def moving_joint(model: Any, name: str) -> int:
    """Return the index of the joint that moves a frame; 0 if it stands still or there is none of that name."""
    index = frame_index(model, name)
    return 0 if index is None else int(model.frames[index].parentJoint)


def joints_to(model: Any, frame: str) -> list[str]:
    """Return the names of the joints between the root and a frame, from the root on."""
    return [model.names[index] for index in model.supports[moving_joint(model, frame)] if index]


@dataclass(frozen=True)
class PairLeftOut:
    """Two links that are never tested against each other, and why."""

    links: tuple[str, str]
    reason: str


@dataclass(frozen=True)
class GeometryChoice:
    """The form in which a collision shape is tested."""

    name: str  # `<link>_<number>`
    link: str
    shape: str  # the URDF's: box, cylinder, sphere, mesh
    judged_as: str  # primitive, convex hull or triangle mesh
    stand_off: float = 0.0  # how far the hull stands off the mesh [m]; 0 for a primitive


@dataclass(frozen=True)
class RobotSource:
    """Where a robot came from."""

    urdf_text: str  # its text; once loaded, with meshes as absolute paths. Of an MJCF, the URDF that was made from it
    urdf_path: Path | None
    root_joint: str = "fixed"
    files: tuple[Path, ...] = ()  # files that the text was made from, beside those that it names


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A robot, frozen after loading."""

    name: str  # its name in the catalog, or the URDF's own
    model: Any  # pinocchio model of every joint (mimic joints are joints of their own here)
    geometry: Any  # collision geometry with the pairs of links that count
    joints: tuple[Joint, ...]  # movable joints, and link names, in Pinocchio's order
    links: tuple[str, ...]
    tip: str  # frame that goals and guide planes are about, unless a request says otherwise
    groups: Mapping[str, tuple[str, ...]]  # named sets of joints, from the SRDF
    rest: RobotConfiguration  # configuration, shape (model.nq,), of joints that a request leaves out
    geometry_choices: tuple[GeometryChoice, ...]  # the form in which each shape is tested, in the geometry's order
    pairs_left_out: tuple[PairLeftOut, ...]
    warnings: tuple[str, ...]  # what was odd but harmless, for every reply about it
    source: RobotSource
    # the same about a robot that comes with guidefield, reported by its description alone: its users can't mend it
    remarks: tuple[str, ...] = ()
    rest_state: str | None = None  # name of the SRDF's state that it is, as far as that goes
    held: tuple[str, ...] = ()  # names of the links that are objects it holds
    # its reach over a usual one, or 1 where that is usual: factor on the lengths that are chosen "at size 1"
    size: float = 1.0

    def joint(self, name: str) -> Joint | None:
        """Return the movable joint of that name, or None."""
        return self._joints_by_name.get(name)

    @cached_property
    def _joints_by_name(self) -> dict[str, Joint]:
        return {joint.name: joint for joint in reversed(self.joints)}

    def require_collision_geometry(self) -> None:
        """Refuse, by RobotInvalid, to speak about collisions of a robot without collision geometry."""
        if not self.geometry_choices:
            raise RobotInvalid(f"robot {self.name!r} {NO_GEOMETRY}", robot=self.name)

    def link_of_geometry(self, index: int) -> str:
        """Return the name of the link that a collision shape belongs to."""
        return self.geometry_choices[index].link

    def frame_id(self, name: str) -> int:
        """Return Pinocchio's index of a frame; UnknownFrame, with those there are, if there is none of that name."""
        index = self._frame_ids.get(name)
        if index is None:
            index = frame_index(self.model, name)
        if index is None:
            frames = [frame.name for frame in self.model.frames][1:]
            raise UnknownFrame(
                f"robot {self.name!r} has no frame {name!r}; it has {', '.join(frames)}", frame=name, available=frames
            )
        self._frame_ids[name] = index
        return index

    @cached_property
    def joint_table(self) -> JointTable:
        """The joints as kernels read them."""
        return joint_table(self.model)

    @cached_property
    def _frame_ids(self) -> dict[str, int]:
        """Frame indices by name, as far as they were needed: Pinocchio searches all frames for one."""
        return {}


def with_joints(model: Any, replacements: Mapping[int, Any]) -> Any:
    """Return the same Pinocchio model with joints replaced by index; the indices of joints and frames stay the same.

    Limits are kept where a joint has as many values as before; what replaces another has no limits of positions else.
    """
    if not replacements:
        return model
    made, _ = _rebuild(model, replacements, (), pin.neutral(model))
    return made


def lock_joints(model: Any, geometry: Any, locked: Collection[int], q: np.ndarray) -> tuple[Any, Any]:
    """Return the models with some joints, by index, fixed at a configuration, shape (model.nq,).

    Frames keep their indices and names; joints keep their order. `pinocchio.buildReducedModel` does the same, but finds
    frames by name.
    """
    if not locked:
        return model, geometry
    made, places = _rebuild(model, {}, locked, q)
    reduced = geometry.copy()
    for shape in reduced.geometryObjects:
        parent, offset = places[shape.parentJoint]
        shape.parentJoint, shape.placement = parent, offset * shape.placement
    return made, reduced


def _rebuild(
    model: Any, replacements: Mapping[int, Any], locked: Collection[int], q: np.ndarray
) -> tuple[Any, list[tuple[int, Any]]]:
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    made = pin.Model()
    made.name = model.name
    kept: list[tuple[Any, Any]] = []
    places: list[tuple[int, Any]] = [(0, pin.SE3.Identity())]
    for index in range(1, model.njoints):
        parent, offset = places[model.parents[index]]
        if index in locked:
            places.append((parent, offset * data.liMi[index]))
        else:
            joint = replacements.get(index) or model.joints[index].extract()
            parent = made.addJoint(parent, joint, offset * model.jointPlacements[index], model.names[index])
            kept.append((model.joints[index], made.joints[parent]))
            places.append((parent, pin.SE3.Identity()))
        made.appendBodyToJoint(places[index][0], model.inertias[index], places[index][1])
    for number, frame in enumerate(list(model.frames)[1:]):
        parent, offset = places[frame.parentJoint]
        # under a name of its own, as Pinocchio merges frames that share name and type
        copied = pin.Frame(f"frame {number}", parent, frame.parentFrame, offset * frame.placement, frame.type)
        made.frames[made.addFrame(copied, False)].name = frame.name
    _copy_limits(model, made, kept)
    return made, places


def _copy_limits(source: Any, target: Any, kept: Sequence[tuple[Any, Any]]) -> None:
    for name, none in (("lowerPositionLimit", -math.inf), ("upperPositionLimit", math.inf)):
        limits = getattr(source, name)
        parts = [
            limits[joint.idx_q : joint.idx_q + joint.nq] if joint.nq == copied.nq else np.full(copied.nq, none)
            for joint, copied in kept
        ]
        setattr(target, name, np.concatenate([np.empty(0), *parts]))
    for name in ("lowerVelocityLimit", "upperVelocityLimit", "lowerEffortLimit", "upperEffortLimit"):
        limits, none = getattr(source, name), -math.inf if name == "lowerEffortLimit" else math.inf
        parts = [
            limits[joint.idx_v : joint.idx_v + joint.nv] if joint.nv == copied.nv else np.full(copied.nv, none)
            for joint, copied in kept
        ]
        setattr(target, name, np.concatenate([np.empty(0), *parts]))


def with_ball_joints(name: str, model: Any, marked: Collection[str]) -> Any:
    """Replace marked floating joints, which only turn, by spherical ones in a Pinocchio model; indices stay the same.

    RobotInvalid if a marked joint doesn't exist or isn't floating.
    """
    indices = joint_indices(model)
    for joint in marked:
        if joint not in indices:
            raise RobotInvalid(f"robot {name!r} has no joint {joint!r}, which its card marks as a ball", joint=joint)
        if model.joints[indices[joint]].shortname() != "JointModelFreeFlyer":
            raise RobotInvalid(f"robot {name!r}: joint {joint!r} is marked as a ball but isn't floating", joint=joint)
    return with_joints(model, {indices[joint]: pin.JointModelSpherical() for joint in marked})


def plane_rotation(axis: np.ndarray) -> np.ndarray:
    """Return the rotation (3, 3) from a planar joint's own axes (first, second, normal) to the joint's frame.

    The normal is the joint's axis (3,), of any length but zero. The first axis is the frame's x axis projected into the
    plane, or its y axis where the normal is nearly along x; the second completes a right-handed frame.
    """
    normal = axis / np.abs(axis).max()
    normal = normal / np.linalg.norm(normal)
    start = np.eye(3)[0 if abs(normal[0]) <= NEARLY_ALONG_X else 1]
    first = start - (start @ normal) * normal
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(normal, first), normal]) + 0.0


def set_planar_axes(model: Any, geometry: Any | None, axes: Mapping[int, np.ndarray]) -> None:
    """Let planar joints move, in place, in the plane normal to their axis (3,), by index, and turn about it.

    The joint's own frame is turned so that its z axis is the joint's axis. What the joint carries is turned back, so
    that links, frames and shapes stay where the URDF has them.
    """
    for index, axis in axes.items():
        turn = pin.SE3(plane_rotation(axis), np.zeros(3))
        if turn.isIdentity(0.0):
            continue
        back = turn.inverse()
        model.jointPlacements[index] = model.jointPlacements[index] * turn
        model.inertias[index] = back.act(model.inertias[index])
        for child in range(1, model.njoints):
            if model.parents[child] == index:
                model.jointPlacements[child] = back * model.jointPlacements[child]
        for carried in (*model.frames, *(geometry.geometryObjects if geometry is not None else ())):
            if carried.parentJoint == index:
                carried.placement = back * carried.placement


def find_size(model: Any, geometry: Any, meshes: Mapping[str, np.ndarray]) -> float:
    """Return the size of a robot: 1 where its reach is usual, else the ratio of its reach to `USUAL_REACH`.

    `meshes` are vertices (v, 3) [m] of the shapes that stand for meshes, in their own frames, by name.
    """
    names = [joint.shortname() for joint in model.joints]
    if all(name in FREE or name.startswith("JointModelP") for name in names[1:]):
        corners = [_find_corners(shape, meshes) for shape in geometry.geometryObjects if shape.parentJoint > 0]
        radius = max((0.5 * float(np.linalg.norm(np.ptp(one, axis=0))) for one in corners), default=0.0)
        return 1.0 if radius < POINT_EXTENT or LEAST_RADIUS <= radius <= MOST_RADIUS else radius / USUAL_RADIUS
    reach = _find_reach(model, geometry, meshes)
    return 1.0 if reach < POINT_EXTENT or LEAST_USUAL <= reach <= MOST_USUAL else reach / USUAL_REACH


def _find_reach(model: Any, geometry: Any, meshes: Mapping[str, np.ndarray]) -> float:
    """Return how far a robot extends at most from the first joint of a chain that turns [m]."""
    along, turns = np.zeros(model.njoints), np.zeros(model.njoints, bool)
    for joint in range(1, model.njoints):
        parent, name = model.parents[joint], model.joints[joint].shortname()
        turns[joint] = turns[parent] or name in FREE or not name.startswith("JointModelP")
        if turns[parent]:
            along[joint] = along[parent] + np.linalg.norm(model.jointPlacements[joint].translation)
    reach = 0.0
    for frame in model.frames:
        if turns[frame.parentJoint]:
            reach = max(reach, float(along[frame.parentJoint] + np.linalg.norm(frame.placement.translation)))
    for shape in geometry.geometryObjects:
        if turns[shape.parentJoint]:
            placed = _find_corners(shape, meshes) @ shape.placement.rotation.T + shape.placement.translation
            reach = max(reach, float(along[shape.parentJoint] + np.linalg.norm(placed, axis=1).max()))
    return reach


def _find_corners(shape: Any, meshes: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the corners (8, 3) of the box about a shape along the axes of its own frame [m]."""
    if shape.name in meshes:
        low, high = meshes[shape.name].min(axis=0), meshes[shape.name].max(axis=0)
    else:
        shape.geometry.computeLocalAABB()
        low, high = shape.geometry.aabb_local.min_, shape.geometry.aabb_local.max_
    return np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)


def scale(arrays: Arrays, factor: float, *names: str) -> Arrays:
    """Return arrays of which some, by name, are multiplied by a factor; they themselves if that is 1."""
    return arrays if factor == 1.0 else {**arrays, **{name: factor * arrays[name] for name in names}}


def power_of_two(size: float) -> float:
    """Return the power of two next to a size: lengths are divided and multiplied by it without rounding."""
    return float(np.exp2(np.round(np.log2(size))))
