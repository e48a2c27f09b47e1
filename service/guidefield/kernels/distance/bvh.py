"""Bounding volume hierarchies over triangles, points and boxes: orders, builders, a refit, the overlaps of boxes.

Triangles and points are halved at the median along the widest side of their box (Hoare's selection); boxes stand in the
order that their caller gives them, such as that of the Morton curve (`geometry/curve_order.py`). The levels of boxes
above are a refit: they are found from the leaves up. Queries compute children from a node's number: the layouts of
`boxes_of_pairs` (`triangle_distance`, `distance`, `winding`, `points_distance`), `fill_tree` (`point_tree`) and
`boxes_above` (`boxes_met`) are theirs, too.
"""

from __future__ import annotations

import math

import numpy as np

from guidefield.kernels.distance.point_tree import NOWHERE
from guidefield.kernels.jit.arrays import (
    Blocks,
    Floats,
    IndexRowsOut,
    Indices,
    IndicesOut,
    Integers,
    Row,
    RowOut,
    Rows,
    RowsOut,
    SinglesOut,
)
from guidefield.kernels.jit.decorators import exact_kernel, inlined, inner_kernel, kernel, uncounted, vector_part
from guidefield.kernels.simd.packing import AROUND, BLOCK
from guidefield.kernels.simd.vector import LANES

_STACK = 64  # runs that wait, at most: one for each halving


