"""The obstacles of a scene that move as the barrier's kernels read them."""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np

from guidefield.geometry.distance_bodies import body_rows, body_tables
from guidefield.kernels.barrier.moving_bodies import MovingBodies
from guidefield.memo import memoized
from guidefield.read_only import read_only
from guidefield.scene.distance_tables import bodies_of
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene


@memoized
def moving_tables(scene: Scene) -> MovingBodies:
    """Tables of the obstacles of a scene that move; once for each scene, and once for all in which none does."""
    return _tables({index: scene.obstacles[index] for index in scene.others}) if scene.moves else _nothing()


@functools.cache
def _nothing() -> MovingBodies:
    return _tables({})


def _tables(obstacles: Mapping[int, Obstacle]) -> MovingBodies:
    """The same of those that move of some obstacles, by their indices."""
    bodies, owners, of = [], [], []
    motions = [(index, one.motion) for index, one in obstacles.items() if one.motion is not None]
    for k, (index, motion) in enumerate(motions):
        back = motion.placements[0].inverse()
        made = [body.placed(back.rotation, back.translation) for body in bodies_of(obstacles[index])]
        bodies += made
        owners += [index] * len(made)
        of += [k] * len(made)
    lasts = np.cumsum([len(motion.times) for _, motion in motions], dtype=np.int64)
    counts = np.array([len(motion.times) for _, motion in motions], np.int64)
    rest = np.zeros((1, 6))
    tables = MovingBodies(
        bodies=body_tables(body_rows(bodies), owners, np.empty((0, 6))),
        motions=np.array(of, np.int64),
        spans=np.column_stack([lasts - counts, lasts]),
        times=np.concatenate([np.empty(0), *(motion.times for _, motion in motions)]),
        placements=np.array([p.homogeneous[:3] for _, motion in motions for p in motion.placements]).reshape(-1, 3, 4),
        twists=np.concatenate([np.empty((0, 6)), *(np.vstack([motion.twists, rest]) for _, motion in motions)]),
    )
    read_only(*tables[1:])
    return tables
