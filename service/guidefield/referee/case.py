"""The case that the referee judges: a robot's model, bodies, a motion, its limits, and what has to be kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Screw:
    """An obstacle's motion: on a screw from each placement to the next, at rest before the first and after the last."""

    times: np.ndarray  # shape (k,), increasing [s]; k is at least 2
    stops: Sequence[Any]  # placements of the obstacle's frame in the world at those times, pinocchio.SE3
    # its velocity in itself from each to the next, (k - 1, 6), linear part first: log(T_i^-1 T_i+1) / dt
    twists: np.ndarray


@dataclass(frozen=True, eq=False)
class Body:
    """A collision shape of a link, a held object, or an obstacle."""

    name: str  # of the link, the held object or the obstacle
    joint: int  # pinocchio's index of the joint that carries it; 0 is the world
    placement: Any  # of the shape in the joint's frame, pinocchio.SE3; of an obstacle that moves, in its own frame
    exact: Any  # Coal's shape of what is declared; of a cloud tiny triangles at its points
    rounding: float  # what it is rounded by all around: the radius of a cloud's balls [m]
    # points whose hull contains the body, in the shape's frame, shape (8, 3) [m]; of a half-space, which has none,
    # zeros
    corners: np.ndarray
    # Coal's convex shapes that are said to contain the mesh, in the same frame; none where there are none
    parts: Sequence[Any]
    triangles: np.ndarray  # the mesh's triangles, shape (t, 3, 3) [m, the shape's frame]; none where it isn't a mesh
    shell: np.ndarray  # triangles that are said to be the mesh closed and turned outwards, shape (s, 3, 3); often none
    points: np.ndarray  # a point of each connected piece, shape (p, 3) [m, the shape's frame]
    obstacle: bool  # whether it is an obstacle
    screw: Screw | None = None  # how it moves, if it does so by itself


@dataclass(frozen=True, eq=False)
class Constraint:
    """A frame's axis stays within a cone, or its origin near a plane or a line."""

    name: str  # its kind and frame, for a reader
    joint: int  # pinocchio's index of the joint that carries the frame
    placement: Any  # of the frame in that joint's, pinocchio.SE3
    limit: float  # largest angle or distance [rad or m]
    axis: np.ndarray  # of a cone: unit vector in the frame, shape (3,); else zeros
    target: np.ndarray  # of a cone: unit vector in the world that the axis stays near, shape (3,); else zeros
    point: np.ndarray  # on the plane or line, shape (3,) [m, world]; of a cone zeros
    # directions in which the distance from it counts, orthonormal rows, shape (1, 3) or (2, 3); of a cone (0, 3)
    across: np.ndarray
    corners: np.ndarray  # the frame's origin in itself, eight times, shape (8, 3)
    screw: None = None


@dataclass(frozen=True, eq=False)
class Case:
    """A motion of a robot among obstacles, and what it is said to keep.

    The chart of the model has `model.nv` numbers, joint by joint in Pinocchio's order: a joint's value or unwrapped
    angle; x, y and angle of a planar joint; position and rotation vector of a floating one. With the motion's own
    columns z it is at ``spread @ z + offset``: so followers follow, and other joints stand.
    """

    model: Any  # pinocchio's model; a ball joint is a floating one that stays where it is
    spread: np.ndarray  # shape (model.nv, n)
    offset: np.ndarray  # shape (model.nv,)
    # which numbers of the chart are angles or rotation vectors of joints of several freedoms, (model.nv,)
    turning: np.ndarray
    # where `turning`, the rotation vector of the orientation from which others count, shape (model.nv,)
    turned: np.ndarray
    bodies: Sequence[Body]  # the robot's, then obstacles
    constraints: Sequence[Constraint]  # along the path
    rows: Sequence[str]  # the joint that each number of the model's chart is about
    columns: Sequence[str]  # the joint that each of the motion's columns is about
    times: np.ndarray | None  # of the knots, shape (k,) [s]; None of a path
    positions: np.ndarray  # shape (k, n) [rad or m]
    velocities: np.ndarray | None  # shape (k, n) [rad/s or m/s]; None: from knot to knot it goes straight on
    accelerations: np.ndarray | None  # shape (k, n) [rad/s² or m/s²]; None: it is cubic, or straight
    steps: bool  # whether each column may be anywhere between both knots, instead of going straight on
    tolerance: np.ndarray  # how far each column may be from that, shape (n,) [rad or m]
    lower: np.ndarray  # least values of the model's chart, shape (model.nv,); infinite where there is no limit
    upper: np.ndarray  # largest values, shape (model.nv,)
    # largest velocity, acceleration and jerk of each column of z, shape (3, n); infinite where there is none
    rates: np.ndarray
    clearance: float  # distance to keep from obstacles [m]
    left_out: Sequence[tuple[str, str, str]]  # two names and a reason: pairs that are not judged
    unknown: Sequence[str]  # what the file has and the referee can't judge, in words
