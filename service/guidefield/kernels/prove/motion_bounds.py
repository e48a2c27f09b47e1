"""Rigorous bounds of the motion of a pair's bodies in a segment, of first and of second order.

Let x be the path of the coordinates from the middle of a segment, D the chord from its first point to its last, and
x = l D + e (`placement.bound_segment`). Control points of x bound all three: x by X, l by the share L, and e by E,
coordinate by coordinate. To first order a point moves by l J D, a rigid motion by the twist J D; J e moves it besides
by at most the sum of r E, with r its distance from each axis. What is of higher order is at most half of the point's
acceleration where the coordinates go straight from 0 to x in a time of 1,

    sum_i r_i X_i (2 sum_{k before i} X_k + X_i),   k and the last X_i only where they turn,

since the derivative of a column axis_i x r_i by coordinate k turns it about axis k, and no later joint moves axis i;
r is no less than anywhere on the path. What a robot may be beside the curve, coordinate by coordinate, adds to X and
to E: x is any path that they bound. A ball joint turns at a rate of at most the norm of its coordinates', and its
angular acceleration is at most the square of that rate: what the exponential map bends is at most 1. The speed along
the path, and jumps of rates, don't count.

Bounds are those of each body as the world sees it, and of the two bodies of own pairs as some body between them sees
them: distances are the same from anywhere. A short body that a joint turns beside a long one moves less than that does,
seen from the long one. (Schwarzer, Saha and Latombe 2005 bound motions to first order.) Certificates and the pieces of
streams rest on these bounds; the referee has the same formulas in code of its own, and refuses proofs by tighter ones:
change both, and docs/certificate.md.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from guidefield.kernels.jit.arrays import Floats, Integers
from guidefield.kernels.jit.decorators import uncounted
from guidefield.kernels.prove.kept_distance import FIRST_TURNS, FIRST_TWIST, SECOND_TURNS, SECOND_TWIST, TWISTS
from guidefield.kernels.prove.placement import (
    NOW,
    TWIST,
    BodyPoses,
    PoseScratch,
    bound_segment,
    kept_from_mover,
    step_at,
    time_at,
)
from guidefield.kernels.prove.tables import MovingObstacles, MovingRobot, RobotBodies, first_body, obstacle_of

BEGINS, ENDS = 0, 1  # numbers of a span of time

BENT, TRAVEL, IN_TUBE, BOUNDS = range(TWISTS, TWISTS + 4)
"""Numbers of a mover, behind the twists of its bodies along D: bounds of how far points are from where these bring
them, of how far they move from where they are in the middle, and of how much of that is beside the curve, in segments
of any length [m]; then how many there are."""


class MotionBounds(NamedTuple):
    """Bounds of a motion within a segment, and scratch; letters are those of the module's docstring."""

    parts: Floats  # scratch, shape (2, MOST_ORDER, nv)
    # farthest, aside: X and E of the group's coordinates, shape (nv,)
    farthest: Floats
    aside: Floats
    tube: Floats  # how far each may be beside the curve, shape (nv,)
    squares: Floats  # scratch, shape (n,)
    # moves, asides, tubes: X, E and the tube of the model's coordinates, shape (n,), each in the first of those that
    # make one move
    moves: Floats
    asides: Floats
    tubes: Floats
    sweeps: Floats  # how far each joint moves a point at a distance of 1 from the middle of the segment on, shape (n,)
    rho: Floats  # scratch, shape (n,)
    # bounds of each body, of each own pair, and of a body and a moving obstacle, shape (r + own + 1, BOUNDS)
    known: Floats
    asked: Floats  # number of the segment for which they are known, shape (r + own + 1,)
    span: Floats  # begin and end of the segment, shape (2,) [s]


@uncounted
def _write_sizes(robot: RobotBodies, sizes: Floats, bounds: MotionBounds, out: Floats) -> None:
    """Write the sizes of moves of the model's coordinates, by those of the group's coordinates, shape (nv,)."""
    n = robot.offset.shape[0]
    for i in range(n):
        total = 0.0
        for j in range(sizes.shape[0]):
            total += robot.half_widths[i, j] * sizes[j]
        bounds.squares[i] = total * total
    for i in range(n):
        square = bounds.squares[i]
        if robot.alone[i] == 0.0:
            square = 0.0
            for k in range(n):
                square += robot.together[k, i] * bounds.squares[k]
        out[i] = math.sqrt(square)


