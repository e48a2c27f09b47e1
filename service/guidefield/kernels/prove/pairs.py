"""Bodies of pairs by their numbers: own pairs first, then each moving body with each obstacle, row by row."""

from __future__ import annotations

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.prove.tables import BodyPairs, ObstacleBodies


@uncounted
def is_own(pairs: BodyPairs, pair: int) -> int:
    """Return 1 for one of the robot's own pairs, 0 for another."""
    return 1 if pair < pairs.own.shape[0] else 0


@uncounted
def first_body(pairs: BodyPairs, obstacles: ObstacleBodies, pair: int) -> int:
    """Return the robot body of a pair: of an own one the first."""
    own = pairs.own.shape[0]
    if pair < own:
        return int(pairs.own[pair, 0])
    return int(pairs.moving[(pair - own) // obstacles.roots.shape[0]])


@uncounted
def obstacle_of(pairs: BodyPairs, obstacles: ObstacleBodies, pair: int) -> int:
    """Return the obstacle of a pair that has one."""
    return int((pair - pairs.own.shape[0]) % obstacles.roots.shape[0])
