"""Tables of a robot's bodies and of obstacles for kernels of SIMD batches, their scratch memory, and their words.

`collision/batch` fills them: `robot_tables` and `cell_grids` the robot, `scene_tables` the obstacles (by
`primitive.primitive_tables`) and the scratch. A world reaches a kernel as words in the order of `BatchWorld` and of the
tuples in it, which `batch_collision.py` and `lay_out` write, at the offsets of `scene_tables`: a field of `BatchWorld`
has to be added, moved or removed there, too, and one of a tuple where that is filled.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.kernels.collide.parts import Parts
from guidefield.kernels.jit.arrays import (
    Bits,
    Cells,
    IndexRows,
    Indices,
    IndicesOut,
    Integers,
    Row,
    RowOut,
    Singles,
    SinglesOut,
    numba_type,
)
from guidefield.kernels.jit.decorators import inner_kernel, kernel, vector_part
from guidefield.kernels.kinematics.batch_forward_kinematics import BatchJoints
from guidefield.kernels.simd.packing import pointed, unpacked

# Within this of contact [m] either answer may come (`collision/batch/batch_collision.py`): more than the error of tests
# in float32.
BAND = 1e-5
DECISION_BAND = 2e-6  # GJK's margin [m], within `BAND`: more than `gjk.ACCURACY`, and placements' errors; never less

REACH, AXIS_AND_REACH = 3, 4
"""Numbers of a separating axis: the unit vector, and how far one body reaches along it; all 0 where there is none."""

HITS = 4  # number of balls, at least 1, that met an obstacle last and are tried first: a matter of speed

BODY, OBSTACLE, BALL, HIT = range(4)
"""Columns of a hit: a body, the obstacle that it met, the ball inside the body; then how many columns there are."""

MASK, FOUND = 2, 3
"""Columns of a near pair: after body and obstacle, or -1 and the own pair, the mask of lanes; then how many columns
there are."""

LINK_A, LINK_B, FIRST_PAIR, PAST_PAIR, LINK_PAIR = range(5)
"""Columns of a link pair: its links, its first pair of bodies and the one past its last; then how many there are."""

BODY_A, BODY_B, PAIR_AXES, PAIR = range(4)
"""Columns of a pair: its bodies, and where the axes of its pairs of pieces begin; then how many columns there are."""

GRID_SIDES = 3  # coordinates that a grid of cells has at most: `self_narrowphase` names each, as a, b and c

SOURCE, COUNT, STEP, SIDE = range(4)
"""Whole numbers of each of a grid's sides: the coordinate, how many of the smallest cells are along it, the distance in
`cells` between a cell's children that are neighbours along it; then how many numbers there are."""

START, LEVELS, DIVIDED, TOGETHER, GRID_PLACES = range(SIDE * GRID_SIDES, SIDE * GRID_SIDES + 5)
"""Behind its sides' whole numbers a grid has: where its largest cells begin in `cells`, how often they are divided, by
how many powers of 2 along a side, and where the verdicts on blocks of that many of them begin; then how many there
are."""

LEAST, PER_LENGTH, WRAPS = range(3)
"""Real numbers of each of a grid's sides: the least value, smallest cells per length, 1 / (2 pi) if it wraps or 0."""

MOVED, GRID_NUMBERS = SIDE * GRID_SIDES, SIDE * GRID_SIDES + 1
"""Behind them stands how far motions within one of the largest cells move bodies past each other; then how many numbers
there are."""

CHILDREN = 64  # cells that a cell is divided into, as `collision/batch/cell_grids.py` halves its sides

HALF_SIDES, ROUNDING, ROUNDED_BOX = 12, 15, 16
"""Numbers of a rounded box: behind its placement, rotation and translation row by row, the halves of its sides and the
radius of the rounding [m]; then how many numbers there are."""

VELOCITY, KEPT, KEPT_AT_START, KEPT_AT_GOAL, DRIFTING_BOX = 16, 19, 20, 21, 22
"""Behind these numbers of one that drifts stand its velocity [m/s], and the distance kept from it anywhere, at the
start and at the goal [m]; then how many numbers there are."""

