"""A planning group as the judge of streams knows it, and as balls for planning."""

from __future__ import annotations

from typing import Any

import numpy as np

from guidefield.errors import MalformedRequest
from guidefield.kernels.kinematics.group_joints import joint_places
from guidefield.kernels.stream.judge import JudgedRobot
from guidefield.kernels.stream.room import RoomRobot
from guidefield.robot.bodies.convex_parts import convex_parts
from guidefield.robot.bodies.sphere_cover import coverage
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.joint_table import group_joints
from guidefield.stream.shapes import Convexes, convex_of, polytope, solids_of
from guidefield.stream.views import read_only_views

MOST_PARTS = 8
"""Most parts of a mesh, which stand for it: nothing asks its triangles."""


def require_one_axis(group: PlanningGroup) -> None:
    """Require that each joint of a group's model turns about one axis or slides along one.

    Raises:
        MalformedRequest: if one doesn't.
    """
    for joint, name in zip(group.model.joints[1:], list(group.model.names)[1:], strict=True):
        if joint.nv != 1:
            raise MalformedRequest(
                f"a stream isn't served for joint {name!r}, which has {joint.nv} degrees of freedom: only for joints"
                " that turn about one axis or slide along one; leave it out of the `group`",
                unserved="group",
                joint=name,
            )


def judged_robot(group: PlanningGroup, own: np.ndarray) -> JudgedRobot:
    """The robot for the judge.

    Args:
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
        bodies.append([_transform(one, shape.placement) for one in solids])
    counts = [len(one) for one in bodies]
    solids_table = solids_of([solid for one in bodies for solid in one])
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    robot = JudgedRobot(
        joints=group_joints(group),
        carriers=np.array([shape.parentJoint for shape in shapes], np.int64),
        balls=np.ascontiguousarray(solids_table.balls[first[:-1]]),
        first=first,
        own=np.ascontiguousarray(own, np.int64).reshape(-1, 2),
        solids=solids_table,
    )
    return read_only_views(robot)


def _transform(solid: Convexes, placement: Any) -> Convexes:
    points = solid.points @ placement.rotation.T + placement.translation
    return Convexes(solid.count, points, solid.disc, solid.axis @ placement.rotation.T, solid.rounding)


def room_robot(group: PlanningGroup) -> RoomRobot:
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
    joints = group_joints(group)
    robot = RoomRobot(
        joints=joints,
        carriers=np.array(carriers, np.int64),
        bounds=np.array(bounds).reshape(-1, 4),
        first=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        balls=np.concatenate(balls),
        places=joint_places(joints),
    )
    return read_only_views(robot)


def _balls(balls: np.ndarray, placement: Any) -> np.ndarray:
    """Balls (n, 4) of a shape's frame in that of its joint."""
    return np.column_stack([balls[:, :3] @ placement.rotation.T + placement.translation, balls[:, 3]])
