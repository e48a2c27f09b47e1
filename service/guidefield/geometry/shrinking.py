"""Balls that contain elements together, each made as small as what it has to contain allows."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.elements import Elements, blocks
from guidefield.geometry.solid import Solid
from guidefield.geometry.surfaces import Floats, Integers
from guidefield.kernels.cover.ball_cover import reaches
from guidefield.kernels.cover.enclosing_ball import largest_distances, smallest_balls
from guidefield.kernels.cover.stable_order import stable_order

MOVES = (1.0, 0.5, 0.25)
"""Shares of the way to the centre of the smallest ball about its elements that a ball's centre is tried to move."""

EASE = 0.1
"""Least overhang of a ball, as a share of delta.

One that fits a surface closely all over would make the proof for the inside look at very many very small cells.
"""


def shrunk(body: Solid, balls: Floats, elements: Elements, delta: float, margin: float) -> Floats:
    """Balls that contain all elements by a margin, no larger than they have to be.

    Args:
        body: The body that the elements are of.
        balls: Balls that contain all elements by the margin, and leave the body by at most `delta`; shape (n, 4) [m].
        elements: What has to be contained.
        delta: Largest overhang [m].
        margin: By how much [m].

    Returns:
        Balls that leave the body by no more, without those that nothing is left for, shape (m, 4).
    """
    radii, owners = np.empty(len(balls)), np.empty(len(elements.bounds), np.int64)
    reduced = np.column_stack([balls[:, :3], balls[:, 3] - margin])
    reaches(reduced, elements.points, elements.first_point, elements.bounds, blocks(elements), radii, owners)
    kept, owners = np.unique(owners, return_inverse=True)
    owners = owners.reshape(-1)
    small = np.column_stack([balls[kept, :3], radii[kept] + margin])
    small = _recentred(body, small, elements, owners, delta, margin)
    small[:, 3] = np.maximum(small[:, 3], body.depths(small[:, :3]) + EASE * delta)
    return small


def _recentred(body: Solid, balls: Floats, elements: Elements, owners: Integers, delta: float, margin: float) -> Floats:
    """Balls moved towards the smallest about what they own, where that makes them smaller and keeps the overhang."""
    owned, first = _owned_points(elements, owners, len(balls))
    targets, radii = np.empty((len(balls), 4)), np.empty(len(balls))
    smallest_balls(owned, first, targets)
    result = balls.copy()
    for share in MOVES:
        centres = balls[:, :3] + share * (targets[:, :3] - balls[:, :3])
        largest_distances(owned, first, centres, radii)
        radii += margin
        better = (radii < result[:, 3]) & (radii <= body.depths(centres) + delta)
        result[better] = np.column_stack([centres, radii])[better]
    return result


def _owned_points(elements: Elements, owners: Integers, balls: int) -> tuple[Floats, Integers]:
    """The points (k, 3) of what each ball owns together [m], and where those of each begin, and k."""
    of_points = np.repeat(owners, np.diff(elements.first_point))
    order, first = np.empty(len(of_points), np.int64), np.zeros(balls + 1, np.int64)
    stable_order(of_points, order)
    np.cumsum(np.bincount(of_points, minlength=balls), out=first[1:])
    return elements.points[order], first