HORIZON, WIDENING = 0, 1  # numbers of `DriftingBoxes`
CLOUD = 6  # the kind of an obstacle that is balls about points, beside those of `primitive`; its primitive is unused


class BatchBodies(NamedTuple):
    """The robot's bodies; lengths [m] in the frame of the joint that carries a body.

    A *link* is all bodies that one joint carries; a link pair is two links, some of whose bodies must not touch. Balls
    contain each other: those about a link's bodies, about a body, about a group of its cover's balls, the cover's.
    """

    size: int  # n
    n_links: int  # m
    moving: int  # how many of them move in the world: the first ones, those far out first
    n_link_pairs: int
    n_cells: int  # how long `cells` is
    joints: Indices  # (n,) the joint that carries each body
    link_joints: Indices  # (m,) the joint of each link
    members: Indices  # (m + 1,) where the bodies of each link begin in `order`
    order: Indices  # (n,) the bodies, link by link
    groups: Indices  # (n + 1,) where the groups of each body's cover begin
    covers: Indices  # (groups + 1,) where the balls of each group begin in `cover`
    inners: Indices  # (n + 1,) where a body's inner balls begin in `inner`
    roots: Indices  # (n,) its hull's node in the robot's parts
    surface_roots: Indices  # (n,) its root in the robot's surfaces
    # (n + 1,) where the pieces of each body begin: a body that isn't convex is cut into nearly convex ones
    pieces: Indices
    piece_roots: Indices  # (pieces,) the node of each one's hull in the robot's parts
    link_pairs: Indices  # (LINK_PAIR * n_link_pairs,) the links of each pair, and which pairs of bodies are theirs
    # (GRID_PLACES * n_link_pairs,) whole numbers of each link pair's grid; all 0 where bodies' distance depends on more
    # coordinates
    grids: Indices
    # (PAIR * p,) bodies that must not touch each other, and where the axes of their pairs of pieces begin
    pairs: Indices
    around: Singles  # (BALL_ROW * m,) a ball about each link's bodies
    bounds: Singles  # (BALL_ROW * n,) a ball about each body
    piece_bounds: Singles  # (BALL_ROW * pieces,) a ball about each piece
    # (12 * n,) where the frame of its surface is in that of the joint, rotation and translation row by row
    surface_frames: Row
    grouped: Singles  # (BALL_ROW * groups,) a ball about each group
    cover: Singles  # (BALL_ROW * c,) balls that contain the bodies
    inner: Singles  # (BALL_ROW * i,) balls that are inside them
    grid_numbers: Singles  # (GRID_NUMBERS * n_link_pairs,) real numbers of the grids
    # (n_cells,) verdicts on the grids' cells, or where a cell's children begin, as `self_narrowphase` has them; int32,
    # written by the kernels. The first number says from where on the array is free.
    cells: Cells
    # a bit for each number before those of cells' children, set where one of the largest is known to keep the bodies
    # apart: few lines of the cache tell most of what is asked. uint32, written by the kernels.
    apart: Bits


class BatchObstacles(NamedTuple):
    """Obstacles, in the world [m]; one of many triangles stands as several."""

    size: int  # n
    kinds: Indices  # (n,) kind of the primitive that contains each, or `CLOUD`
    whole: Indices  # (n,) 1 where that primitive is the obstacle itself, 0 where it only contains it
    roots: Indices  # (n,) its root in the scene's parts
    ignored: Indices  # (bodies * n,) 1 where the body isn't tested against it
    primitives: Singles  # (PRIMITIVE * n,) float32
    boxes: Singles  # (AROUND * blocks,) boxes about them along the world's axes; unused places hold empty ones
    clouds: Indices  # (n,) the address of the words of each one's `BatchCloud`; 0 of all other kinds


class DriftingBoxes(NamedTuple):
    """Rounded boxes that drift, and what motions from a start to a goal keep from them."""

    size: int  # n; 0: nothing drifts
    boxes: Singles  # (DRIFTING_BOX * n,) [m, world]
    ends: Singles  # (2 * nv,) start and goal, local coordinates
    rates: Singles  # (nv,) the shortest time that each coordinate takes for a unit [s/rad or s/m]
    periods: Singles  # (nv,) of each coordinate that wraps; 0 of others
    # (2,) how far ahead the boxes' motion is foreseen [s], and how much more than at an end is kept for each second
    # from there [m/s]
    numbers: Singles


