"""Proof that two bodies keep a distance while both move straight from a placement, by trees of spheres and slabs.

Let n be a direction along which two convex parts A and B are apart in the middle, and v and w how far their points move
by the whole of a twist each. Where both have moved by the share s of it, |s| <= h, the parts are apart along n by

    min over x in A of n.(x + s v(x))  -  max over y in B of n.(y + s w(y))

at least, and so in space. Bodies are rigid: v(x) = v + omega x x. So n.(x + s v(x)) = (n + s n x omega).x + s n.v, and
the farthest points along two turned directions tell. It is concave in s, and least at one of both ends. Any direction
will do: the last one is tried before GJK searches the nearest points. A ball about a node needs no direction: it
moves no farther than its centre and its own turning together. Rows of the log become proofs (`prove/proof.py`), which
the referee replays without searching. `NODE_ROUNDS` and `RATE` change time and how many segments: streams limit them.
"""

from __future__ import annotations

import math

from numba import types

from guidefield.kernels.collide.gjk import (
    LEAF_A,
    LEAF_B,
    PLACED,
    POSE_A,
    POSE_B,
    ROUNDS,
    STACK,
    axis_in,
    axis_length,
    divides_first,
    origins_apart,
    parts_distance,
    support,
)
from guidefield.kernels.collide.parts import (
    LEFT,
    PART,
    PLANE_OFFSET,
    POINTED_PARTS,
    RIGHT,
    Parts,
    X,
    Y,
    Z,
    ball_radius,
    child_of,
    is_leaf,
    kind_of,
    part_of,
    place_ball,
    place_part_of,
)
from guidefield.kernels.collide.primitive import HALF_SPACE
from guidefield.kernels.jit.arrays import DOUBLE_POINTER, Floats
from guidefield.kernels.jit.decorators import vector_part, vector_step

FIRST_TWIST, SECOND_TWIST, FIRST_TURNS, SECOND_TURNS, TWISTS = 0, 6, 12, 13, 14
"""Numbers of how two bodies move: the twist of each, how far the world's origin would move with it and how far it
turns, and the lengths of the latter; then how many there are."""

NODE_ROUNDS = 8
"""After how many rounds of GJK two nodes are divided: with 5 a UR5's own pairs take a fifth longer, and with 12 a
Baxter's a tenth."""

RATE = 0.02
"""The segment is halved instead of two nodes if their distance in the middle less what is asked is at least this share,
times the pairs of nodes visited, of what they may lose. With half or twice of it a UR5 takes a tenth longer."""

LATER = 1e30  # more than any distance [m]: `bodies_keep` returns a share of it where halves of the segment tell sooner

LOG_COUNT, LOG_CAPACITY, LOG_SEGMENT, LOG_PAIR, LOG_PATIENT, LOG_SPHERES, LOG_ROWS = range(7)
"""Numbers of a log: rows written, rows there is room for, the segment and the pair of what is written next, 1 where a
shorter segment isn't to be asked for, 1 where spheres told the last two nodes apart, and where the rows begin."""

ROW_SEGMENT, ROW_PAIR, ROW_A, ROW_B, ROW_AXIS, LOG_ROW = 0, 1, 2, 3, 4, 7
"""Columns of a row: segment, pair, a node of each body, and the direction across which they are separated, 0 where
their spheres tell it; then their number."""

NODE_A, NODE_B, ENTRY = range(3)  # numbers of an entry of the stack: a node of each body; then how many there are


@vector_part
def _centres_move(twists: Floats, work: Floats) -> float:
    """Distance by which both twists move the origins of the two poses in the scratch relative to each other [m]."""
    x, y, z = work[POSE_A + X], work[POSE_A + Y], work[POSE_A + Z]
    u, v, w = work[POSE_B + X], work[POSE_B + Y], work[POSE_B + Z]
    dx = twists[0] + twists[4] * z - twists[5] * y - (twists[6] + twists[10] * w - twists[11] * v)
    dy = twists[1] + twists[5] * x - twists[3] * z - (twists[7] + twists[11] * u - twists[9] * w)
    dz = twists[2] + twists[3] * y - twists[4] * x - (twists[8] + twists[9] * v - twists[10] * u)
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@vector_part
def _farthest(
    parts: Parts,
    part: int,
    pose: int,
    twists: Floats,
    twist: int,
    radius: float,
    n: tuple[float, float, float],
    s: float,
    work: Floats,
) -> float:
    """The most of (n + s n x omega).x + s n.v over the points x of a part, with what rounds it [m]."""
    nx, ny, nz = n
    ox, oy, oz = twists[twist + 3], twists[twist + 4], twists[twist + 5]
    dx, dy, dz = nx + s * (ny * oz - nz * oy), ny + s * (nz * ox - nx * oz), nz + s * (nx * oy - ny * ox)
    px, py, pz = support(parts.shapes, parts.numbers, parts.vertices, part, work, pose, dx, dy, dz)
    moved = s * (nx * twists[twist] + ny * twists[twist + 1] + nz * twists[twist + 2])
    rounded = radius * math.sqrt(dx * dx + dy * dy + dz * dz) if radius > 0.0 else 0.0
    return float(dx * px + dy * py + dz * pz + moved + rounded)


