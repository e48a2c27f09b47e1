"""How far a pair's bodies move relative to each other about a place, and how far from going straight: rigorous bounds.

Let x(t) be how far the coordinates are at time t from where they are in the middle of a stretch, D how far they go from
its one end to its other, and x = l D + e, where l D is the nearest to x on the line along D. Control points of x bound
all three: x by X, l by the share L, and e by E, coordinate by coordinate. To first order a point moves by l J D, a
rigid motion by the twist J D; that it moves by J e besides is at most the sum of r E, with r how far the point is from
each axis. What is of higher order is no more than half of what the point is accelerated by where the coordinates go
straight from 0 to x in the time 1, the sum of r_i X_i (2 (X_1 + .. + X_i-1) + X_i) over the joints from the world to
it, as in `collision.closing`, with r no less than anywhere on the way. How fast the motion goes through its way, and
whether its rates jump, doesn't count.

Movers are the bodies, as the world sees them, and the two bodies of own pairs, both as some body between them sees
them: how far apart points are is the same from anywhere. A short body that a joint turns beside a long one moves less
than that, seen from the long one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import Floats, Integers
from guidefield.kernels.prove.curve_ways import find_ways
from guidefield.kernels.prove.kept_distance import FIRST_TURNS, FIRST_TWIST, SECOND_TURNS, SECOND_TWIST, TWISTS
from guidefield.kernels.prove.places import TWIST, Place, Room
from guidefield.kernels.prove.tables import MovingRobot, RobotBodies

BENT, TRAVEL, BOUNDS = TWISTS, TWISTS + 1, TWISTS + 2
"""Numbers of a mover, behind the twists of its bodies along D: bounds of how far points are from where these bring
them, and of how far they move from where they are in the middle [m]; then how many there are."""


class Ways(NamedTuple):
    """How far a motion goes within a stretch; see this file.

    Attributes:
        parts: Scratch, shape (2, MOST_ORDER, nv).
        farthest, aside: X and E of the group's coordinates, shape (nv,).
        squares: Scratch, shape (n,).
        moves, asides: X and E of the model's coordinates, shape (n,), each in the first of those that make one move.
        sweeps: How far each joint moves a point at a distance of 1 from the middle of the stretch on, shape (n,).
        rho: Scratch, shape (n,).
        known: What is known of each mover, shape (r + own, BOUNDS).
        asked: For which stretch it is known, shape (r + own,).
    """

    parts: Floats
    farthest: Floats
    aside: Floats
    squares: Floats
    moves: Floats
    asides: Floats
    sweeps: Floats
    rho: Floats
    known: Floats
    asked: Floats


@uncounted
def _spread(robot: RobotBodies, sizes: Floats, ways: Ways, out: Floats) -> None:
    """Sizes of the joints' moves of those of the group's coordinates, shape (nv,)."""
    n = robot.offset.shape[0]
    for i in range(n):
        total = 0.0
        for j in range(sizes.shape[0]):
            total += robot.half_widths[i, j] * sizes[j]
        ways.squares[i] = total * total
    for i in range(n):
        square = ways.squares[i]
        if robot.alone[i] == 0.0:
            square = 0.0
            for k in range(n):
                square += robot.together[k, i] * ways.squares[k]
        out[i] = math.sqrt(square)


@uncounted
def find_moves(moving: MovingRobot, since: float, until: float, room: Room, ways: Ways) -> float:
    """Find how far a motion goes between two times [s] from where the robot was placed last; L.

    D of the model's coordinates is written to the scratch of that place, as what changes.
    """
    robot = moving.robot
    share = find_ways(
        moving.curve, since, until, room.z, room.weights, ways.parts, room.straight, ways.farthest, ways.aside
    )
    for i in range(robot.offset.shape[0]):
        room.changes[i] = 0.0
        for j in range(room.z.shape[0]):
            room.changes[i] += robot.expand[i, j] * room.straight[j]
    _spread(robot, ways.farthest, ways, ways.moves)
    _spread(robot, ways.aside, ways, ways.asides)
    for i in range(robot.offset.shape[0]):
        move = ways.moves[i]
        ways.sweeps[i] = 2.0 * math.sin(0.5 * min(move, math.pi)) if robot.turns[i] != 0.0 else move
    return share


@uncounted
def _reach(robot: RobotBodies, b: int, by: Integers, count: int, place: Place, ways: Ways) -> float:
    """Write how far a body is from the axes of some coordinates at the place; how far they sweep it, together [m].

    See `MotionBound.reach`. Coordinates of one joint stand together.
    """
    x, y, z = place.centres[b, 0], place.centres[b, 1], place.centres[b, 2]
    for k in range(count):
        S = place.subspaces[by[k]]
        vx, vy, vz = S[0] + S[4] * z - S[5] * y, S[1] + S[5] * x - S[3] * z, S[2] + S[3] * y - S[4] * x
        ways.squares[by[k]] = vx * vx + vy * vy + vz * vz
    swept = 0.0
    for k in range(count):
        i = by[k]
        square = ways.squares[i]
        if robot.alone[i] == 0.0:
            square = 0.0
            for other in range(count):
                square += robot.centred[by[other], i] * ways.squares[by[other]]
        ways.rho[i] = math.sqrt(square) + robot.turns[i] * robot.radii[b]
        swept += ways.rho[i] * ways.sweeps[i]
    return swept


@uncounted
def _of_body(
    robot: RobotBodies,
    b: int,
    by: Integers,
    share: float,
    place: Place,
    ways: Ways,
    known: Floats,
    twist: int,
    turns: int,
) -> None:
    """Add the bounds of a body that some coordinates, those before -1 (n,), in order, move; write its twist.

    The first moves all others. A coordinate that doesn't move the body in the world is passed against its direction:
    whoever sees the body is moved by it instead.
    """
    count = 0
    while count < by.shape[0] and by[count] >= 0:
        count += 1
    swept = _reach(robot, b, by, count, place, ways)
    before, travel, bent = 0.0, 0.0, 0.0
    for k in range(TWIST):
        known[twist + k] = 0.0
    for k in range(count):
        i = by[k]
        turning, move = robot.turns[i], ways.moves[i]
        # whatever is between is no farther from the middle than what is swept
        rho = ways.rho[i] + swept * turning
        travel += rho * move
        bent += ways.rho[i] * ways.asides[i] + rho * move * (before + 0.5 * robot.doubled[i] * move)
        before += move * turning
        way = robot.moves[b, i]
        for j in range(TWIST):
            known[twist + j] += way * place.twists[i, j]
    x, y, z = place.centres[b, 0], place.centres[b, 1], place.centres[b, 2]
    wx, wy, wz = known[twist + 3], known[twist + 4], known[twist + 5]
    vx, vy, vz = known[twist] + wy * z - wz * y, known[twist + 1] + wz * x - wx * z, known[twist + 2] + wx * y - wy * x
    known[turns] = math.sqrt(wx * wx + wy * wy + wz * wz)
    known[BENT] += bent
    straight = math.sqrt(vx * vx + vy * vy + vz * vz) + known[turns] * robot.radii[b]
    known[TRAVEL] += min(travel, share * straight + bent)


@uncounted
def body_closing(robot: RobotBodies, body: int, stretch: int, share: float, place: Place, ways: Ways) -> int:
    """Find the bounds of a body's mover about a place, as the world sees it; its row of `ways.known`.

    Args:
        robot: The robot.
        body: Which of its bodies.
        stretch: Number of the stretch, another one for each.
        share: L of it.
        place: The robot in its middle.
        ways: How far the motion goes in it.
    """
    if ways.asked[body] != stretch:
        known = ways.known[body]
        for k in range(BOUNDS):
            known[k] = 0.0
        _of_body(robot, body, robot.moved_by[body], share, place, ways, known, FIRST_TWIST, FIRST_TURNS)
        ways.asked[body] = stretch
    return body


@uncounted
def closing_of(moving: MovingRobot, pair: int, stretch: int, share: float, place: Place, ways: Ways) -> int:
    """Find the bounds of a pair's mover about a place; its row of `ways.known`. Arguments are as of `body_closing`."""
    robot, pairs = moving.robot, moving.pairs
    if pair >= pairs.first_by.shape[0]:
        mover: int = body_closing(robot, pairs.first[pair], stretch, share, place, ways)
        return mover
    mover = robot.carriers.shape[0] + pair
    if ways.asked[mover] != stretch:
        known, a, b = ways.known[mover], pairs.first[pair], pairs.second[pair]
        for k in range(BOUNDS):
            known[k] = 0.0
        _of_body(robot, a, pairs.first_by[pair], share, place, ways, known, FIRST_TWIST, FIRST_TURNS)
        _of_body(robot, b, pairs.second_by[pair], share, place, ways, known, SECOND_TWIST, SECOND_TURNS)
        ways.asked[mover] = stretch
    return mover