class Scratch(NamedTuple):
    """Memory that a search uses again and again.

    Only axes and hits mean anything between calls: with what separated bodies or met last, the next question begins.
    """

    poses: SinglesOut  # (joints * POSE,) placements
    centres: SinglesOut  # (m * BLOCK,) centres of the balls about links
    # (FOUND * (bodies * obstacles + pairs),) what is near what: body, obstacle and mask, or -1, pair and mask
    found: IndicesOut
    obstacle_axes: RowOut  # (AXIS_AND_REACH * bodies * obstacles,) in the world; how far the obstacle reaches along it
    pair_axes: RowOut  # (AXIS_AND_REACH * pairs of pieces,) in the first one's frame; how far that reaches against it
    # obstacle_places, pair_places: (1 + bodies * obstacles,) and (1 + pairs of pieces,) how many axes there are, then
    # where they are
    obstacle_places: IndicesOut
    pair_places: IndicesOut
    # pose_a, pose_b: (12,) each
    pose_a: RowOut
    pose_b: RowOut
    # surface_a, surface_b: (12,) each, the poses of two bodies' surfaces
    surface_a: RowOut
    surface_b: RowOut
    work: RowOut  # (WORK,)
    # middle, middle_poses: (nv * 16,) and (joints * POSE,), the middle of a cell
    middle: SinglesOut
    middle_poses: SinglesOut
    places: SinglesOut  # ((GRID_SIDES + 1) * 16,) where on a grid a block's configurations are
    # (HIT * HITS,) the last inner balls that met an obstacle: body, obstacle, ball; -1 where there is none yet
    hits: IndicesOut


BATCH_BODIES = numba_type(BatchBodies)
BATCH_OBSTACLES = numba_type(BatchObstacles)
SCRATCH = numba_type(Scratch)

BODIES, OBSTACLES, SCRATCH_MEMORY = pointed(BATCH_BODIES), pointed(BATCH_OBSTACLES), pointed(SCRATCH)


class BatchWorld(NamedTuple):
    """A robot among obstacles, for SIMD batches."""

    # joints, bodies: The robot
    joints: BatchJoints
    bodies: BatchBodies
    parts: Parts  # hulls of its bodies and of their pieces, in the turned frames of joints
    surfaces: Parts  # the bodies themselves, as proofs have them
    fractions: Singles  # `batch_collision.FRACTIONS`, and by how much each coordinate counts, (16 + nv,): 1 for angles
    nv: int  # how many coordinates a configuration has
    # obstacles, scene: What is around it
    obstacles: BatchObstacles
    scene: Parts
    scratch: Scratch  # memory; so a world answers one question at a time
    block: SinglesOut  # (nv * 16,) memory for the configurations of one block
    drifting: DriftingBoxes  # what motions keep from besides


BATCH_WORLD = numba_type(BatchWorld)
WORLD = pointed(BATCH_WORLD)

world_of = unpacked(BATCH_WORLD)  # makes a world of its words


class BatchRobotTables(NamedTuple):
    """A robot without obstacles, for SIMD batches."""

    # joints, bodies, parts, surfaces: The robot, as `BatchWorld` has it
    joints: BatchJoints
    bodies: BatchBodies
    parts: Parts
    surfaces: Parts
    scratch: Scratch  # memory


BATCH_ROBOT_TABLES = numba_type(BatchRobotTables)
ALONE = pointed(BATCH_ROBOT_TABLES)

alone_of = unpacked(BATCH_ROBOT_TABLES)  # makes a robot without obstacles of its words


@vector_part
def robot_of(world: BatchWorld) -> BatchRobotTables:
    """The robot of a world."""
    return BatchRobotTables(world.joints, world.bodies, world.parts, world.surfaces, world.scratch)


@vector_part
def pair_of(bodies: BatchBodies, pair: int) -> tuple[int, int]:
    """The bodies of a pair."""
    return bodies.pairs[PAIR * pair + BODY_A], bodies.pairs[PAIR * pair + BODY_B]


