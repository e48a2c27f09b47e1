"""Of very many obstacles those that may be nearest to some place in a ball: what stays in it is nearer to no other.

Let r be the ball's radius and d the distance of its middle from that of an obstacle, which holds a ball of radius a and
is within one of radius b. From anywhere in the ball the obstacle is at least d - r - b away, and at most d + r - a. So
one that is at least farther away than another is at most is nearest to nowhere in the ball.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from guidefield.kernels.collide.primitive import BOX, CAPSULE, HALF_SPACE
from guidefield.scene.carried import Rows, carried
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.placed import rows_of
from guidefield.scene.scene import Scene, declared_with, with_others
from guidefield.scene.within_ball import Ball

MANY = 256
"""Among fewer obstacles the tables of all are made as soon."""

NOBODY: frozenset[str] = frozenset()

ROUNDING = 1e-9
"""What distances are taken for wider, of a metre and of each metre that places are from the origin."""


class Nearest(NamedTuple):
    """What is left of a scene for a ball.

    Attributes:
        least: How far each obstacle is at least from any place in the ball, shape (n,) [m].
        most: How far it is at most, shape (n,) [m].
        chosen: Which may be nearest, ascending indices, shape (k,).
        scene: The scene with these alone.
    """

    least: np.ndarray
    most: np.ndarray
    chosen: np.ndarray
    scene: Scene


def has_many(scene: Scene) -> bool:
    """Whether a scene has so many obstacles that it is worth to leave some out; what moves isn't looked at."""
    return len(scene.obstacles) >= MANY and not scene.moves


def _over(known: Nearest, rows: Rows, scene: Scene, ball: Ball, named: frozenset[str] = NOBODY) -> Nearest:
    """The same of a scene that was changed; the scene with these alone is the very one, if none of them is another."""
    fresh = _gaps([scene.obstacles[index] for index in rows.fresh.tolist()], ball, named)
    least, most = rows.of(known.least, fresh[0]), rows.of(known.most, fresh[1])
    chosen = _chosen(least, most)
    there = rows.source[chosen]
    if np.array_equal(there, known.chosen):
        return Nearest(least, most, chosen, known.scene)
    place = np.minimum(np.searchsorted(known.chosen, there), len(known.chosen) - 1)
    step = Rows(np.where(known.chosen[place] == there, place, -1), len(known.chosen))
    new = chosen[step.fresh].tolist()
    declared = step.listed(known.scene.message.obstacles, [scene.message.obstacles[index] for index in new])
    met = with_others(
        known.scene, step, [scene.obstacles[index] for index in new], declared_with(scene.message, declared)
    )
    return Nearest(least, most, chosen, met)


@carried(_over)
def nearest_to_ball(scene: Scene, ball: Ball, named: frozenset[str] = NOBODY) -> Nearest:
    """The obstacles that may be nearest to some place in a ball, and all that aren't primitives.

    Args:
        scene: The scene; nothing in it moves.
        ball: The ball.
        named: Obstacles that are kept, and that no other is left out for: something may touch them, and then the
            nearest of the others counts.
    """
    least, most = _gaps(scene.obstacles, ball, named)
    chosen = _chosen(least, most)
    return Nearest(least, most, chosen, scene.of(chosen.tolist()))


def _chosen(least: np.ndarray, most: np.ndarray) -> np.ndarray:
    return np.flatnonzero(least <= most.min(initial=np.inf))


def _gaps(obstacles: Sequence[Obstacle], ball: Ball, named: frozenset[str]) -> tuple[np.ndarray, np.ndarray]:
    """How far obstacles are at least and at most from any place in a ball, both of shape (n,) [m].

    Of those that are named, and of what is no primitive, nothing is known.
    """
    middle, radius, placed = np.array(ball[:3]), ball.radius, rows_of(obstacles)
    kinds, centres, halves, round_ = placed[:, 0], placed[:, 5:8], placed[:, 8:11], placed[:, 11]
    apart = np.sqrt(((centres - middle) ** 2).sum(axis=1))
    wider = ROUNDING * (1.0 + np.abs(centres).max(axis=1, initial=0.0) + np.abs(middle).max())
    box, capsule, endless = kinds == BOX, kinds == CAPSULE, kinds == HALF_SPACE
    long, unknown = halves[:, 2], ~placed.any(axis=1)
    if named:
        unknown |= np.array([one.name in named for one in obstacles])
    about = np.where(box, np.sqrt((halves**2).sum(axis=1)), np.where(capsule, long + round_, np.hypot(long, round_)))
    within = np.where(box, halves.min(axis=1, initial=np.inf), np.where(capsule, round_, np.minimum(long, round_)))
    least, most = apart - about, apart - within
    most[endless] = ((middle - centres) * halves).sum(axis=1)[endless]
    least, most = least - radius - wider, np.maximum(most + radius, 0.0) + wider
    least[endless | unknown], most[unknown] = -np.inf, np.inf
    return least, most