@vector_part
def _second_rests(twists: Floats) -> bool:
    return bool(
        twists[SECOND_TURNS] == 0.0
        and twists[SECOND_TWIST] == 0.0
        and twists[SECOND_TWIST + 1] == 0.0
        and twists[SECOND_TWIST + 2] == 0.0
    )


@vector_step(
    types.float64(
        POINTED_PARTS,
        types.int64,
        types.float64,
        POINTED_PARTS,
        types.int64,
        types.float64,
        DOUBLE_POINTER,
        types.float64,
        types.float64,
        DOUBLE_POINTER,
    )
)
def _keep_along(
    a: Parts,
    part_a: int,
    radius_a: float,
    b: Parts,
    part_b: int,
    radius_b: float,
    twists: Floats,
    share: float,
    asked: float,
    work: Floats,
) -> float:
    """Return the distance that two parts keep along the axis as both move by up to a share of their twists [m].

    If it is less than `asked`, some number between both.
    """
    x, y, z = axis_in(work)
    length = axis_length(work)
    n, back = (x / length, y / length, z / length), (-x / length, -y / length, -z / length)
    far, rests, kept = 0.0, _second_rests(twists), math.inf
    for side in range(2):
        s = share if side == 0 else -share
        if part_b >= 0 and kind_of(b, part_b) == HALF_SPACE:
            far = b.numbers[PART * part_b + PLANE_OFFSET]
        elif side == 0 or not rests:
            far = _farthest(b, part_b, POSE_B, twists, SECOND_TWIST, radius_b, n, s, work)
        kept = min(kept, -_farthest(a, part_a, POSE_A, twists, FIRST_TWIST, radius_a, back, s, work) - far)
        if not kept >= asked:
            break
    return kept


@vector_step(
    types.float64(
        *PLACED, *PLACED, DOUBLE_POINTER, types.float64, types.float64, types.float64, DOUBLE_POINTER, DOUBLE_POINTER
    )
)
def _nodes_keep(
    a: Parts,
    node_a: int,
    pose_a: Floats,
    b: Parts,
    node_b: int,
    pose_b: Floats,
    twists: Floats,
    share: float,
    asked: float,
    bent: float,
    work: Floats,
    log: Floats,
) -> float:
    """Return infinity if all in two nodes keeps what is asked; else the distance of two leaves.

    Of other nodes minus infinity, or a share of `LATER`.
    """
    part_a, part_b, leaves = part_of(a, node_a), part_of(b, node_b), is_leaf(a, node_a) and is_leaf(b, node_b)
    radius_a, radius_b = ball_radius(a.balls, node_a), ball_radius(b.balls, node_b)
    place_ball(a, node_a, pose_a, work, POSE_A)
    place_ball(b, node_b, pose_b, work, POSE_B)
    travel, log[LOG_SPHERES] = math.inf, 0.0
    if radius_b < math.inf:
        apart = math.sqrt(origins_apart(work)) - float(radius_a + radius_b)
        turning = twists[FIRST_TURNS] * radius_a + twists[SECOND_TURNS] * radius_b
        travel = share * float(_centres_move(twists, work) + turning)
        if apart >= asked + travel:
            log[LOG_SPHERES] = 1.0
            return math.inf
        if part_a < 0 and part_b < 0:
            return -math.inf
    rounds_a = place_part_of(a, node_a, pose_a, work, POSE_A)
    rounds_b = place_part_of(b, node_b, pose_b, work, POSE_B)
    # the last axis often separates these, too
    if axis_length(work) > 0.0 and (
        _keep_along(a, part_a, rounds_a, b, part_b, rounds_b, twists, share, asked, work) >= asked
    ):
        return math.inf
    most, rounds, least = asked + travel, ROUNDS if leaves else NODE_ROUNDS, -math.inf if leaves else asked
    apart = parts_distance(a, part_a, b, part_b, rounds_a + rounds_b, least, most, rounds, work)
    later = -math.inf
    # what GJK ends with needs no trust: only the slab across its axis counts
    if apart > (asked if leaves else asked - bent):
        kept = _keep_along(a, part_a, rounds_a, b, part_b, rounds_b, twists, share, asked, work)
        if kept >= asked:
            return math.inf
        later = LATER * float((apart - asked + bent) / (apart - kept + bent))
    return float(apart) if leaves else later