@vector_part
def links_of(bodies: BatchBodies, link_pair: int) -> tuple[int, int]:
    """The links of a link pair."""
    return bodies.link_pairs[LINK_PAIR * link_pair + LINK_A], bodies.link_pairs[LINK_PAIR * link_pair + LINK_B]


@vector_part
def pairs_of(bodies: BatchBodies, link_pair: int) -> tuple[int, int]:
    """The first pair of bodies of a link pair, and the one past its last."""
    return bodies.link_pairs[LINK_PAIR * link_pair + FIRST_PAIR], bodies.link_pairs[LINK_PAIR * link_pair + PAST_PAIR]


@vector_part
def axis_place(obstacles: BatchObstacles, body: int, obstacle: int) -> int:
    """Return where the separating axis of a body and an obstacle is kept."""
    return AXIS_AND_REACH * (body * obstacles.size + obstacle)


@vector_part
def write_found(found: Integers, count: int, body: int, other: int, mask: int) -> int:
    """Write a near pair behind `count` others in `found` (FOUND * n,); how many there are then."""
    at = FOUND * count
    found[at + BODY], found[at + OBSTACLE], found[at + MASK] = body, other, mask
    return count + 1


LINE = 64  # bytes of a line of the cache, a multiple of 8: sixteen floats across two of them take twice as long
SCENE_WORDS = len(BatchObstacles._fields) + len(Parts._fields)  # number of words of obstacles and their shapes

_IGNORED = BatchObstacles._fields.index("ignored")

MEMORY_WORDS = len(Scratch._fields) + 1  # number of words behind those: of the scratch and the block
DRIFT_WORDS = len(DriftingBoxes._fields)  # and behind those, not written here

_HITS = 1 + Scratch._fields.index("hits")


@inner_kernel
def _write_left_out(left_out: IndexRows, owners: Indices, ignored: IndicesOut) -> None:
    """Mark what may touch: for each body all obstacles that stand for one of the scene."""
    n, most = len(owners), -1
    for o in range(n):
        most = max(most, owners[o])
    last, before = np.full(most + 1, -1), np.empty(n, np.int64)
    for o in range(n):
        before[o] = last[owners[o]]
        last[owners[o]] = o
    for p in range(len(left_out)):
        o = last[left_out[p, 1]] if left_out[p, 1] <= most else -1
        while o >= 0:
            ignored[left_out[p, 0] * n + o] = 1
            o = before[o]


@kernel
def lay_out(
    robot: Indices,
    scene: Indices,
    offsets: Indices,
    owners: Indices,
    bodies: int,
    moving: Indices,
    left_out: IndexRows,
    memory: IndicesOut,
    words: IndicesOut,
) -> int:
    """Write a world's words, and what its memory holds at first; return where that begins [bytes].

    `scene` (SCENE_WORDS,) has the words of obstacles and their shapes, `offsets` (1 + MEMORY_WORDS,) is where in the
    memory there is what may touch, the scratch and the block [bytes], `owners` (n,) names the obstacle of the scene
    that each represents, `moving` (m,) are the bodies tested against obstacles, ascending, but for the pairs `left_out`
    (k, 2). The memory is all zero; what is in it begins where a line of the cache does.
    """
    first, n, begins = len(robot), len(owners), -memory.ctypes.data % LINE
    start = memory.ctypes.data + begins
    words[:first] = robot
    words[first : first + SCENE_WORDS] = scene
    words[first + _IGNORED] = start + offsets[0]
    for k in range(MEMORY_WORDS):
        words[first + SCENE_WORDS + k] = start + offsets[1 + k]
    at = (begins + offsets[_HITS]) // 8
    memory[at : at + HIT * HITS] = -1
    at = (begins + offsets[0]) // 8
    k = 0
    for body in range(bodies):  # of a mesh of very many triangles little is written: most stays as it is
        if k < len(moving) and moving[k] == body:
            k += 1
        else:
            memory[at + body * n : at + (body + 1) * n] = 1
    if len(left_out):
        _write_left_out(left_out, owners, memory[at:])
    return begins
