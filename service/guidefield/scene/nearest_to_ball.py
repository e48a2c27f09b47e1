"""Of very many obstacles those that may be nearest to some place in a ball: what stays in it is nearer to no other.

Let r be the ball's radius and d the distance of its middle from that of an obstacle, which holds a ball of radius a and
is within one of radius b. From anywhere in the ball the obstacle is at least d - r - b away, and at most d + r - a. So
one that is at least farther away than another is at most is nearest to nowhere in the ball. Of one that moves the
distances are those at all times: it is left out where it never gets near, and others only for where it always is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from guidefield.kernels.collide.gaps_from_ball import gaps_from_ball
from guidefield.scene.carried import MANY, Rows, carried
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.placed import rows_of
from guidefield.scene.scene import Scene, declared_with, with_others
from guidefield.scene.swept import gaps_from_boxes, moving_ball, swept
from guidefield.scene.within_ball import Ball

NOBODY: frozenset[str] = frozenset()

ROUNDING = 1e-9
"""What distances are taken for wider, of a metre and of each metre that places are from the origin."""

MANY_MOVE = 16
"""Where so many obstacles move some are left out, however few there are: each is looked at at many times."""


class Nearest(NamedTuple):
    """What is left of a scene for a ball.

    Attributes:
        least: How far each obstacle is at least from any place in the ball, at any time, shape (n,) [m].
        most: How far it is at most, shape (n,) [m].
        chosen: Which may be nearest, ascending indices, shape (k,).
        some: The scene with these alone; None: they are all of it.
    """

    least: np.ndarray
    most: np.ndarray
    chosen: np.ndarray
    some: Scene | None

    def of(self, scene: Scene) -> Scene:
        """What is left of the scene, which this was found of."""
        return self.some or scene


def has_many(scene: Scene) -> bool:
    """Whether a scene has so many obstacles, or so many that move, that it is worth to leave some out."""
    return len(scene.obstacles) >= MANY or sum(scene.obstacles[k].motion is not None for k in scene.others) >= MANY_MOVE


def _over(known: Nearest, rows: Rows, scene: Scene, ball: Ball, named: frozenset[str] = NOBODY) -> Nearest:
    """The same of a scene that was changed; the scene with these alone is the very one, if none of them is another."""
    fresh = _gaps([scene.obstacles[index] for index in rows.fresh], ball, named)
    least, most = rows.carry(known.least, fresh[0]), rows.carry(known.most, fresh[1])
    chosen = _chosen(least, most)
    return Nearest(least, most, chosen, _some(known, rows, scene, chosen))


def _some(known: Nearest, rows: Rows, scene: Scene, chosen: np.ndarray) -> Scene | None:
    """The scene with those that are chosen alone, None if they are all of it; the one before if it has the same."""
    some = known.some
    if some is None or len(chosen) == rows.count:
        return _of(scene, chosen)
    if len(chosen) < MANY:
        obstacles = tuple(map(scene.obstacles.__getitem__, chosen.tolist()))
        return some if obstacles == some.obstacles else _of(scene, chosen)
    step = rows.among(known.chosen, chosen)
    if not step.fresh and not step.gone:
        return some
    new = chosen[step.fresh].tolist()
    declared = step.listed(some.message.obstacles, [scene.message.obstacles[index] for index in new])
    fresh = [scene.obstacles[index] for index in new]
    return with_others(some, step, fresh, declared_with(scene.message, declared))


def _of(scene: Scene, chosen: np.ndarray) -> Scene | None:
    """A scene with some of its obstacles alone, ascending indices; None if they are all of it."""
    return None if len(chosen) == len(scene.obstacles) else scene.of(chosen.tolist())


@carried(_over)
def nearest_to_ball(scene: Scene, ball: Ball, named: frozenset[str] = NOBODY) -> Nearest:
    """The obstacles that may be nearest to some place in a ball at some time, and all at rest that aren't primitives.

    Args:
        scene: The scene.
        ball: The ball.
        named: Obstacles that are kept, and that no other is left out for: something may touch them, and then the
            nearest of the others counts.
    """
    least, most = _gaps(scene.obstacles, ball, named)
    chosen = _chosen(least, most)
    return Nearest(least, most, chosen, _of(scene, chosen))


def _chosen(least: np.ndarray, most: np.ndarray) -> np.ndarray:
    return np.flatnonzero(least <= most.min(initial=np.inf))


def _gaps(obstacles: Sequence[Obstacle], ball: Ball, named: frozenset[str]) -> tuple[np.ndarray, np.ndarray]:
    """How far obstacles are at least and at most from any place in a ball at any time, both of shape (n,) [m].

    Of those that are named, and of what is no primitive at rest, nothing is known.
    """
    placed, least, most = rows_of(obstacles), np.empty(len(obstacles)), np.empty(len(obstacles))
    gaps_from_ball(placed, np.array(ball, float), ROUNDING, least, most)
    moving = [index for index, one in enumerate(obstacles) if one.motion is not None]
    if moving:
        some = [obstacles[index] for index in moving]
        boxes, first, _ = swept(some, list(map(moving_ball, some)))
        nearest, farthest = gaps_from_boxes(boxes, np.array(ball[:3]), ball.radius)
        least[moving], most[moving] = np.minimum.reduceat(nearest, first), np.maximum.reduceat(farthest, first)
    if named:
        unknown = [one.name in named for one in obstacles]
        least[unknown], most[unknown] = -np.inf, np.inf
    return least, most
