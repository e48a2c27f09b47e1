"""Tables of a robot, of obstacles at rest and in motion, of the pairs between them, and of a motion."""

from __future__ import annotations

from typing import NamedTuple

from guidefield.kernels.collide.near_pairs import BoxedObstacles
from guidefield.kernels.collide.parts import Parts
from guidefield.kernels.jit.fields import Blocks, IndexRows, Indices, Row, Rows, numba_type
from guidefield.kernels.kinematics.forward_kinematics import JointTable


class RobotBodies(NamedTuple):
    """A robot's bodies and the joints that move them; r bodies, n local coordinates of the model, mimic ones included.

    Attributes:
        joints: Joints of the model.
        expand: The model's local coordinates by those of the group, shape (n, nv); with `offset`.
        offset: Shape (n,) [rad or m].
        origin: Configuration of the model from which rotation vectors start, shape (nq,).
        half_widths: The sizes of `expand`, shape (n, nv).
        alone: 1 for a coordinate that makes a move of its own, shape (n,).
        together: Coordinates that make one move, counted in its first, shape (n, n).
        centred: The same for turns about a centre, halved, shape (n, n).
        turns: 1 for a coordinate that turns, 0 for one that slides, shape (n,).
        doubled: 2 for the first coordinate of a ball joint's rotation, else as `turns`, shape (n,).
        carriers: Joint of each body, shape (r,); 0 is the world.
        centres: Centre of its bounding sphere in the frame of that joint, shape (r, 3) [m].
        radii: Radius of the sphere, shape (r,) [m].
        moved_by: The coordinates that move a body, ascending, and -1 behind them, shape (r, n).
        moves: 1 for a coordinate that moves a body, -1 for another, shape (r, n).
        roots: Root of each in `parts`, shape (r,), in the frame of its joint.
        parts: Their convex parts; those of bodies that the world carries as seen from the anchor.
        anchor: A point near those bodies, along the world's axes, shape (3,) [m].
    """

    joints: JointTable
    expand: Rows
    offset: Row
    origin: Row
    half_widths: Rows
    alone: Row
    together: Rows
    centred: Rows
    turns: Row
    doubled: Row
    carriers: Indices
    centres: Rows
    radii: Row
    moved_by: IndexRows
    moves: Rows
    roots: Indices
    parts: Parts
    anchor: Row


class ObstacleBodies(NamedTuple):
    """Obstacles where they are at first; o of them.

    Attributes:
        boxes: Boxes about them, those that move apart from the tree.
        roots: Root of each in `parts`, shape (o,).
        parts: Their convex parts, as seen from the anchor; half-spaces in the world.
        anchor: A point near them, along the world's axes, shape (3,) [m].
        movers: Index of each among those that move, -1 for one at rest, shape (o,).
    """

    boxes: BoxedObstacles
    roots: Indices
    parts: Parts
    anchor: Row
    movers: Indices


class MovingObstacles(NamedTuple):
    """Obstacles on screws from each of their placements to the next, at rest before the first and after the last.

    Attributes:
        begins: Begin of the placements of each, and the number of all, shape (v + 1,).
        times: Times of the placements, shape (k,) [s].
        poses: Motions from where an obstacle is at first to each placement, rotation and translation row by row,
            shape (k, 12) [m, world].
        twists: Twist from a placement to the next, linear part first, shape (k, 6) [m/s and rad/s, world].
        speeds: Largest speed at which distances to the obstacle change meanwhile, shape (k,) [m/s].
        endless: 1 for one without an end, shape (v,).
    """

    begins: Indices
    times: Row
    poses: Rows
    twists: Rows
    speeds: Row
    endless: Indices


class BodyPairs(NamedTuple):
    """Pairs that must stay apart, and how the bodies of the robot's own are seen from each other.

    Attributes:
        own, moving, left_out: As `PairTable` has them.
        first_by: The coordinates that move the first body of an own pair as it is seen from some body between both, in
            order from there to it, and -1 behind them, shape (p, n).
        second_by: The same of the second, shape (p, n).
    """

    own: IndexRows
    moving: Indices
    left_out: Indices
    first_by: IndexRows
    second_by: IndexRows


class BezierCurve(NamedTuple):
    """A motion as Bezier curves in the group's local coordinates; k of them.

    Attributes:
        times: Parameters at which they begin and the last one ends, increasing, shape (k + 1,).
        clock: The time at each of those, for obstacles that move, shape (k + 1,) [s].
        positions: Control points, shape (k, order, nv) [rad or m].
    """

    times: Row
    clock: Row
    positions: Blocks


class MovingRobot(NamedTuple):
    """A robot that moves among obstacles.

    Attributes:
        robot: The robot.
        obstacles: The obstacles.
        movers: How those of them move that do.
        pairs: The pairs that must stay apart.
        curve: The motion.
    """

    robot: RobotBodies
    obstacles: ObstacleBodies
    movers: MovingObstacles
    pairs: BodyPairs
    curve: BezierCurve


MOVING_ROBOT = numba_type(MovingRobot)
