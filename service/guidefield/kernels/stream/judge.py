"""The judge of streams: whether a motion keeps from all that may be where obstacles can have come to meanwhile.

A stretch of time [a, b] is free for a body and an obstacle if at its middle, with the robot in the middle of the box of
its joints' values there, they keep more than both can lose within it:

    distance > sum_j 2 sin(e_j / 2) rho_bj + (|v| + r) (b - a) / 2 + r ((a + b) / 2 - t_o) + eps

with e_j the box's half widths and the joints' tolerances, rho_bj the largest distance of the body from axis j, v the
obstacle's velocity as predicted, r how fast it may leave the prediction, t_o when it was observed, eps what else is
unknown of it. Else the stretch is halved. The robot's own pairs keep more than the joints between them can lose.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import float64, int64, types

from guidefield.kernels.collide.gjk_simplex import has_point, nearest_point, reduced_with
from guidefield.kernels.jit.arrays import (
    DOUBLE_POINTER,
    SCALAR,
    VECTOR,
    Blocks,
    Floats,
    IndexRows,
    IndexRowsOut,
    Indices,
    IndicesOut,
    Integers,
    Row,
    RowOut,
    Rows,
    RowsOut,
    Vector3,
    numba_type,
)
from guidefield.kernels.jit.decorators import lane_kernel, lane_part, lane_step, lane_uncounted
from guidefield.kernels.kinematics.forward_kinematics import (
    PRISMATIC,
    GroupJoints,
    JointPlaces,
    place_group,
    velocity_by,
    write_twists,
)
from guidefield.kernels.kinematics.poses import apply_pose, turned_back
from guidefield.kernels.simd.packing import pointers


class Solids(NamedTuple):
    """Convex solids in the frames of what carries them."""

    # first, counts: Which of `points` are whose, shape (n,)
    first: Indices
    counts: Indices
    points: Rows  # shape (p, 3) [m]
    disc: Row  # radius of the disc that is swept over them, across `axis`, shape (n,) [m]
    axis: Rows  # unit vectors, shape (n, 3); used where there is a disc
    rounding: Row  # radius of the ball that is swept over all that, shape (n,) [m]
    balls: Rows  # centre and radius of a ball about each, shape (n, 4) [m]


SOLIDS = numba_type(Solids)

ROUNDS = 24  # directions that are tried
CONVERGED = 1e-6  # if the bounds from both sides are this close, no direction is much better [m]
PARALLEL = 2e-15  # a direction whose part across an axis is no larger than this share of it is parallel to the axis


@lane_part
def _unit_across(
    x: float, y: float, z: float, axis_x: float, axis_y: float, axis_z: float
) -> tuple[float, float, float]:
    """The unit vector across a unit axis that is nearest to a direction; 0 if they are parallel up to rounding.

    What one projection leaves of a nearly parallel direction can point along the axis, so the direction is projected
    twice.
    """
    size = max(abs(x), abs(y), abs(z))
    if not size > 0.0:
        return 0.0, 0.0, 0.0
    x, y, z = x / size, y / size, z / size
    for _ in range(2):
        along = x * axis_x + y * axis_y + z * axis_z
        x, y, z = x - along * axis_x, y - along * axis_y, z - along * axis_z
    across = math.sqrt(x * x + y * y + z * z)
    if across <= PARALLEL:
        return 0.0, 0.0, 0.0
    return x / across, y / across, z / across


@lane_part
def _furthest(solids: Solids, k: int, pose: Floats, x: float, y: float, z: float) -> Vector3:
    """The point of a solid, in the world and without its rounding, that is furthest in a direction of the world [m]."""
    dx, dy, dz = turned_back(pose, x, y, z)
    points, first = solids.points, solids.first[k]
    best, most = first, -np.inf
    for i in range(first, first + solids.counts[k]):
        along = points[i, 0] * dx + points[i, 1] * dy + points[i, 2] * dz
        if along > most:
            best, most = i, along
    px, py, pz = points[best, 0], points[best, 1], points[best, 2]
    disc = solids.disc[k]
    if disc > 0.0:
        ux, uy, uz = _unit_across(dx, dy, dz, solids.axis[k, 0], solids.axis[k, 1], solids.axis[k, 2])
        px, py, pz = px + disc * ux, py + disc * uy, pz + disc * uz
    return apply_pose(pose, px, py, pz)


@lane_step(types.UniTuple(float64, 2)(SOLIDS, int64, VECTOR, SOLIDS, int64, VECTOR, SCALAR, SCALAR, DOUBLE_POINTER))
def apart(
    a: Solids, i: int, here: Floats, b: Solids, j: int, there: Floats, wanted: float, needed: float, simplex: Floats
) -> tuple[float, float]:
    """Return bounds of the distance of two solids: no less than the first; no more than the second, up to rounding [m].

    Solid i of a is carried at `here` (12,), j of b at `there` (12,). It ends where the first bound is above `wanted`,
    or the second not above `needed` [m]; scratch (`SIMPLEX`,).
    """
    ca, cb = a.balls[i], b.balls[j]
    x, y, z = apply_pose(here, ca[0], ca[1], ca[2])
    u, v, w = apply_pose(there, cb[0], cb[1], cb[2])
    x, y, z = x - u, y - v, z - w
    rounding = a.rounding[i] + b.rounding[j]
    lower, upper, size = -np.inf, np.inf, 0
    for _ in range(ROUNDS):
        length = math.sqrt(x * x + y * y + z * z)
        if size > 0:
            upper = length - rounding
        if length < 1e-12:
            if size > 0:
                return lower, -rounding
            x, y, z, length = 1.0, 0.0, 0.0, 1.0
        x, y, z = x / length, y / length, z / length
        px, py, pz = _furthest(a, i, here, -x, -y, -z)
        qx, qy, qz = _furthest(b, j, there, x, y, z)
        px, py, pz = px - qx, py - qy, pz - qz
        lower = max(lower, x * px + y * py + z * pz - rounding)
        if lower > wanted or upper <= needed or upper - lower < CONVERGED or size == 4:
            return lower, upper
        if has_point(simplex, size, px, py, pz):
            return lower, upper
        size = reduced_with(simplex, size, px, py, pz)
        x, y, z = nearest_point(simplex)
    return lower, upper


BEGIN, VALUE, VELOCITY, ACCELERATION, JERK = range(5)
PHASE = 5  # numbers of a phase: its columns
EXACT = 1e-9  # tolerance for rounding, of a limit or of continuity, as a share of the limit or in [rad or m, s]


@lane_part
def phase_at(phases: Floats, count: int, time: float) -> int:
    """Return which phase, of rows (k, `PHASE`), is on at a time [s]."""
    k = 0
    while k + 1 < count and phases[k + 1, BEGIN] <= time:
        k += 1
    return k


@lane_part
def value_at(phases: Floats, count: int, time: float) -> float:
    """The value [rad or m] of a coordinate, phases in rows (k, `PHASE`), at a time [s]."""
    row = phases[phase_at(phases, count, time)]
    s = time - row[BEGIN]
    return float(row[VALUE] + s * (row[VELOCITY] + s * (0.5 * row[ACCELERATION] + s * row[JERK] / 6.0)))


@lane_part
def range_of(phases: Floats, count: int, begin: float, end: float) -> tuple[float, float]:
    """Return the least and the largest value of a coordinate, phases in rows (k, `PHASE`), between two times [s]."""
    least = largest = value_at(phases, count, begin)
    k = phase_at(phases, count, begin)
    while True:
        row = phases[k]
        until = end if k + 1 == count else min(end, phases[k + 1, BEGIN])
        since = max(begin, row[BEGIN])
        v, a, j = row[VELOCITY], row[ACCELERATION], row[JERK]
        square = a * a - 2.0 * j * v
        for which in range(3):
            s = until - row[BEGIN]
            if which < 2:
                # roots of v + a s + j s^2 / 2, without cancellation
                if square < 0.0:
                    continue
                sum_ = -(a + math.copysign(math.sqrt(square), a))
                if which == 0:
                    if j == 0.0:
                        continue
                    s = sum_ / j
                else:
                    if sum_ == 0.0:
                        continue
                    s = 2.0 * v / sum_
                if not (since - row[BEGIN] < s < until - row[BEGIN]):
                    continue
            value = row[VALUE] + s * (v + s * (0.5 * a + s * j / 6.0))
            least, largest = min(least, value), max(largest, value)
        if k + 1 == count or phases[k + 1, BEGIN] >= end:
            return least, largest
        k += 1


@lane_part
def keeps_limits(  # noqa: PLR0911 - one for each thing that may be wrong
    phases: Floats,
    count: int,
    since: Floats,
    until: float,
    velocity: float,
    acceleration: float,
    jerk: float,
) -> bool:
    """Tell if a coordinate goes on from a state (3,) without a jump, keeps its limits, and stands still at `until` [s].

    Its `count` phases are rows (k, `PHASE`), with times from 0; the limits are those of velocity, acceleration and
    jerk.
    """
    more = 1.0 + EXACT
    q, v, a = since[0], since[1], since[2]
    if count < 1 or phases[0, BEGIN] != 0.0:
        return False
    for k in range(count):
        row = phases[k]
        scale = EXACT * (1.0 + abs(q))
        if not (
            abs(row[VALUE] - q) <= scale
            and abs(row[VELOCITY] - v) <= EXACT * (1.0 + velocity)
            and abs(row[ACCELERATION] - a) <= EXACT * (1.0 + acceleration)
        ):
            return False
        j = row[JERK]
        if not (abs(j) <= jerk * more and abs(row[ACCELERATION]) <= acceleration * more):
            return False
        if not abs(row[VELOCITY]) <= velocity * more:
            return False
        if k + 1 == count:
            stands = row[VELOCITY] == 0.0 and row[ACCELERATION] == 0.0 and j == 0.0
            return bool(stands and row[BEGIN] <= until + EXACT)
        s = phases[k + 1, BEGIN] - row[BEGIN]
        if not s >= 0.0:
            return False
        if j != 0.0:
            turn = -row[ACCELERATION] / j
            if 0.0 < turn < s and not abs(row[VELOCITY] + 0.5 * turn * row[ACCELERATION]) <= velocity * more:
                return False
        q = row[VALUE] + s * (row[VELOCITY] + s * (0.5 * row[ACCELERATION] + s * j / 6.0))
        v = row[VELOCITY] + s * (row[ACCELERATION] + 0.5 * s * j)
        a = row[ACCELERATION] + s * j
    return False


class JudgedRobot(NamedTuple):
    """A robot, as the judge knows it."""

    joints: GroupJoints  # its joints, each of which turns about one axis or slides along one
    carriers: Indices  # the joint that carries each body, shape (r,)
    balls: Rows  # centre and radius of a ball about each body, in that joint's frame, shape (r, 4) [m]
    # where each body's solids begin, and the number of all, shape (r + 1,): one that holds the body, and behind it,
    # where it isn't the body itself, others that do so together
    first: Indices
    own: IndexRows  # pairs of bodies that must not touch, shape (p, 2)
    solids: Solids  # the solids, in the frames of their carriers


class JudgedShapes(NamedTuple):
    """Shapes of obstacles, each in its own frame: convex solids in trees of balls."""

    roots: Indices  # the first node of each obstacle, shape (o,)
    nodes: Rows  # centre and radius of a ball about all below, shape (k, 4) [m]
    # first and second node below, -1 where there is none, then, in a leaf, its first solid and the one after its last,
    # shape (k, 4)
    links: IndexRows
    flat: Indices  # whether it is a half-space, shape (o,): everything with n.x <= d
    planes: Rows  # its n and d in its own frame, shape (o, 4) [m]
    # where the triangles of a closed surface begin and end among the solids, shape (o, 2); 0 for others
    closed: IndexRows
    solids: Solids


class JudgedPlaces(NamedTuple):
    """Observed placements of obstacles, and what they may have done since."""

    poses: Rows  # rotation by rows and translation, shape (o, 12) [m, world]
    velocities: Rows  # as predicted, shape (o, 3) [m/s]
    rates: Row  # how fast any point of it may leave the prediction, shape (o,) [m/s]
    margins: Row  # what else is to be kept, shape (o,) [m]
    times: Row  # when they were observed, shape (o,) [s]
    met: IndexRows  # bodies and obstacles that must not touch, shape (m, 2)


class JudgeMemory(NamedTuple):
    """Memory of a judgement."""

    places: JointPlaces  # placements and twists of the joints
    joints: RowsOut  # the placements, row by row, in the same memory, shape (n, 12) [m]
    # middle, half: Middles and half widths of the coordinates, shape (nv,); -1 of a half width: not looked at yet
    middle: RowOut
    half: RowOut
    chords: RowOut  # how far a joint moves what is 1 m from its axis, within the half widths, shape (n,) [m]
    swept: RowOut  # how far bodies can move, shape (r,) [m]; -1: not looked at yet
    ways: RowOut  # how far they moved altogether, shape (r,) [m]
    pairs: IndexRowsOut  # for each depth which pairs are left, shape (`DEEPEST` + 2, own + m)
    counts: IndicesOut  # how many, shape (`DEEPEST` + 2,)
    work: RowOut  # a simplex, shape (`SIMPLEX`,)
    pose: RowOut  # shape (12,)
    stack: IndicesOut  # shape (64,)


ROBOT, SHAPES, PLACES, MEMORY = map(numba_type, (JudgedRobot, JudgedShapes, JudgedPlaces, JudgeMemory))

DEEPEST = 14  # a stretch is halved so often at most
MOST_NODES = 128  # nodes of a tree that wait at once at most: a tree is at most as deep as half of that
LEAST = 1e-9  # margin by which distances must exceed their bounds, for rounding [m]

FREE, LIMITS, OWN, OBSTACLE, UNDECIDED = range(5)
"""Verdicts: free; limits aren't kept; the robot meets itself, or an obstacle; nothing was found that proves either."""


