"""Primitives as they are declared, in rows: what tables of thousands of them are made of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from guidefield.kernels.collide.primitives_layout import PLACED
from guidefield.scene.carried import Rows, carried
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene

_NONE = bytes(PLACED.size)


def rows_of(obstacles: Sequence[Obstacle]) -> np.ndarray:
    """`PLACED` of each obstacle, shape (n, 12), read-only; zeros of one that is no primitive."""
    return np.frombuffer(b"".join([one.placed or _NONE for one in obstacles])).reshape(-1, PLACED.size // 8)


def _over(known: np.ndarray, rows: Rows, scene: Scene) -> np.ndarray:
    placed = rows.carry(known, rows_of([scene.obstacles[index] for index in rows.fresh]))
    placed.setflags(write=False)
    return placed


@carried(_over)
def placed_rows(scene: Scene) -> np.ndarray:
    """`PLACED` of each obstacle of a scene, shape (n, 12), read-only; made once."""
    return rows_of(scene.obstacles)


def unplaced(scene: Scene) -> list[int]:
    """Which obstacles of a scene are no primitives, ascending indices."""
    return [index for index in scene.others if not scene.obstacles[index].placed]
