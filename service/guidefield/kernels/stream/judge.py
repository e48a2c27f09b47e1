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
from numba import float64, int64

from guidefield.kernels.jit.fields import (
    IndexRows,
    IndexRowsOut,
    Indices,
    IndicesOut,
    Row,
    RowOut,
    Rows,
    RowsOut,
    numba_type,
)
from guidefield.kernels.jit.no_refcount import lane_uncounted
from guidefield.kernels.jit.signatures import (
    BLOCKS,
    INDICES,
    MATRIX,
    SCALAR,
    VECTOR,
    VECTOR_OUT,
    Floats,
    Integers,
    lane_kernel,
)
from guidefield.kernels.kinematics.forward_kinematics import PRISMATIC
from guidefield.kernels.kinematics.group_joints import (
    GroupJoints,
    JointPlaces,
    place_group,
    velocity_by,
    write_twists,
)
from guidefield.kernels.simd.packing import pointers
from guidefield.kernels.stream.curves import keeps_limits, range_of
from guidefield.kernels.stream.separation import Solids, apart


class JudgedRobot(NamedTuple):
    """A robot, as the judge knows it.

    Attributes:
        joints: Its joints, each of which turns about one axis or slides along one.
        carriers: The joint that carries each body, shape (r,).
        balls: Centre and radius of a ball about each body, in that joint's frame, shape (r, 4) [m].
        first: Where each body's solids begin, and the number of all, shape (r + 1,): one that holds the body, and
            behind it, where it isn't the body itself, others that do so together.
        own: Pairs of bodies that must not touch, shape (p, 2).
        solids: The solids, in the frames of their carriers.
    """

    joints: GroupJoints
    carriers: Indices
    balls: Rows
    first: Indices
    own: IndexRows
    solids: Solids


class JudgedShapes(NamedTuple):
    """Shapes of obstacles, each in its own frame: convex solids in trees of balls.

    Attributes:
        roots: The first node of each obstacle, shape (o,).
        nodes: Centre and radius of a ball about all below, shape (k, 4) [m].
        links: First and second node below, -1 where there is none, then, in a leaf, its first solid and the one after
            its last, shape (k, 4).
        flat: Whether it is a half-space, shape (o,): everything with n.x <= d.
        planes: Its n and d in its own frame, shape (o, 4) [m].
        closed: Where the triangles of a closed surface begin and end among the solids, shape (o, 2); 0 for others.
        solids: The solids.
    """

    roots: Indices
    nodes: Rows
    links: IndexRows
    flat: Indices
    planes: Rows
    closed: IndexRows
    solids: Solids


class JudgedPlaces(NamedTuple):
    """Observed placements of obstacles, and what they may have done since.

    Attributes:
        poses: Rotation by rows and translation, shape (o, 12) [m, world].
        velocities: As predicted, shape (o, 3) [m/s].
        rates: How fast any point of it may leave the prediction, shape (o,) [m/s].
        margins: What else is to be kept, shape (o,) [m].
        times: When they were observed, shape (o,) [s].
        met: Bodies and obstacles that must not touch, shape (m, 2).
    """

    poses: Rows
    velocities: Rows
    rates: Row
    margins: Row
    times: Row
    met: IndexRows


class JudgeMemory(NamedTuple):
    """Memory of a judgement.

    Attributes:
        places: Placements and twists of the joints.
        joints: The placements, row by row, in the same memory, shape (n, 12) [m].
        middle, half: Middles and half widths of the coordinates, shape (nv,); -1 of a half width: not looked at yet.
        chords: How far a joint moves what is 1 m from its axis, within the half widths, shape (n,) [m].
        swept: How far bodies can move, shape (r,) [m]; -1: not looked at yet.
        ways: How far they moved altogether, shape (r,) [m].
        pairs: For each depth which pairs are left, shape (`DEEPEST` + 2, own + m).
        counts: How many, shape (`DEEPEST` + 2,).
        work: A simplex, shape (`SIMPLEX`,).
        pose: Shape (12,).
        stack: Shape (64,).
    """

    places: JointPlaces
    joints: RowsOut
    middle: RowOut
    half: RowOut
    chords: RowOut
    swept: RowOut
    ways: RowOut
    pairs: IndexRowsOut
    counts: IndicesOut
    work: RowOut
    pose: RowOut
    stack: IndicesOut


ROBOT, SHAPES, PLACES, MEMORY = map(numba_type, (JudgedRobot, JudgedShapes, JudgedPlaces, JudgeMemory))

DEEPEST = 14
"""A stretch is halved so often at most."""

MOST_NODES = 128
"""Nodes of a tree that wait at once at most: a tree is at most as deep as half of that."""