@lane_uncounted
def _enclose(
    robot: JudgedRobot,
    phases: Floats,
    counts: Integers,
    tolerances: Floats,
    a: float,
    b: float,
    memory: JudgeMemory,
) -> None:
    """Write boxes of the coordinates' values between two times [s], and how far they let each joint move.

    Bodies' sweeps aren't known from then on.
    """
    memory.half[:] = -1.0
    memory.swept[:] = -1.0
    joints, table = robot.joints, robot.joints.table
    for joint in range(1, table.parents.shape[0]):
        row = table.idx_v[joint]
        k = joints.sources[row]
        if memory.half[k] < 0.0:
            least, largest = range_of(phases[k], counts[k], a, b)
            memory.middle[k] = 0.5 * (least + largest)
            memory.half[k] = 0.5 * (largest - least) + tolerances[k]
        e = abs(joints.multipliers[row]) * memory.half[k]
        memory.chords[joint] = e if table.kinds[joint] == PRISMATIC else 2.0 * math.sin(0.5 * min(e, math.pi))


@lane_uncounted
def _place(robot: JudgedRobot, memory: JudgeMemory) -> None:
    """Place the joints at the middles of the coordinates' boxes."""
    place_group(robot.joints, memory.middle, memory.places)
    write_twists(robot.joints, memory.places)