@vector_part
def write_closed(log: Floats, node_a: int, node_b: int, work: Floats) -> None:
    """Write to a log (n,) that two nodes are separated across the axis, or by their spheres; rows are counted on."""
    if log[LOG_CAPACITY] == 0.0:
        return
    count = int(log[LOG_COUNT])
    log[LOG_COUNT] += 1.0
    if count < int(log[LOG_CAPACITY]):
        row = LOG_ROWS + LOG_ROW * count
        x, y, z = axis_in(work)
        by_axis = 1.0 - log[LOG_SPHERES]
        log[row + ROW_SEGMENT], log[row + ROW_PAIR] = log[LOG_SEGMENT], log[LOG_PAIR]
        log[row + ROW_A], log[row + ROW_B] = node_a, node_b
        log[row + ROW_AXIS], log[row + ROW_AXIS + 1], log[row + ROW_AXIS + 2] = by_axis * x, by_axis * y, by_axis * z


@vector_step(
    types.float64(
        *PLACED, *PLACED, DOUBLE_POINTER, types.float64, types.float64, types.float64, DOUBLE_POINTER, DOUBLE_POINTER
    )
)
def bodies_keep(
    a: Parts,
    root_a: int,
    pose_a: Floats,
    b: Parts,
    root_b: int,
    pose_b: Floats,
    twists: Floats,
    share: float,
    asked: float,
    bent: float,
    work: Floats,
    log: Floats,
) -> float:
    """Return infinity if two bodies keep a distance as both move by the same share of their twists.

    Poses (12,) are those in the middle [m], roots those of trees of balls, `twists` (TWISTS,) [m and rad, world] move
    them by at most `share`, there and back. `asked` is the distance, above 0 [m], of which `bent` is how far points may
    be from where the twists bring them. Only the second may be a half-space, and that rests. The search begins with the
    axis and the leaves in `work` (WORK,), and leaves its last axis, and the leaves that didn't keep the distance; `log`
    (n,) gets a row for each two nodes that are separated.

    Else it returns the distance in the middle of two of their leaves, which may be larger than the bodies', or more
    than any distance, where it is sooner told in halves of the time [m].
    """
    top = STACK + ENTRY
    work[STACK + NODE_A], work[STACK + NODE_B] = root_a, root_b
    if work[LEAF_A] > 0.0:
        node_a, node_b = int(work[LEAF_A]) - 1, int(work[LEAF_B]) - 1
        kept = _nodes_keep(a, node_a, pose_a, b, node_b, pose_b, twists, share, asked, bent, work, log)
        if kept < math.inf:
            return kept
        if node_a == root_a and node_b == root_b:
            write_closed(log, node_a, node_b, work)
            return math.inf
    visited = 0
    while top > STACK:
        top -= ENTRY
        visited += 1
        node_a, node_b = int(work[top + NODE_A]), int(work[top + NODE_B])
        kept = _nodes_keep(a, node_a, pose_a, b, node_b, pose_b, twists, share, asked, bent, work, log)
        if kept == math.inf:
            write_closed(log, node_a, node_b, work)
            continue
        if kept >= LATER * RATE * visited and log[LOG_PATIENT] == 0.0:
            return kept
        if is_leaf(a, node_a) and is_leaf(b, node_b):
            work[LEAF_A], work[LEAF_B] = node_a + 1, node_b + 1
            return kept
        split_a = divides_first(a, node_a, b, node_b)
        for side in (LEFT, RIGHT):
            work[top + NODE_A] = child_of(a, node_a, side) if split_a else node_a
            work[top + NODE_B] = node_b if split_a else child_of(b, node_b, side)
            top += ENTRY
    return math.inf
