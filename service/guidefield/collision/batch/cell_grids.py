"""Lay out a cache of self-collision results: for pairs of links, grids of cells over the coordinates they depend on.

kernels/collide/self_narrowphase.py fills cells while it plans (apart, touching, or divided further) and shares what it
finds between all users of a robot. Columns are those of kernels/collide/layout.py. How far bodies may move within a
cell must not be too small, or contacts are missed; numbers of cells are memory and time, but that within `BAND` of
contact the answer may change, as long as float32 counts a grid's undivided cells (up to 2^24).
"""

from __future__ import annotations

import math
import mmap
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from guidefield.kernels.collide.layout import BAND, CHILDREN, GRID_NUMBERS, GRID_PLACES, GRID_SIDES
from guidefield.kernels.kinematics.batch_forward_kinematics import (
    JOINT,
    MULTIPLIER,
    OFFSET,
    SLIDING,
    TURNING,
    BatchJoints,
)

MOST_LARGEST_CELLS = (1, 1 << 12, 1 << 18, 1 << 18)  # most undivided cells of a grid over 0, 1, 2, 3 coordinates

MOST_IN_ALL = 1 << 22  # most undivided cells of all grids of a robot: each grid has an equal share of them
ALWAYS_ALLOWED = 1 << 10  # as many each grid may have, however many grids there are

SIDE_HALVINGS = (0, 6, 3, 2)
"""How often each side of a cell is halved, over 0, 1, 2, 3 coordinates: 64 = `CHILDREN` children in all."""

LEAST_MOTION, MOST_LEVELS = 5e-4, 4
"""Cells in which bodies move less than this past each other [m] aren't divided, and none more often than this."""

MOST_CHILDREN = 1 << 22  # room for children of cells, whose places are int32; when it is used up, no more are divided
MOTION_FACTOR = 1.001  # on the motion within a cell, because places on the grid are rounded to float32


class Grids(NamedTuple):
    """The arrays of kernels/collide/layout.py's `BatchBodies` of the same names, with nothing known of any cell.

    `cells` has a header of `CHILDREN`, whose first number says where the array is free; then each grid's undivided
    cells and the blocks of these that are tested together; then room for `MOST_CHILDREN`. `apart` has a bit for each
    number before that room.
    """

    grids: np.ndarray
    grid_numbers: np.ndarray
    cells: np.ndarray
    apart: np.ndarray


class _Side(NamedTuple):
    """One coordinate: which, its range, whether it wraps, and how far one unit of it moves the bodies at most [m]."""

    source: int
    lower: float
    width: float
    wraps: bool
    lever: float