@lane_uncounted
def _at(pose: Floats, ball: Floats, k: int) -> float:
    """Coordinate k, in the world, of the centre of a ball, shape (4,), carried at a pose, shape (12,)."""
    return float(pose[4 * k] * ball[0] + pose[4 * k + 1] * ball[1] + pose[4 * k + 2] * ball[2] + pose[4 * k + 3])


@lane_uncounted
def _reach(robot: JudgedRobot, body: int, joint: int, memory: JudgeMemory) -> float:
    """Return how far a joint moves a point of a body it moves at most, within the half widths there are [m]."""
    table, ball, pose = robot.joints.table, robot.balls[body], memory.joints[robot.carriers[body]]
    if table.kinds[joint] == PRISMATIC:
        return float(memory.chords[joint])
    x, y, t = _at(pose, ball, 0), _at(pose, ball, 1), _at(pose, ball, 2)
    vx, vy, vz = velocity_by(memory.places.twists[table.idx_v[joint]], x, y, t)
    return float(memory.chords[joint] * (math.sqrt(vx * vx + vy * vy + vz * vz) + ball[3]))


@lane_uncounted
def _swept_by(robot: JudgedRobot, body: int, memory: JudgeMemory) -> float:
    """Return how far any point of a body can be from where it is at the middle [m]."""
    if memory.swept[body] < 0.0:
        joint, whole = robot.carriers[body], 0.0
        while joint > 0:
            whole += _reach(robot, body, joint, memory)
            joint = robot.joints.table.parents[joint]
        memory.swept[body] = whole
    return float(memory.swept[body])


