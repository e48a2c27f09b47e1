"""Balls around balls: the levels above a cover, by which most of it needn't be looked at."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.surfaces import Floats, Integers
from guidefield.kernels.cover.enclosing_ball import ball_around_balls, smallest_ball

GROUP = 8
"""Most balls of a group."""


def enclosing_ball(points: Floats) -> Floats:
    """The smallest ball that contains points, and so their hull.

    Args:
        points: Shape (n, 3) [m], in any frame.

    Returns:
        Centre in that frame and radius, shape (4,) [m].
    """
    ball = np.empty(4)
    smallest_ball(np.ascontiguousarray(points), ball)
    return ball


def grouped(balls: Floats) -> tuple[Integers, Floats, Integers]:
    """Neighbouring balls in groups, with a ball around each group.

    Args:
        balls: Centres and radii, shape (n, 4), n >= 1 [m], in any frame.

    Returns:
        The order in which balls of a group stand together, shape (n,); the balls around groups, shape (g, 4) [m]; where
        each group begins, and n, shape (g + 1,).
    """
    groups = _halved(balls, np.arange(len(balls)))
    around = np.empty((len(groups), 4))
    for group, members in enumerate(groups):
        ball_around_balls(np.ascontiguousarray(balls[members]), around[group])
    return np.concatenate(groups), around, np.concatenate([[0], np.cumsum([len(members) for members in groups])])


def _halved(balls: Floats, members: Integers) -> list[Integers]:
    """Members split across their longest extent, in as equal halves as groups of full size allow."""
    if len(members) <= GROUP:
        return [members]
    centres = balls[members, :3]
    axis = int(np.ptp(centres, axis=0).argmax())
    order = members[np.argsort(centres[:, axis], kind="stable")]
    half = GROUP * -(-len(members) // (2 * GROUP))
    return _halved(balls, order[:half]) + _halved(balls, order[half:])
