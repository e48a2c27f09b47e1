"""A planning group as the judge of streams knows it, and as balls for planning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from guidefield.errors import MalformedRequest
from guidefield.kernels.kinematics.forward_kinematics import PRISMATIC
from guidefield.kernels.stream.judge import SLIDES, TURNS, JudgedRobot
from guidefield.kernels.stream.room import RoomRobot
from guidefield.robot.bodies.convex_parts import convex_parts
from guidefield.robot.bodies.sphere_cover import coverage
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.joint_tables import CODES, axis_of
from guidefield.stream.shapes import Convexes, convex_of, polytope, solids_of
from guidefield.stream.views import read_only_views

MOST_PARTS = 8
"""Most parts of a mesh, which stand for it: nothing asks its triangles."""


@dataclass(frozen=True, eq=False)
class JointRows:
    """The joints of a group's model, row 0 the world; see `JudgedRobot`."""

    parents: np.ndarray
    slides: np.ndarray
    axes: np.ndarray
    placements: np.ndarray
    drivers: np.ndarray
    multipliers: np.ndarray
    offsets: np.ndarray


def joint_rows(group: PlanningGroup) -> JointRows:
    """The joints of a group.

    Raises:
        MalformedRequest: if one neither turns about one axis nor slides along one.
    """
    model = group.model
    count = model.njoints
    parents, slides, drivers = (np.zeros(count, np.int64) for _ in range(3))
    axes, placements, multipliers, offsets = (
        np.zeros((count, 3)),
        np.zeros((count, 12)),
        np.zeros(count),
        np.zeros(count),
    )
    for index in range(1, count):
        joint = model.joints[index]
        name = model.names[index]
        if joint.nv != 1:
            raise MalformedRequest(
                f"a stream isn't served for joint {name!r}, which has {joint.nv} degrees of freedom: only for joints"
                " that turn about one axis or slide along one; leave it out of the `group`",
                unserved="group",
                joint=name,
            )
        driven = np.flatnonzero(group.expand_velocity[joint.idx_v])
        parents[index], slides[index] = model.parents[index], int(CODES[joint.shortname()] == PRISMATIC)
        axes[index] = axis_of(joint)
        placement = model.jointPlacements[index]
        placements[index] = np.column_stack([placement.rotation, placement.translation]).ravel()
        drivers[index] = driven[0]
        multipliers[index] = group.expand_velocity[joint.idx_v, driven[0]]
        offsets[index] = group.expand_offset[joint.idx_v]
    axes /= np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-300)
    return JointRows(parents, slides, axes, placements, drivers, multipliers, offsets)


def judged_robot(group: PlanningGroup, joints: JointRows, own: np.ndarray) -> JudgedRobot:
    """The robot for the judge.

    Args:
        group: The robot's planned joints.
        joints: Those.
        own: Pairs of its bodies that must not touch, shape (p, 2).
    """
    shapes = list(group.geometry.geometryObjects)
    bodies: list[list[Convexes]] = []
    for shape, cut in zip(shapes, convex_parts(group.robot, MOST_PARTS), strict=True):
        solid = convex_of(shape.geometry)
        if solid is not None:
            solids = [solid]
        elif cut is None:
            solids = [polytope(np.array(shape.geometry.vertices()))]
        else:
            hulls = [cut.hull, *(cut.parts if len(cut.parts) > 1 else ())]
            solids = [polytope(np.asarray(part.hull.vertices)) for part in hulls]
        bodies.append([_moved(one, shape.placement) for one in solids])
    counts = [len(one) for one in bodies]
    solids_table = solids_of([solid for one in bodies for solid in one])
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    robot = JudgedRobot(
        parents=joints.parents,
        kinds=np.where(joints.slides == 1, SLIDES, TURNS).astype(np.int64),
        axes=joints.axes,
        placements=joints.placements,
        drivers=joints.drivers,
        multipliers=joints.multipliers,
        offsets=joints.offsets,
        carriers=np.array([shape.parentJoint for shape in shapes], np.int64),
        balls=np.ascontiguousarray(solids_table.balls[first[:-1]]),
        first=first,
        own=np.ascontiguousarray(own, np.int64).reshape(-1, 2),
        solids=solids_table,
    )
    return read_only_views(robot)


def _moved(solid: Convexes, placement: Any) -> Convexes:
    points = solid.points @ placement.rotation.T + placement.translation
    return Convexes(solid.count, points, solid.disc, solid.axis @ placement.rotation.T, solid.rounding)


def room_robot(group: PlanningGroup, joints: JointRows) -> RoomRobot:
    """The robot as balls, for planning, with memory of its own: not for two threads."""
    shapes = list(group.geometry.geometryObjects)
    carriers, bounds, balls, counts = [], [], [np.empty((0, 4))], []
    for shape, covered in zip(shapes, coverage(group.robot).shapes, strict=True):
        if shape.parentJoint == 0:
            continue
        carriers.append(shape.parentJoint)
        bounds.append(_balls(covered.cover.bound[None], shape.placement)[0])
        balls.append(_balls(covered.cover.spheres, shape.placement))
        counts.append(len(balls[-1]))
    count = len(joints.parents)
    robot = RoomRobot(
        parents=joints.parents,
        slides=joints.slides,
        axes=joints.axes,
        placements=joints.placements,
        drivers=joints.drivers,
        multipliers=joints.multipliers,
        offsets=joints.offsets,
        carriers=np.array(carriers, np.int64),
        bounds=np.array(bounds).reshape(-1, 4),
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        balls=np.concatenate(balls),
        poses=np.zeros((count, 12)),
        lines=np.zeros((count, 6)),
    )
    return read_only_views(robot, "poses", "lines")


def _balls(balls: np.ndarray, placement: Any) -> np.ndarray:
    """Balls (n, 4) of a shape's frame in that of its joint."""
    return np.column_stack([balls[:, :3] @ placement.rotation.T + placement.translation, balls[:, 3]])