@lane_uncounted
def _moves(robot: JudgedRobot, joint: int, body: int) -> bool:
    """Tell if a joint moves a body."""
    at = robot.carriers[body]
    while at > joint:
        at = robot.joints.table.parents[at]
    return bool(at == joint)


@lane_uncounted
def _between(robot: JudgedRobot, body: int, other: int, memory: JudgeMemory) -> float:
    """Return how far the joints that move a body and not another can move it [m]."""
    joint, whole = robot.carriers[body], 0.0
    while joint > 0:
        if not _moves(robot, joint, other):
            whole += _reach(robot, body, joint, memory)
        joint = robot.joints.table.parents[joint]
    return whole


@lane_uncounted
def _own_apart(
    robot: JudgedRobot, first: int, second: int, wanted: float, needed: float, memory: JudgeMemory
) -> tuple[float, float]:
    """Bounds of the distance of two bodies of the robot, as `apart`; the upper one tells where it is above `needed`."""
    here, there = memory.joints[robot.carriers[first]], memory.joints[robot.carriers[second]]
    a, b, solids = robot.first[first], robot.first[second], robot.solids
    lower, upper = apart(solids, a, here, solids, b, there, wanted, needed, pointers(memory.work))
    a_end, b_end = robot.first[first + 1], robot.first[second + 1]
    if lower > wanted or (a_end - a == 1 and b_end - b == 1):
        return lower, upper
    least, most = np.inf, np.inf
    for i in range(a if a_end - a == 1 else a + 1, a_end):
        for j in range(b if b_end - b == 1 else b + 1, b_end):
            lower, upper = apart(solids, i, here, solids, j, there, wanted, needed, pointers(memory.work))
            least, most = min(least, lower), min(most, upper)
            if most <= needed:
                return least, most
    return least, most


