"""Places of points along a Morton curve, and the order along it of points of which some are others."""

from __future__ import annotations

from numba import int64, void

from guidefield.kernels.jit.signatures import (
    INDEX_MATRIX_OUT,
    INDICES,
    INDICES_OUT,
    MATRIX,
    SCALAR,
    VECTOR,
    Floats,
    Integers,
    exact_kernel,
    lane_part,
)


@lane_part
def _spread(cell: int) -> int:
    """The bits of a number of 21 of them, two zeros between each and the next."""
    cell = (cell | cell << 32) & 0x001F00000000FFFF
    cell = (cell | cell << 16) & 0x001F0000FF0000FF
    cell = (cell | cell << 8) & 0x100F00F00F00F00F
    cell = (cell | cell << 4) & 0x10C30C30C30C30C3
    return (cell | cell << 2) & 0x1249249249249249


@exact_kernel(void(MATRIX, VECTOR, SCALAR, int64, INDICES_OUT))
def curve_places(points: Floats, least: Floats, size: float, most: int, places: Integers) -> None:
    """Find the places on the curve: the bits of the coordinates' cells in turn.

    Args:
        points: Shape (n, 3), within the cube.
        least: The cube's least corner, shape (3,).
        size: Its side.
        most: The last cell along a side, less than 2^21.
        places: Gets them, shape (n,).
    """
    for i in range(points.shape[0]):
        x = int((points[i, 0] - least[0]) / size * most)
        y = int((points[i, 1] - least[1]) / size * most)
        z = int((points[i, 2] - least[2]) / size * most)
        places[i] = _spread(x) | _spread(y) << 1 | _spread(z) << 2


@exact_kernel(int64(INDICES, INDICES, INDICES, INDICES, INDICES, INDICES_OUT, INDICES_OUT, INDEX_MATRIX_OUT))
def changed_order(
    order: Integers,
    places: Integers,
    now: Integers,
    fresh: Integers,
    fresh_places: Integers,
    order_out: Integers,
    places_out: Integers,
    runs_out: Integers,
) -> int:
    """Find the order of points that are left of some, and of others; those of the same place in that of their numbers.

    Args:
        order: Numbers of the points before, in order, shape (m,).
        places: Places of these, shape (m,).
        now: The number that each of those before has now, by its number then; -1 of those that are gone. Those that are
            left keep their order.
        fresh: Numbers of the others, by place, then number, shape (k,).
        fresh_places: Places of these, shape (k,).
        order_out: Gets the numbers in order, shape (n,).
        places_out: Gets their places, shape (n,).
        runs_out: Gets of those that stand one behind the other as before where in the order the first of them stood,
            and how many they are; -1 and how many of others; shape (r, 2), at least twice as many as are gone or
            others, and one.

    Returns:
        How many such runs there are.
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