@inner_kernel
def _divide(along: RowOut, members: IndicesOut, begin: int, end: int, at: int) -> None:
    """Order members so that none before `at` is greater along an axis than any from there on (Hoare's selection)."""
    low, high = begin, end - 1
    while low < high:
        a, b, c = along[low], along[(low + high) // 2], along[high]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high
        while i <= j:
            while along[i] < pivot:
                i += 1
            while along[j] > pivot:
                j -= 1
            if i <= j:
                along[i], along[j] = along[j], along[i]
                members[i], members[j] = members[j], members[i]
                i += 1
                j -= 1
        if at <= j:
            high = j
        elif at >= i:
            low = i
        else:
            return


@inlined
def _write_widest(points: Floats, members: Integers, first: int, last: int, along_out: Floats) -> None:
    """Write the coordinates of some members' points along the widest side of the box about them."""
    least_x = least_y = least_z = math.inf
    most_x = most_y = most_z = -math.inf
    for i in range(first, last):
        x, y, z = points[members[i], 0], points[members[i], 1], points[members[i], 2]
        least_x, least_y, least_z = min(least_x, x), min(least_y, y), min(least_z, z)
        most_x, most_y, most_z = max(most_x, x), max(most_y, y), max(most_z, z)
    wide, deep, tall = most_x - least_x, most_y - least_y, most_z - least_z
    axis = 0 if wide >= deep and wide >= tall else 1 if deep >= tall else 2
    for i in range(first, last):
        along_out[i] = points[members[i], axis]


@kernel
def halve_runs(centres: Rows, starts: Indices, sizes: Indices, members: IndicesOut) -> None:
    """Order members (m,) of runs so that each one's first half is on one side of the other along its widest side.

    `centres` (t, 3) are those of all triangles [m], `starts` and `sizes` (n,) where runs begin and their lengths.
    """
    along = np.empty(members.shape[0])
    for run in range(starts.shape[0]):
        first, last = starts[run], starts[run] + sizes[run]
        _write_widest(centres, members, first, last, along)
        _divide(along, members, first, last, first + sizes[run] // 2)


@kernel
def balls_about_runs(corners: Blocks, members: Indices, starts: Indices, sizes: Indices, balls_out: RowsOut) -> None:
    """Write balls (n, 4) about runs of triangles, about the middle of the box about each [m].

    `corners` (t, 3, 3) are those of all triangles, `members` (m,) stand run by run, from `starts` (n,) on, `sizes`
    (n,).
    """
    for run in range(starts.shape[0]):
        first, last = starts[run], starts[run] + sizes[run]
        least_x = least_y = least_z = math.inf
        most_x = most_y = most_z = -math.inf
        for i in range(first, last):
            for corner in range(3):
                x, y, z = (
                    corners[members[i], corner, 0],
                    corners[members[i], corner, 1],
                    corners[members[i], corner, 2],
                )
                least_x, least_y, least_z = min(least_x, x), min(least_y, y), min(least_z, z)
                most_x, most_y, most_z = max(most_x, x), max(most_y, y), max(most_z, z)
        balls_out[run, 0] = 0.5 * (least_x + most_x)
        balls_out[run, 1] = 0.5 * (least_y + most_y)
        balls_out[run, 2] = 0.5 * (least_z + most_z)
        x, y, z, farthest = balls_out[run, 0], balls_out[run, 1], balls_out[run, 2], 0.0
        for i in range(first, last):
            for corner in range(3):
                a = corners[members[i], corner, 0] - x
                b = corners[members[i], corner, 1] - y
                c = corners[members[i], corner, 2] - z
                farthest = max(farthest, a * a + b * b + c * c)
        balls_out[run, 3] = math.sqrt(farthest)


@kernel
def sort_for_tree(points: RowsOut) -> None:
    """Order points (n, 3) [m] in place so that neighbours are together: each sixteen, sixteen of those, and so on."""
    before, along, order = points.copy(), np.empty(points.shape[0]), np.arange(points.shape[0])
    begins, ends = np.empty(_STACK, np.int64), np.empty(_STACK, np.int64)
    begins[0], ends[0], top = 0, points.shape[0], 1
    while top > 0:
        top -= 1
        begin, end = begins[top], ends[top]
        blocks = (end - begin + LANES - 1) // LANES
        if blocks <= 1:
            continue
        half = 1
        while 2 * half < blocks:
            half *= 2
        at = begin + half * LANES
        _write_widest(before, order, begin, end, along)
        _divide(along, order, begin, end, at)
        begins[top], ends[top] = begin, at
        begins[top + 1], ends[top + 1] = at, end
        top += 2
    for i in range(points.shape[0]):
        for k in range(3):
            points[i, k] = before[order[i], k]


@kernel
def fill_tree(points: Rows, firsts: Indices, points_out: SinglesOut, boxes_out: SinglesOut) -> None:
    """Write sorted points (n, 3) as `point_tree.BatchCloud` has them: (BLOCK * blocks,), boxes (AROUND * blocks,)."""
    count, size = points.shape[0], boxes_out.shape[0]
    for at in range(0, size, AROUND):
        boxes_out[at : at + AROUND // 2] = np.float32(math.inf)
        boxes_out[at + AROUND // 2 : at + AROUND] = np.float32(-math.inf)
    for i in range(points_out.shape[0] // 3):
        place = i // LANES * BLOCK + i % LANES
        for k in range(3):
            points_out[place + LANES * k] = points[i, k] if i < count else np.float32(NOWHERE)
    for i in range(count):
        block = i // LANES
        for level in range(1, firsts.shape[0]):
            at = (firsts[level] + block // LANES) * AROUND + block % LANES
            for k in range(3):
                low, high, here = at + LANES * k, at + LANES * (3 + k), np.float32(points[i, k])
                boxes_out[low] = min(boxes_out[low], here)
                boxes_out[high] = max(boxes_out[high], here)
            block //= LANES


@vector_part
def _empty(box: Floats) -> None:
    """Make a box (6,) empty: from plus to minus infinity."""
    for k in range(3):
        box[k], box[3 + k] = math.inf, -math.inf


@vector_part
def _add(box: Floats, other: Floats) -> None:
    """Widen a box (6,) to hold another one."""
    for k in range(3):
        box[k], box[3 + k] = min(box[k], other[k]), max(box[3 + k], other[3 + k])


@exact_kernel
def boxes_above(boxes: RowsOut, firsts: Indices, children: int) -> None:
    """Find the boxes of the levels of a tree above the first one, shape (m, 6), lower, then upper corners.

    `firsts` (levels + 1,) is where each level begins, and the number of all; children of box i begin at `children * i`.
    """
    for level in range(1, firsts.shape[0] - 1):
        for i in range(firsts[level + 1] - firsts[level]):
            box = boxes[firsts[level] + i]
            _empty(box)
            begin = firsts[level - 1] + children * i
            for child in range(begin, min(begin + children, firsts[level])):
                _add(box, boxes[child])


@exact_kernel
def boxes_of_pairs(boxes: Rows, leaf: int, nodes: RowsOut) -> None:
    """Write the boxes (2 leaves - 1, 6) of a complete binary tree over boxes (n, 6), `leaf` of them in a leaf.

    Node i has the children 2 i + 1 and 2 i + 2; boxes of empty leaves are empty.
    """
    inner = nodes.shape[0] // 2
    for i in range(nodes.shape[0] - 1, -1, -1):
        box = nodes[i]
        _empty(box)
        if i < inner:
            _add(box, nodes[2 * i + 1])
            _add(box, nodes[2 * i + 2])
        else:
            for k in range(leaf * (i - inner), min(leaf * (i - inner + 1), boxes.shape[0])):
                _add(box, boxes[k])


@exact_kernel
def middles_within(boxes: Rows, corners: RowOut) -> None:
    """Write the corners (6,) of the box about the middles of boxes (n, 6), each lower, then upper corner."""
    _empty(corners)
    for i in range(boxes.shape[0]):
        for k in range(3):
            middle = 0.5 * (boxes[i, k] + boxes[i, 3 + k])
            corners[k], corners[3 + k] = min(corners[k], middle), max(corners[3 + k], middle)


@uncounted
def boxes_met(
    boxes: Floats, firsts: Integers, children: int, low: Floats, high: Floats, stack: Integers, met_out: Integers
) -> int:
    """Write the places (n,) of a tree's first boxes that overlap or touch a box, and return their number.

    `boxes`, `firsts` and `children` are those of `boxes_above`, `low` and `high` (3,) the corners [m]; scratch
    (children * levels, 2).
    """
    count, top, highest = 0, 0, firsts.shape[0] - 2
    for node in range(firsts[highest + 1] - firsts[highest]):
        stack[top, 0], stack[top, 1] = highest, node
        top += 1
    while top > 0:
        top -= 1
        level, node = stack[top, 0], stack[top, 1]
        box = boxes[firsts[level] + node]
        if not (
            box[0] <= high[0]
            and box[3] >= low[0]
            and box[1] <= high[1]
            and box[4] >= low[1]
            and box[2] <= high[2]
            and box[5] >= low[2]
        ):
            continue
        if level == 0:
            met_out[count] = node
            count += 1
            continue
        below = firsts[level] - firsts[level - 1]
        for child in range(children * node, min(children * (node + 1), below)):
            stack[top, 0], stack[top, 1] = level - 1, child
            top += 1
    return count


@kernel
def overlaps_in_tree(
    boxes: Rows, firsts: Indices, children: int, low: Rows, high: Rows, pairs_out: IndexRowsOut
) -> int:
    """Write which boxes overlap which of a tree's: an index of the others and a place, (k, 2), while there is room.

    Count all. The tree is that of `boxes_met`, the others have lower and upper corners (q, 3) [m].
    """
    stack, met = np.empty((children * firsts.shape[0], 2), np.int64), np.empty(firsts[1], np.int64)
    count = 0
    for asked in range(low.shape[0]):
        for k in range(boxes_met(boxes, firsts, children, low[asked], high[asked], stack, met)):
            if count < pairs_out.shape[0]:
                pairs_out[count, 0], pairs_out[count, 1] = asked, met[k]
            count += 1
    return count


@vector_part
def _spread_bits(cell: int) -> int:
    cell = (cell | cell << 32) & 0x001F00000000FFFF
    cell = (cell | cell << 16) & 0x001F0000FF0000FF
    cell = (cell | cell << 8) & 0x100F00F00F00F00F
    cell = (cell | cell << 4) & 0x10C30C30C30C30C3
    return (cell | cell << 2) & 0x1249249249249249


@exact_kernel
def curve_places(points: Rows, least: Row, size: float, most: int, places: IndicesOut) -> None:
    """Write the places of `points` (n, 3) along the Morton curve: the bits of their coordinates' cells in turn, (n,).

    The cube has its least corner at `least` (3,) and the side `size`; `most` is the last cell along a side, below 2^21.
    """
    for i in range(points.shape[0]):
        x = int((points[i, 0] - least[0]) / size * most)
        y = int((points[i, 1] - least[1]) / size * most)
        z = int((points[i, 2] - least[2]) / size * most)
        places[i] = _spread_bits(x) | _spread_bits(y) << 1 | _spread_bits(z) << 2


@exact_kernel
def changed_order(
    order: Indices,
    places: Indices,
    now: Indices,
    fresh: Indices,
    fresh_places: Indices,
    order_out: IndicesOut,
    places_out: IndicesOut,
    runs_out: IndexRowsOut,
) -> int:
    """Merge the points that are left of an order with `fresh` ones (k,); those of one place go by their numbers.

    `order` and `places` (m,) are those before, `now` has the number that each has now, -1 of those that are gone; those
    left keep their order. Writes the order and its places (n,), and in `runs_out` (r, 2) where runs that stand as
    before began and their lengths, -1 and the length of runs of fresh ones. Returns the number of runs.
    """
    at = others = runs = 0
    last = -2  # where in the order the last one stood, -1 of another
    for i in range(order.shape[0] + 1):
        end = i == order.shape[0]
        point = -1 if end else now[order[i]]
        if point < 0 and not end:
            continue
        while others < fresh.shape[0] and (
            end or fresh_places[others] < places[i] or (fresh_places[others] == places[i] and fresh[others] < point)
        ):
            order_out[at], places_out[at] = fresh[others], fresh_places[others]
            if last == -1:
                runs_out[runs - 1, 1] += 1
            else:
                runs_out[runs, 0], runs_out[runs, 1] = -1, 1
                runs += 1
            last = -1
            at, others = at + 1, others + 1
        if end:
            break
        order_out[at], places_out[at] = point, places[i]
        if last >= 0 and last == i - 1:
            runs_out[runs - 1, 1] += 1
        else:
            runs_out[runs, 0], runs_out[runs, 1] = i, 1
            runs += 1
        last = i
        at += 1
    return runs