@lane_uncounted
def _solid_apart(
    robot: JudgedRobot,
    body: int,
    shapes: JudgedShapes,
    k: int,
    wanted: float,
    needed: float,
    memory: JudgeMemory,
) -> tuple[float, float]:
    """Bounds of the distance of a body from one solid of an obstacle whose frame is at `memory.pose`, as `apart`."""
    here, there, solids = memory.joints[robot.carriers[body]], memory.pose, robot.solids
    begin, end = robot.first[body], robot.first[body + 1]
    lower, upper = apart(solids, begin, here, shapes.solids, k, there, wanted, needed, pointers(memory.work))
    if lower > wanted or end - begin == 1:
        return lower, upper
    least, most = np.inf, np.inf
    for i in range(begin + 1, end):
        lower, upper = apart(solids, i, here, shapes.solids, k, there, wanted, needed, pointers(memory.work))
        least, most = min(least, lower), min(most, upper)
        if most <= needed:
            return least, most
    return least, most


@lane_uncounted
def _winding(shapes: JudgedShapes, obstacle: int, x: float, y: float, z: float) -> float:
    """Winding number of an obstacle's triangles about a point in its frame: van Oosterom and Strackee's angles."""
    whole, points = 0.0, shapes.solids.points
    for k in range(shapes.closed[obstacle, 0], shapes.closed[obstacle, 1]):
        i = shapes.solids.first[k]
        ax, ay, az = points[i, 0] - x, points[i, 1] - y, points[i, 2] - z
        bx, by, bz = points[i + 1, 0] - x, points[i + 1, 1] - y, points[i + 1, 2] - z
        cx, cy, cz = points[i + 2, 0] - x, points[i + 2, 1] - y, points[i + 2, 2] - z
        a = math.sqrt(ax * ax + ay * ay + az * az)
        b = math.sqrt(bx * bx + by * by + bz * bz)
        c = math.sqrt(cx * cx + cy * cy + cz * cz)
        triple = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        ab, bc, ca = ax * bx + ay * by + az * bz, bx * cx + by * cy + bz * cz, cx * ax + cy * ay + cz * az
        whole += 2.0 * math.atan2(triple, a * b * c + ab * c + bc * a + ca * b)
    return whole / (4.0 * math.pi)