@uncounted
def find_moves(
    moving: MovingRobot, since: float, until: float, place: BodyPoses, scratch: PoseScratch, bounds: MotionBounds
) -> float:
    """Bound the motion between two parameters about the last placement; return L.

    D of the model's coordinates is written to the scratch of that placement, as what changes.
    """
    robot, timed = moving.robot, moving.movers.begins.shape[0] > 1
    share = bound_segment(
        moving.curve, since, until, place.moment[NOW], timed, scratch.z, scratch.weights, bounds.parts,
        scratch.straight, bounds.farthest, bounds.aside, bounds.tube,
    )  # fmt: skip
    bounds.span[BEGINS], bounds.span[ENDS] = time_at(moving.curve, since), time_at(moving.curve, until)
    for i in range(robot.offset.shape[0]):
        scratch.changes[i] = 0.0
        for j in range(scratch.z.shape[0]):
            scratch.changes[i] += robot.expand[i, j] * scratch.straight[j]
    _write_sizes(robot, bounds.farthest, bounds, bounds.moves)
    _write_sizes(robot, bounds.aside, bounds, bounds.asides)
    _write_sizes(robot, bounds.tube, bounds, bounds.tubes)
    for i in range(robot.offset.shape[0]):
        move = bounds.moves[i]
        bounds.sweeps[i] = 2.0 * math.sin(0.5 * min(move, math.pi)) if robot.turns[i] != 0.0 else move
    return share


@uncounted
def _reach(robot: RobotBodies, b: int, by: Integers, count: int, place: BodyPoses, bounds: MotionBounds) -> float:
    """Write how far a body is from the axes of some coordinates at the place; how far they sweep it, together [m].

    See `MotionBound.reach` of `collision/bodies.py`. Coordinates of one joint stand together.
    """
    x, y, z = place.centres[b, 0], place.centres[b, 1], place.centres[b, 2]
    for k in range(count):
        S = place.subspaces[by[k]]
        vx, vy, vz = S[0] + S[4] * z - S[5] * y, S[1] + S[5] * x - S[3] * z, S[2] + S[3] * y - S[4] * x
        bounds.squares[by[k]] = vx * vx + vy * vy + vz * vz
    swept = 0.0
    for k in range(count):
        i = by[k]
        square = bounds.squares[i]
        if robot.alone[i] == 0.0:
            square = 0.0
            for other in range(count):
                square += robot.centred[by[other], i] * bounds.squares[by[other]]
        bounds.rho[i] = math.sqrt(square) + robot.turns[i] * robot.radii[b]
        swept += bounds.rho[i] * bounds.sweeps[i]
    return swept


@uncounted
def _of_body(
    robot: RobotBodies,
    b: int,
    by: Integers,
    share: float,
    place: BodyPoses,
    bounds: MotionBounds,
    known: Floats,
    twist: int,
    turns: int,
) -> None:
    """Add the bounds of a body that the coordinates before -1 move, in order; write its twist.

    A coordinate that doesn't move the body in the world is passed against its direction: the body's observer is moved
    by it instead. The first moves all others.
    """
    count = 0
    while count < by.shape[0] and by[count] >= 0:
        count += 1
    swept = _reach(robot, b, by, count, place, bounds)
    before, travel, bent = 0.0, 0.0, 0.0
    for k in range(TWIST):
        known[twist + k] = 0.0
    for k in range(count):
        i = by[k]
        turning, move = robot.turns[i], bounds.moves[i]
        # whatever is between is no farther from the middle than what is swept
        rho = bounds.rho[i] + swept * turning
        travel += rho * move
        known[IN_TUBE] += rho * bounds.tubes[i]
        bent += bounds.rho[i] * bounds.asides[i] + rho * move * (before + 0.5 * robot.doubled[i] * move)
        before += move * turning
        direction = robot.moves[b, i]
        for j in range(TWIST):
            known[twist + j] += direction * place.twists[i, j]
    x, y, z = place.centres[b, 0], place.centres[b, 1], place.centres[b, 2]
    wx, wy, wz = known[twist + 3], known[twist + 4], known[twist + 5]
    vx, vy, vz = known[twist] + wy * z - wz * y, known[twist + 1] + wz * x - wx * z, known[twist + 2] + wx * y - wy * x
    known[turns] = math.sqrt(wx * wx + wy * wy + wz * wz)
    known[BENT] += bent
    straight = math.sqrt(vx * vx + vy * vy + vz * vz) + known[turns] * robot.radii[b]
    known[TRAVEL] += min(travel, share * straight + bent)


@uncounted
def bound_body(
    robot: RobotBodies, body: int, segment: int, share: float, place: BodyPoses, bounds: MotionBounds
) -> int:
    """Bound the motion of a body in a segment about a placement, as the world sees it; return its row of `known`."""
    if bounds.asked[body] != segment:
        known = bounds.known[body]
        for k in range(BOUNDS):
            known[k] = 0.0
        _of_body(robot, body, robot.moved_by[body], share, place, bounds, known, FIRST_TWIST, FIRST_TURNS)
        bounds.asked[body] = segment
    return body


