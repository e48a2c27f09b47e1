"""An order of points in which neighbours stand together: along a Morton curve (G. M. Morton, 1966).

Trees over boxes and points are built in this order (`distance_bodies.py`, `collision/obstacle_boxes.py`, `scene/`):
another curve would cost time, and give other covers that are as good. An order is updated when some points change, with
the result that a new one would have, because a scene's tables must not depend on how it came about.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from guidefield.kernels.distance.bvh import changed_order, curve_places, middles_within

FINEST = 21  # bits of one coordinate of a place on the curve, also in `triangle_rows` (kernels): three fit into 63

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class CurveOrder(NamedTuple):
    """Points along the curve."""

    order: Integers  # their numbers by their places on it, ties by number, shape (n,)
    places: Integers  # those places, shape (n,)
    corners: Floats  # the lower, then the upper corner of the box about the points, shape (6,)
    bits: int  # of each coordinate of a place

    def is_of(self, boxes: Floats) -> bool:
        """Whether the points are in the same box if they are the middles of boxes (n, 6): so places mean the same."""
        corners = np.empty(6)
        middles_within(boxes, corners)
        return bool((corners == self.corners).all())


class ChangedOrder(NamedTuple):
    """An order after a change of the points."""

    along: CurveOrder  # the points along the same curve
    # runs of the new order: the place of its first point in the old order, and its length, of points that stood there
    # one behind the other; -1 and the length of a run of new points
    runs: list[tuple[int, int]]
    fresh: Integers  # the others in that order, indices among the others


def curve_order(points: Floats, bits: int = FINEST) -> Integers:
    """Return the order (n,) of points (n, 3) along the curve, ties by index; at most `FINEST` bits an axis."""
    return along_curve(points, bits).order


def along_curve(points: Floats, bits: int = FINEST) -> CurveOrder:
    """Return the order of points (n, 3) with their places on the curve; as `curve_order` takes them."""
    if not len(points):
        return CurveOrder(np.empty(0, np.int64), np.empty(0, np.int64), np.array([np.inf, -np.inf]).repeat(3), bits)
    along = np.ascontiguousarray(points.T)  # NumPy takes a third of the time for coordinates one behind the other
    corners = np.concatenate([along.min(axis=1), along.max(axis=1)])
    places = _places(points, corners, bits)
    order = np.argsort(places)  # sooner than a stable one, and the same where no two places are
    in_turn = places[order]
    if (in_turn[1:] == in_turn[:-1]).any():
        order = np.argsort(places, kind="stable")
    return CurveOrder(order, in_turn, corners, bits)


def change_along(known: CurveOrder, now: Integers, fresh: Sequence[int], points: Floats, count: int) -> ChangedOrder:
    """Update the order after points were replaced; it is right if the box about all of them is what it was.

    Args:
        known: The points before.
        now: The number that each of those has now, -1 of those that are gone, shape (m,), ascending else.
        fresh: The numbers of the new points.
        points: Where these are, shape (k, 3), within the box about those before.
        count: How many there are now.
    """
    numbers = np.array(fresh, np.int64)
    places = _places(points, known.corners, known.bits)
    turn = np.lexsort((numbers, places)) if len(numbers) > 1 else np.arange(len(numbers))
    most = 2 * (len(numbers) + len(known.order) - (count - len(numbers))) + 1
    order, in_turn, runs = np.empty(count, np.int64), np.empty(count, np.int64), np.empty((most, 2), np.int64)
    found = changed_order(known.order, known.places, now, numbers[turn], places[turn], order, in_turn, runs)
    return ChangedOrder(known._replace(order=order, places=in_turn), list(map(tuple, runs[:found].tolist())), turn)


def _places(points: Floats, corners: Floats, bits: int) -> Integers:
    """Places (n,) on the curve through the cube that a box, shape (6,), is in."""
    places = np.empty(len(points), np.int64)
    size = max(float((corners[3:] - corners[:3]).max()), 1e-300)
    curve_places(np.ascontiguousarray(points), corners[:3], size, 2**bits - 1, places)
    return places