@lane_uncounted
def _obstacle_apart(
    robot: JudgedRobot,
    body: int,
    shapes: JudgedShapes,
    obstacle: int,
    wanted: float,
    needed: float,
    memory: JudgeMemory,
) -> tuple[float, float]:
    """Bounds of the distance of a body from an obstacle whose frame is at `memory.pose`, as `apart`."""
    here, there, ball = memory.joints[robot.carriers[body]], memory.pose, robot.balls[body]
    x, y, z = _at(here, ball, 0), _at(here, ball, 1), _at(here, ball, 2)
    if shapes.flat[obstacle] != 0:
        return _above(robot, body, shapes, obstacle, memory)
    stack, size, least, most = memory.stack, 1, np.inf, np.inf
    stack[0] = shapes.roots[obstacle]
    while size > 0:
        size -= 1
        node = stack[size]
        around = shapes.nodes[node]
        dx, dy, dz = x - _at(there, around, 0), y - _at(there, around, 1), z - _at(there, around, 2)
        lower = math.sqrt(dx * dx + dy * dy + dz * dz) - around[3] - ball[3]
        if lower > wanted:
            least = min(least, lower)
            continue
        left, right = shapes.links[node, 0], shapes.links[node, 1]
        if left >= 0:
            if right >= 0:
                stack[size] = right
                size += 1
            stack[size] = left
            size += 1
            continue
        for k in range(shapes.links[node, 2], shapes.links[node, 3]):
            around = shapes.solids.balls[k]
            dx, dy, dz = x - _at(there, around, 0), y - _at(there, around, 1), z - _at(there, around, 2)
            lower = math.sqrt(dx * dx + dy * dy + dz * dz) - around[3] - ball[3]
            if lower > wanted:
                least = min(least, lower)
                continue
            lower, upper = _solid_apart(robot, body, shapes, k, wanted, needed, memory)
            least, most = min(least, lower), min(most, upper)
            if most <= needed or not lower > wanted:
                return min(least, wanted), most
    if shapes.closed[obstacle, 1] > 0 and least > wanted:
        root = shapes.nodes[shapes.roots[obstacle]]
        dx, dy, dz = x - _at(there, root, 0), y - _at(there, root, 1), z - _at(there, root, 2)
        if dx * dx + dy * dy + dz * dz <= (root[3] + ball[3]) ** 2 and _inside(robot, body, shapes, obstacle, memory):
            return -np.inf, 0.0
    return least, most


@lane_uncounted
def _inside(robot: JudgedRobot, body: int, shapes: JudgedShapes, obstacle: int, memory: JudgeMemory) -> bool:
    """Tell if a point of a body is inside of a closed surface."""
    here, there = memory.joints[robot.carriers[body]], memory.pose
    corner = robot.solids.points[robot.solids.first[robot.first[body + 1] - 1]]
    x = here[0] * corner[0] + here[1] * corner[1] + here[2] * corner[2] + here[3] - there[3]
    y = here[4] * corner[0] + here[5] * corner[1] + here[6] * corner[2] + here[7] - there[7]
    z = here[8] * corner[0] + here[9] * corner[1] + here[10] * corner[2] + here[11] - there[11]
    px = there[0] * x + there[4] * y + there[8] * z
    py = there[1] * x + there[5] * y + there[9] * z
    pz = there[2] * x + there[6] * y + there[10] * z
    return bool(abs(_winding(shapes, obstacle, px, py, pz)) > 0.25)


@lane_uncounted
def _above(
    robot: JudgedRobot, body: int, shapes: JudgedShapes, obstacle: int, memory: JudgeMemory
) -> tuple[float, float]:
    """Bounds of how far a body is above a half-space [m], both the same up to rounding."""
    here, there, plane, solids = memory.joints[robot.carriers[body]], memory.pose, shapes.planes[obstacle], robot.solids
    nx = there[0] * plane[0] + there[1] * plane[1] + there[2] * plane[2]
    ny = there[4] * plane[0] + there[5] * plane[1] + there[6] * plane[2]
    nz = there[8] * plane[0] + there[9] * plane[1] + there[10] * plane[2]
    level = plane[3] + nx * there[3] + ny * there[7] + nz * there[11]
    dx = here[0] * nx + here[4] * ny + here[8] * nz
    dy = here[1] * nx + here[5] * ny + here[9] * nz
    dz = here[2] * nx + here[6] * ny + here[10] * nz
    base = here[3] * nx + here[7] * ny + here[11] * nz - level
    k, least = robot.first[body], np.inf  # the hull is as low as the body
    for i in range(solids.first[k], solids.first[k] + solids.counts[k]):
        point = solids.points[i]
        least = min(least, point[0] * dx + point[1] * dy + point[2] * dz)
    if solids.disc[k] > 0.0:
        axis = solids.axis[k]
        ux, uy, uz = axis[1] * dz - axis[2] * dy, axis[2] * dx - axis[0] * dz, axis[0] * dy - axis[1] * dx
        least -= solids.disc[k] * math.sqrt(ux * ux + uy * uy + uz * uz)
    gap = base + least - solids.rounding[k]
    return gap, gap