def batch_grids(
    joints: BatchJoints,
    link_pairs: np.ndarray,
    link_joints: np.ndarray,
    covers: Sequence[np.ndarray],
    ranges: np.ndarray,
    most: np.ndarray,
) -> Grids:
    """Lay grids over the coordinates of link pairs that depend on three at most.

    The links of each pair are the first two columns of `link_pairs` (m, 4); `link_joints` has the joint of each link,
    `covers` balls (n, 4) that contain its bodies, `ranges` least and largest values (nv, 2). A link pair that depends
    on more than its `most` (m,) coordinates gets no grid: where its test is quick, cells don't pay.
    """
    numbers = joints.numbers.reshape(-1, JOINT)
    every: list[list[_Side] | None] = []
    for (a, b), allowed in zip(link_pairs[:, :2].tolist(), most.tolist(), strict=True):
        between = _joints_between(joints, numbers, int(link_joints[a]), int(link_joints[b]))
        sides = None if between is None else _sides(joints, numbers, between, (covers[a], covers[b]), ranges)
        every.append(None if sides is None or len(sides) > allowed else sides)
    share = max(ALWAYS_ALLOWED, MOST_IN_ALL // max(1, sum(sides is not None for sides in every)))
    places, values, cells = [], [], CHILDREN  # where children stand is above all verdicts on a cell
    for sides in every:
        if sides is None:
            places.append([0] * GRID_PLACES)
            values.append([0.0] * GRID_NUMBERS)
            continue
        place, row, moved, counts = [], [], 0.0, _counts(sides, min(share, MOST_LARGEST_CELLS[len(sides)]))
        for side, count in zip(sides, counts, strict=True):
            moved += MOTION_FACTOR * side.lever * 0.5 * side.width / count
        divided = SIDE_HALVINGS[len(sides)]
        levels = 0 if moved == 0.0 else math.ceil(math.log2(moved / LEAST_MOTION) / divided)
        levels = min(max(levels, 0), MOST_LEVELS)
        for index, (side, count) in enumerate(zip(sides, counts, strict=True)):
            smallest = count << divided * levels
            place += [side.source, smallest, 1 << divided * index]
            row += [side.lower, smallest / side.width, 0.5 / np.pi if side.wraps else 0.0]
        unused = GRID_SIDES - len(sides)
        together = cells + math.prod(counts)
        places.append([*place, *[0, 1 << divided * levels, 0] * unused, cells, levels, divided, together])
        values.append([*row, *[0.0] * 3 * unused, moved])
        cells = together + math.prod(-(-count >> divided) for count in counts)
    # mapped, because pages that nobody writes take no memory
    known = np.frombuffer(mmap.mmap(-1, 4 * (cells + MOST_CHILDREN)), np.int32)
    known[0] = cells
    return Grids(
        np.array(places, np.int64).reshape(-1, GRID_PLACES).ravel(),
        np.array(values, np.float32).reshape(-1, GRID_NUMBERS).ravel(),
        known,
        np.zeros(cells // 32 + 1, np.uint32),
    )


def _counts(sides: list[_Side], most: int) -> list[int]:
    """Count the undivided cells along each coordinate, so that a step along any moves bodies about as far."""
    reaches, counts = np.array([max(side.lever * side.width, BAND) for side in sides]), [1] * len(sides)
    ascending = np.argsort(reaches).tolist()
    for k, side in enumerate(ascending):
        further = reaches[ascending[k:]]
        counts[side] = min(most, max(1, int((most / further.prod()) ** (1.0 / len(further)) * reaches[side])))
        most //= counts[side]
    return counts


def _joints_between(joints: BatchJoints, numbers: np.ndarray, a: int, b: int) -> tuple[list[int], list[int]] | None:
    """Find the joints that move two joints' bodies past each other: above the first alone, and above the second alone.

    None if they depend on more than `GRID_SIDES` coordinates, or on one of a joint that neither turns nor slides.
    """
    above: tuple[list[int], list[int]] = ([], [])
    sources = set()
    while a != b:  # parents come before children
        joint = max(a, b)
        above[0 if a > b else 1].append(joint)
        if numbers[joint, MULTIPLIER] != 0.0:
            sources.add(int(joints.sources[joint]))
        if joints.kinds[joint] > SLIDING or len(sources) > GRID_SIDES:
            return None
        a, b = (int(joints.parents[a]), b) if a > b else (a, int(joints.parents[b]))
    return above


def _sides(
    joints: BatchJoints,
    numbers: np.ndarray,
    between: tuple[list[int], list[int]],
    covers: tuple[np.ndarray, np.ndarray],
    ranges: np.ndarray,
) -> list[_Side] | None:
    """Return the coordinates that a link pair depends on; None if one has no limits."""
    levers: dict[int, float] = {}
    wraps: dict[int, bool] = {}
    for moving, cover in zip(between, covers, strict=True):
        centres, radii = cover[:, :3], cover[:, 3]
        reach = float(
            (np.linalg.norm(centres[:, :2], axis=1) + radii).max()
        )  # from the axis of the link's joint, which is z
        beyond = float((np.linalg.norm(centres, axis=1) + radii).max())
        for joint in moving:
            source, factor = int(joints.sources[joint]), abs(float(numbers[joint, MULTIPLIER]))
            turning = joints.kinds[joint] == TURNING
            levers[source] = levers.get(source, 0.0) + factor * (reach if turning else 1.0)
            wraps[source] = wraps.get(source, True) and bool(turning) and factor == 1.0
            # what the joint above turns is as far from it at most
            beyond += float(np.linalg.norm(numbers[joint, [3, 7, 11]]))
            if not turning:
                ends = ranges[source] * numbers[joint, MULTIPLIER] if factor > 0.0 else np.zeros(2)
                beyond += float(np.abs(ends + numbers[joint, OFFSET]).max())
            reach = beyond
    sides = []
    for source in sorted(source for source in levers if levers[source] > 0.0):
        low, high = (-np.pi, np.pi) if wraps[source] else ranges[source]
        sides.append(_Side(source, float(low), float(high - low), wraps[source], levers[source]))
    bounded = all(np.isfinite([side.lower, side.width, side.lever]).all() and side.width > 0.0 for side in sides)
    return sides if bounded else None
