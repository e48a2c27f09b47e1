"""The case that the referee judges: a robot's model, bodies, a motion, its limits, and what has to be kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class Screw:
    """How an obstacle moves: on a screw from each placement to the next, at rest before the first and after the last.

    Attributes:
        times: Shape (k,), increasing [s]; k is at least 2.
        stops: Placements of the obstacle's frame in the world at those times, pinocchio.SE3.
        twists: Its velocity in itself from each to the next, (k - 1, 6), linear part first: log(T_i^-1 T_i+1) / dt.
    """

    times: np.ndarray
    stops: Sequence[Any]
    twists: np.ndarray


@dataclass(frozen=True, eq=False)
class Body:
    """A collision shape of a link, a held object, or an obstacle.

    Attributes:
        name: Of the link, the held object or the obstacle.
        joint: Pinocchio's index of the joint that carries it; 0 is the world.
        placement: Of the shape in the joint's frame, pinocchio.SE3; of an obstacle that moves, in its own frame.
        exact: Coal's shape of what is declared; of a cloud tiny triangles at its points.
        rounding: What it is rounded by all around: the radius of a cloud's balls [m].
        corners: Points whose hull contains the body, in the shape's frame, shape (8, 3) [m]; of a half-space, which
            has none, zeros.
        parts: Coal's convex shapes that are said to contain the mesh, in the same frame; none where there are none.
        triangles: The mesh's triangles, shape (t, 3, 3) [m, the shape's frame]; none where it isn't a mesh.
        shell: Triangles that are said to be the mesh closed and turned outwards, shape (s, 3, 3); often none.
        points: A point of each connected piece, shape (p, 3) [m, the shape's frame].
        obstacle: Whether it is an obstacle.
        screw: How it moves, if it does so by itself.
    """

    name: str
    joint: int
    placement: Any
    exact: Any
    rounding: float
    corners: np.ndarray
    parts: Sequence[Any]
    triangles: np.ndarray
    shell: np.ndarray
    points: np.ndarray
    obstacle: bool
    screw: Screw | None = None


@dataclass(frozen=True, eq=False)
class Constraint:
    """A frame's axis stays within a cone, or its origin near a plane or a line.

    Attributes:
        name: Its kind and frame, for a reader.
        joint: Pinocchio's index of the joint that carries the frame.
        placement: Of the frame in that joint's, pinocchio.SE3.
        limit: Largest angle or distance [rad or m].
        axis: Of a cone: unit vector in the frame, shape (3,); else zeros.
        target: Of a cone: unit vector in the world that the axis stays near, shape (3,); else zeros.
        point: On the plane or line, shape (3,) [m, world]; of a cone zeros.
        across: Directions in which the distance from it counts, orthonormal rows, shape (1, 3) or (2, 3); of a cone
            (0, 3).
        corners: The frame's origin in itself, eight times, shape (8, 3).
    """

    name: str
    joint: int
    placement: Any
    limit: float
    axis: np.ndarray
    target: np.ndarray
    point: np.ndarray
    across: np.ndarray
    corners: np.ndarray
    screw: None = None


@dataclass(frozen=True, eq=False)
class Case:
    """A motion of a robot among obstacles, and what it is said to keep.

    The chart of the model has `model.nv` numbers, joint by joint in Pinocchio's order: a joint's value or unwrapped
    angle; x, y and angle of a planar joint; position and rotation vector of a floating one. With the motion's own
    columns z it is at ``spread @ z + offset``: so followers follow, and other joints stand.

    Attributes:
        model: Pinocchio's model; a ball joint is a floating one that stays where it is.
        spread: Shape (model.nv, n).
        offset: Shape (model.nv,).
        turning: Which numbers of the chart are angles or rotation vectors of joints of several freedoms, (model.nv,).
        turned: Where `turning`, the rotation vector of the orientation from which others count, shape (model.nv,).
        bodies: The robot's, then obstacles.
        constraints: Along the path.
        rows: The joint that each number of the model's chart is about.
        columns: The joint that each of the motion's columns is about.
        times: Of the knots, shape (k,) [s]; None of a path.
        positions: Shape (k, n) [rad or m].
        velocities: Shape (k, n) [rad/s or m/s]; None: from knot to knot it goes straight on.
        lower: Least values of the model's chart, shape (model.nv,); infinite where there is no limit.
        upper: Largest values, shape (model.nv,).
        rates: Largest velocity, acceleration and jerk of each column of z, shape (3, n); infinite where there is none.
        clearance: Distance to keep from obstacles [m].
        left_out: Two names and a reason: pairs that are not judged.
        unknown: What the file has and the referee can't judge, in words.
    """

    model: Any
    spread: np.ndarray
    offset: np.ndarray
    turning: np.ndarray
    turned: np.ndarray
    bodies: Sequence[Body]
    constraints: Sequence[Constraint]
    rows: Sequence[str]
    columns: Sequence[str]
    times: np.ndarray | None
    positions: np.ndarray
    velocities: np.ndarray | None
    lower: np.ndarray
    upper: np.ndarray
    rates: np.ndarray
    clearance: float
    left_out: Sequence[tuple[str, str, str]]
    unknown: Sequence[str]