@lane_uncounted
def _stand(places: JudgedPlaces, obstacle: int, since: float, pose: Floats) -> None:
    """Put the frame of an obstacle where it is predicted so long after it was seen [s], into a pose, shape (12,)."""
    for k in range(12):
        pose[k] = places.poses[obstacle, k]
    for k in range(3):
        pose[4 * k + 3] += since * places.velocities[obstacle, k]


@lane_uncounted
def _decided(
    robot: JudgedRobot,
    shapes: JudgedShapes,
    places: JudgedPlaces,
    pair: int,
    middle: float,
    half: float,
    memory: JudgeMemory,
) -> int:
    """Tell if a pair, own ones first, is `FREE` about the middle of a stretch [s], meets there, or is `UNDECIDED`."""
    count = robot.own.shape[0]
    if pair < count:
        first, second = robot.own[pair, 0], robot.own[pair, 1]
        wanted = _between(robot, first, second, memory) + _between(robot, second, first, memory) + LEAST
        here, there = memory.joints[robot.carriers[first]], memory.joints[robot.carriers[second]]
        a, b = robot.balls[first], robot.balls[second]
        square = 0.0
        for k in range(3):
            square += (_at(here, a, k) - _at(there, b, k)) ** 2
        if math.sqrt(square) - a[3] - b[3] > wanted:
            return FREE
        lower, upper = _own_apart(robot, first, second, wanted, 0.0, memory)
        if lower > wanted:
            return FREE
        return OWN if upper <= 0.0 else UNDECIDED
    body, obstacle = places.met[pair - count, 0], places.met[pair - count, 1]
    since = middle - places.times[obstacle]
    velocity = places.velocities[obstacle]
    speed = math.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    rate = places.rates[obstacle]
    needed = rate * since + places.margins[obstacle]
    wanted = _swept_by(robot, body, memory) + (speed + rate) * half + needed + LEAST
    _stand(places, obstacle, since, memory.pose)
    if shapes.flat[obstacle] == 0:
        here, a, b = memory.joints[robot.carriers[body]], robot.balls[body], shapes.nodes[shapes.roots[obstacle]]
        square = 0.0
        for k in range(3):
            square += (_at(here, a, k) - _at(memory.pose, b, k)) ** 2
        if math.sqrt(square) - a[3] - b[3] > wanted:
            return FREE
    lower, upper = _obstacle_apart(robot, body, shapes, obstacle, wanted, needed, memory)
    if lower > wanted:
        return FREE
    return OBSTACLE if upper <= needed else UNDECIDED


@lane_uncounted
def _looked_at(
    robot: JudgedRobot,
    shapes: JudgedShapes,
    places: JudgedPlaces,
    phases: Floats,
    begins: float,
    a: float,
    b: float,
    counts: Integers,
    tolerances: Floats,
    depth: int,
    memory: JudgeMemory,
) -> tuple[int, int, int]:
    """Look at one stretch [s]: how many pairs are left for the next depth, a verdict, and the pair that it is of.

    The stretch was halved `depth` times, whose pairs in memory are looked at; times from the motion's beginning.
    """
    _enclose(robot, phases, counts, tolerances, a, b, memory)
    _place(robot, memory)
    left, met = 0, -1
    for at in range(memory.counts[depth]):
        pair = memory.pairs[depth, at]
        verdict = _decided(robot, shapes, places, pair, begins + 0.5 * (a + b), 0.5 * (b - a), memory)
        if verdict == FREE:
            continue
        if verdict != UNDECIDED:
            return 1, verdict, pair
        memory.pairs[depth + 1, left] = pair
        left += 1
        met = pair
    return left, UNDECIDED if left > 0 else FREE, met