@uncounted
def mover_travel(movers: MovingObstacles, mover: int, begin: float, end: float) -> float:
    """Return how far points of a moving obstacle get between two times at most, as bodies meet it [m]."""
    travel, first, last = 0.0, movers.begins[mover], movers.begins[mover + 1] - 1
    step = max(step_at(movers, mover, begin), first)
    while step < last and movers.times[step] < end:
        passed = min(end, movers.times[step + 1]) - max(begin, movers.times[step])
        travel += movers.speeds[step] * max(passed, 0.0)
        step += 1
    return travel


@uncounted
def mover_reach(movers: MovingObstacles, mover: int, place: BodyPoses, bounds: MotionBounds) -> float:
    """Return how far points of a moving obstacle get in the segment from where they are at the placement [m].

    The distance to keep from it grows with time, which counts as well.
    """
    now = place.moment[NOW]
    before, after = bounds.span[BEGINS], bounds.span[ENDS]
    growth = kept_from_mover(movers, mover, after) - kept_from_mover(movers, mover, now)
    return max(mover_travel(movers, mover, before, now), mover_travel(movers, mover, now, after)) + growth


@uncounted
def _bound_mover(movers: MovingObstacles, mover: int, place: BodyPoses, bounds: MotionBounds, bound: Floats) -> None:
    """Add the bounds of a moving obstacle in the segment to those of a body; write its twist.

    On a screw a point is accelerated by at most its speed times the rate at which it turns. Where the obstacle goes
    from one screw to the next, and of one without an end, the travel alone is known.
    """
    begin, end, now = bounds.span[BEGINS], bounds.span[ENDS], place.moment[NOW]
    travel = mover_reach(movers, mover, place, bounds)
    growth = kept_from_mover(movers, mover, end) - kept_from_mover(movers, mover, now)
    bound[TRAVEL] += travel
    for k in range(TWIST):
        bound[SECOND_TWIST + k] = 0.0
    bound[SECOND_TURNS] = 0.0
    if movers.endless[mover] == 1:
        for k in range(TWIST):
            bound[FIRST_TWIST + k] = 0.0
        bound[FIRST_TURNS] = 0.0
        bound[BENT] = bound[TRAVEL]
        return
    if travel == 0.0:
        return
    step, whole, half = step_at(movers, mover, begin), end - begin, max(end - now, now - begin)
    is_last = step + 1 >= movers.begins[mover + 1]
    if step < movers.begins[mover] or is_last or end > movers.times[step + 1]:
        bound[BENT] += travel
        return
    twist = movers.twists[step]
    turns = math.sqrt(twist[3] * twist[3] + twist[4] * twist[4] + twist[5] * twist[5])
    for k in range(TWIST):
        bound[SECOND_TWIST + k] = twist[k] * whole
    bound[SECOND_TURNS] = turns * whole
    bound[BENT] += 0.5 * turns * movers.speeds[step] * half * half + growth


@uncounted
def bound_pair(
    moving: MovingRobot, pair: int, segment: int, share: float, place: BodyPoses, bounds: MotionBounds
) -> int:
    """Bound the motion of both bodies of a pair about a placement; return its row of `bounds.known`.

    Arguments are as of `bound_body`. The row of a pair with a moving obstacle is overwritten by the next one.
    """
    robot, pairs, obstacles = moving.robot, moving.pairs, moving.obstacles
    own = pairs.own.shape[0]
    if pair >= own:
        first = bound_body(robot, first_body(pairs, obstacles, pair), segment, share, place, bounds)
        mover = obstacles.movers[obstacle_of(pairs, obstacles, pair)]
        if mover < 0:
            return int(first)
        both = bounds.known.shape[0] - 1
        for k in range(BOUNDS):
            bounds.known[both, k] = bounds.known[first, k]
        _bound_mover(moving.movers, mover, place, bounds, bounds.known[both])
        return int(both)
    row = robot.parent_joints.shape[0] + pair
    if bounds.asked[row] != segment:
        bound, a, b = bounds.known[row], pairs.own[pair, 0], pairs.own[pair, 1]
        for k in range(BOUNDS):
            bound[k] = 0.0
        _of_body(robot, a, pairs.first_by[pair], share, place, bounds, bound, FIRST_TWIST, FIRST_TURNS)
        _of_body(robot, b, pairs.second_by[pair], share, place, bounds, bound, SECOND_TWIST, SECOND_TURNS)
        bounds.asked[row] = segment
    return int(row)
