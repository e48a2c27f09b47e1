"""What the kernels of smallest distances know of a robot, of obstacles, of the pairs between them, and of a motion."""

from __future__ import annotations

from typing import NamedTuple

from guidefield.kernels.collide.parts import Parts
from guidefield.kernels.jit.fields import Blocks, IndexRows, Indices, Row, Rows, numba_type
from guidefield.kernels.kinematics.forward_kinematics import JointTable


class RobotBodies(NamedTuple):
    """A robot's bodies and what moves them; r bodies, n coordinates of the model's chart, followers included.

    Attributes:
        joints: Joints of the model.
        expand: Coordinates of the model's chart by those of the group, shape (n, nv); with `offset`.
        offset: Shape (n,) [rad or m].
        origin: Configuration of the model from which rotation vectors start, shape (nq,).
        half_widths: The sizes of `expand`, shape (n, nv).
        alone: 1 for a coordinate that makes a move of its own, shape (n,).
        together: Which coordinates make one move, counted in its first, shape (n, n).
        centred: The same for turns about a centre, halved, shape (n, n).
        turns: 1 for a coordinate that turns, 0 for one that slides, shape (n,).
        doubled: 2 for the first coordinate of a ball joint's rotation, else as `turns`, shape (n,).
        carriers: Joint of each body, shape (r,); 0 is the world.
        centres: Centre of a ball about each, in the frame of that joint, shape (r, 3) [m].
        radii: Its radius, shape (r,) [m].
        moved_by: The coordinates that move a body, ascending, and -1 behind them, shape (r, n).
        moves: 1 for a coordinate that moves a body, -1 for another, shape (r, n).
        roots: Root of each in `parts`, shape (r,), in the frame of its joint.
        parts: Their convex parts.
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


class RestingObstacles(NamedTuple):
    """Obstacles that rest; o of them.

    Attributes:
        axes: Axes of a box about each, one after the other, shape (o, 9).
        centres: Its centre along them, shape (o, 3) [m].
        halves: Its half extents, shape (o, 3) [m]; infinite for a half-space.
        roots: Root of each in `parts`, shape (o,), in the world.
        parts: Their convex parts.
    """

    axes: Rows
    centres: Rows
    halves: Rows
    roots: Indices
    parts: Parts


class BodyPairs(NamedTuple):
    """Pairs that must stay apart; m of them, those of the robot's own first.

    Attributes:
        first: A body of the robot each, shape (m,).
        second: Another one of an own pair, else an obstacle, shape (m,).
        first_by: The coordinates that move the first body of an own pair as it is seen from some body between both, in
            order from there to it, and -1 behind them, shape (own, n).
        second_by: The same of the second, shape (own, n).
    """

    first: Indices
    second: Indices
    first_by: IndexRows
    second_by: IndexRows


class BezierCurve(NamedTuple):
    """A motion as Bezier curves in the group's chart; k of them.

    Attributes:
        times: When they begin and the last one ends, shape (k + 1,) [s].
        positions: Control points, shape (k, order, nv) [rad or m].
    """

    times: Row
    positions: Blocks


class MovingRobot(NamedTuple):
    """A robot that moves among obstacles.

    Attributes:
        robot: The robot.
        obstacles: What rests around it.
        pairs: What has to stay apart.
        curve: The motion.
    """

    robot: RobotBodies
    obstacles: RestingObstacles
    pairs: BodyPairs
    curve: BezierCurve


MOVING_ROBOT = numba_type(MovingRobot)