@lane_kernel
def judge_motion(
    robot: JudgedRobot,
    shapes: JudgedShapes,
    places: JudgedPlaces,
    phases: Blocks,
    counts: Indices,
    begins: float,
    since: float,
    until: float,
    start: Rows,
    limits: Rows,
    tolerances: Row,
    most: int,
    memory: JudgeMemory,
    found: RowOut,
) -> int:
    """Judge a motion that comes to a stop; return the verdict, such as `FREE`.

    `phases` (nv, k, `PHASE`) and `counts` (nv,) are the motion with times from its beginning, which is at `begins` by
    the client's clock [s]; it is judged from `since` to `until`, when it stands still [s]. `start` (nv, 3) are value,
    velocity and acceleration at first, `limits` (nv, 5) least and largest value, velocity, acceleration and jerk,
    `tolerances` (nv,) how far the robot may be off [rad or m]; at most `most` configurations are looked at. `found`
    (3,) gets their number, the pair, and the client's time where it was refused.
    """
    nv = counts.shape[0]
    found[0], found[1], found[2] = 0.0, -1.0, begins
    for j in range(nv):
        least, largest = range_of(phases[j], counts[j], 0.0, until)
        kept = keeps_limits(phases[j], counts[j], start[j], until, limits[j, 2], limits[j, 3], limits[j, 4])
        if not (kept and least >= limits[j, 0] and largest <= limits[j, 1]):
            found[1] = float(j)
            return LIMITS
    count = robot.own.shape[0] + places.met.shape[0]
    for pair in range(count):
        memory.pairs[0, pair] = pair
    memory.counts[0] = count
    # what is refused mostly is at the end, where obstacles may have come closest: that is looked at before all
    looked = 1
    left, verdict, met = _looked_at(robot, shapes, places, phases, begins, until, until, counts, tolerances, 0, memory)
    if verdict in (OWN, OBSTACLE):
        found[0], found[1], found[2] = float(looked), float(met), begins + until
        return verdict
    depth, index = 0, 0
    while True:
        share = (until - since) / (1 << depth)
        a, b = since + index * share, since + (index + 1) * share
        if looked == most:
            found[0], found[1], found[2] = float(looked), float(memory.pairs[depth, 0]), begins + a
            return UNDECIDED
        looked += 1
        left, verdict, met = _looked_at(robot, shapes, places, phases, begins, a, b, counts, tolerances, depth, memory)
        if verdict != FREE and (verdict != UNDECIDED or depth == DEEPEST):
            found[0], found[1], found[2] = float(looked), float(met), begins + 0.5 * (a + b)
            return verdict
        if left > 0:
            memory.counts[depth + 1] = left
            depth, index = depth + 1, 2 * index
            continue
        while index % 2 == 1:
            depth, index = depth - 1, index // 2
        if depth == 0:
            found[0] = float(looked)
            return FREE
        index += 1


@lane_kernel
def travelled(
    robot: JudgedRobot,
    phases: Blocks,
    counts: Indices,
    since: float,
    until: float,
    tolerances: Row,
    parts: int,
    memory: JudgeMemory,
) -> float:
    """Bound how far any point of the robot comes from where it is at first, between two times [m].

    `phases` (nv, k, `PHASE`) and `counts` (nv,) are as in `judged`; `tolerances` (nv,) is how far the robot may be off,
    at first and later [rad or m]. It is added up in `parts` parts.
    """
    ways, exact = memory.ways, np.zeros(counts.shape[0])
    bodies = robot.carriers.shape[0]
    within, off, most = np.zeros(bodies), np.zeros(bodies), 0.0
    ways[:] = 0.0
    for part in range(parts):
        a = since + (until - since) * part / parts
        b = since + (until - since) * (part + 1) / parts
        _enclose(robot, phases, counts, exact, a, b, memory)
        _place(robot, memory)
        for body in range(bodies):
            # from one end of the part to any place in it, both within the box about the middle
            within[body] = _swept_by(robot, body, memory)
            ways[body] += 2.0 * within[body]
        _enclose(robot, phases, counts, tolerances, a, b, memory)
        for body in range(bodies):
            more = _swept_by(robot, body, memory) - within[body]
            if part == 0:
                off[body] = more
            most = max(most, ways[body] + off[body] + more)
    return most
