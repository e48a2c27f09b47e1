"""A world as the kernels of the certificate read it."""

from __future__ import annotations

import numpy as np

from guidefield.collision.box_tree import CHILDREN
from guidefield.collision.world import World
from guidefield.kept import kept_with
from guidefield.kernels.certificate.tables import CertifiedObstacles, CertifiedRobot
from guidefield.read_only import read_only


@kept_with
def certified_robot(world: World) -> CertifiedRobot:
    """The robot of a world, and its own pairs."""
    bodies, bound, pairs = world.bodies, world.motion_bound, world.pairs
    robot = CertifiedRobot(
        carriers=bodies.joints.astype(np.int64),
        centres=_rows(bodies.centres, 3),
        radii=_rows(bodies.radii),
        part_centres=np.ascontiguousarray(bodies.part_centres, float),
        part_radii=_rows(bodies.part_radii),
        moved_by=np.ascontiguousarray(bodies.moved_by),
        turns=bodies.turns[None].copy(),
        half_widths=np.ascontiguousarray(bound.half_widths, float),
        together=np.ascontiguousarray(bound.together, float),
        centred=np.ascontiguousarray(bound.centred, float),
        doubled=_rows(bound.doubled),
        moving=pairs.moving.astype(np.int64),
        own=np.ascontiguousarray(pairs.own, np.int64).reshape(-1, 2),
        apart_from=bound.apart_from.astype(np.int64),
    )
    read_only(*robot)
    return robot


@kept_with
def certified_obstacles(world: World) -> CertifiedObstacles:
    """The obstacles of a world, and which pairs with them are left out."""
    boxes = world.boxes
    axes, middles, halves = boxes.along_own_axes
    levels = boxes.tree.levels
    counts = [level.shape[1] for level in levels]
    obstacles = CertifiedObstacles(
        axes=_rows(axes.reshape(-1, 9), 9),
        middles=_rows(middles, 3),
        halves=_rows(halves, 3),
        nodes=np.ascontiguousarray(np.concatenate([level.T for level in levels])),
        levels=np.cumsum([0, *counts]),
        children=CHILDREN,
        order=boxes.bounded[boxes.tree.order].astype(np.int64),
        endless=boxes.endless.astype(np.int64),
        left_out=world.pairs.left_out.astype(np.int64),
    )
    read_only(*(one for one in obstacles if isinstance(one, np.ndarray)))
    return obstacles


def _rows(array: np.ndarray, width: int | None = None) -> np.ndarray:
    """A copy in double precision, of rows of so many numbers."""
    copied = np.array(array, float, order="C")
    return copied if width is None else copied.reshape(-1, width)