LEAST = 1e-9
"""Margin by which distances must exceed their bounds, for rounding [m]."""

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
    """Boxes of the coordinates' values within a time, and how far they let each joint move.

    Args:
        robot: As in `judged`.
        phases: As there.
        counts: As there.
        tolerances: As there.
        a: From when, from the motion's beginning [s].
        b: Until when [s].
        memory: Out: middles, half widths and chords; of bodies it isn't known yet how far they can move.
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
def _moved(pose: Floats, ball: Floats, k: int) -> float:
    """Coordinate k, in the world, of the centre of a ball, shape (4,), carried at a pose, shape (12,)."""
    return float(pose[4 * k] * ball[0] + pose[4 * k + 1] * ball[1] + pose[4 * k + 2] * ball[2] + pose[4 * k + 3])


@lane_uncounted
def _reach(robot: JudgedRobot, body: int, joint: int, memory: JudgeMemory) -> float:
    """Return how far a joint moves a point of a body it moves at most, within the half widths there are [m]."""
    table, ball, pose = robot.joints.table, robot.balls[body], memory.joints[robot.carriers[body]]
    if table.kinds[joint] == PRISMATIC:
        return float(memory.chords[joint])
    x, y, t = _moved(pose, ball, 0), _moved(pose, ball, 1), _moved(pose, ball, 2)
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
    x, y, z = _moved(here, ball, 0), _moved(here, ball, 1), _moved(here, ball, 2)
    if shapes.flat[obstacle] != 0:
        return _above(robot, body, shapes, obstacle, memory)
    stack, size, least, most = memory.stack, 1, np.inf, np.inf
    stack[0] = shapes.roots[obstacle]
    while size > 0:
        size -= 1
        node = stack[size]
        around = shapes.nodes[node]
        dx, dy, dz = x - _moved(there, around, 0), y - _moved(there, around, 1), z - _moved(there, around, 2)
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
            dx, dy, dz = x - _moved(there, around, 0), y - _moved(there, around, 1), z - _moved(there, around, 2)
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
        dx, dy, dz = x - _moved(there, root, 0), y - _moved(there, root, 1), z - _moved(there, root, 2)
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
    """Tell if a pair is `FREE` in a stretch of time, meets at its middle, or is `UNDECIDED`.

    Args:
        robot: As in `judged`.
        shapes: As there.
        places: As there.
        pair: The robot's own ones first.
        middle: Of the stretch [s].
        half: Half of its length [s].
        memory: The robot stands as in the middle; with how far its joints can move.
    """
    count = robot.own.shape[0]
    if pair < count:
        first, second = robot.own[pair, 0], robot.own[pair, 1]
        wanted = _between(robot, first, second, memory) + _between(robot, second, first, memory) + LEAST
        here, there = memory.joints[robot.carriers[first]], memory.joints[robot.carriers[second]]
        a, b = robot.balls[first], robot.balls[second]
        square = 0.0
        for k in range(3):
            square += (_moved(here, a, k) - _moved(there, b, k)) ** 2
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
            square += (_moved(here, a, k) - _moved(memory.pose, b, k)) ** 2
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
    """Look at one stretch: how many pairs are left, which go to the next depth; a verdict, and the pair that it is of.

    Args:
        robot: As in `judged`.
        shapes: As there.
        places: As there.
        phases: As there, shape (nv, k, `PHASE`).
        begins: As there.
        a: When the stretch begins, from the motion's beginning [s].
        b: When it ends [s].
        counts: As in `judged`.
        tolerances: As there.
        depth: How often it was halved.
        memory: To work in; its pairs of that depth are looked at.
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


@lane_kernel(
    int64(
        ROBOT,
        SHAPES,
        PLACES,
        BLOCKS,
        INDICES,
        SCALAR,
        SCALAR,
        SCALAR,
        MATRIX,
        MATRIX,
        VECTOR,
        int64,
        MEMORY,
        VECTOR_OUT,
    )
)
def judged(
    robot: JudgedRobot,
    shapes: JudgedShapes,
    places: JudgedPlaces,
    phases: Floats,
    counts: Integers,
    begins: float,
    since: float,
    until: float,
    start: Floats,
    limits: Floats,
    tolerances: Floats,
    most: int,
    memory: JudgeMemory,
    found: Floats,
) -> int:
    """Judge a motion that comes to a stop.

    Args:
        robot: The robot.
        shapes: The obstacles' shapes.
        places: Where they are.
        phases: Of each coordinate, shape (nv, k, `PHASE`), times from the motion's beginning [s].
        counts: How many each has, shape (nv,).
        begins: The client's time at the beginning [s].
        since: From where on it is judged, from its beginning [s].
        until: When it stands still, from its beginning [s].
        start: Value, velocity and acceleration with which each coordinate begins, shape (nv, 3).
        limits: Least and largest value, velocity, acceleration and jerk of each, shape (nv, 5).
        tolerances: How far the robot may be off, by coordinate, shape (nv,) [rad or m].
        most: Configurations that are looked at, at most.
        memory: To work in.
        found: Out: how many were looked at, the pair, and the client's time where it was refused; shape (3,).

    Returns:
        The verdict, such as `FREE`.
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


@lane_kernel(float64(ROBOT, BLOCKS, INDICES, SCALAR, SCALAR, VECTOR, int64, MEMORY))
def travelled(
    robot: JudgedRobot,
    phases: Floats,
    counts: Integers,
    since: float,
    until: float,
    tolerances: Floats,
    parts: int,
    memory: JudgeMemory,
) -> float:
    """A bound of how far any point of the robot comes from where it is at first, by a time [m].

    Args:
        robot: The robot.
        phases: Of each coordinate, shape (nv, k, `PHASE`).
        counts: How many each has, shape (nv,).
        since: From when, from the motion's beginning [s].
        until: Until when [s].
        tolerances: How far the robot may be off, at first and later, by coordinate, shape (nv,) [rad or m].
        parts: In so many parts it is added up.
        memory: To work in.
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
