"""SIMD batch collision: test many configurations or samples of paths at once, shorten paths, measure gaps to boxes.

A sample that is found free is free on the exact geometry, but for contacts shallower than `BAND` (1e-5 m, in
kernels/collide/layout.py) and what is wholly inside a mesh: a link, or an obstacle that inscribed balls miss. Between
samples the certificate decides. The order of the packed words (robot, scene, memory, drift) is that of `BatchWorld`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from guidefield.collision.batch.robot_tables import BatchRobot, batch_robot, turn_from, turns_freely
from guidefield.collision.batch.scene_tables import BatchScene, BufferLayout, batch_scene, scratch_layout
from guidefield.collision.world import World
from guidefield.kernels.collide.batch_collision import path_free_until, touching_configurations
from guidefield.kernels.collide.broadphase import write_gaps
from guidefield.kernels.collide.layout import (
    DRIFT_WORDS,
    GRID_NUMBERS,
    GRID_PLACES,
    LINK_PAIR,
    MEMORY_WORDS,
    PAIR,
    SCENE_WORDS,
    BatchRobotTables,
    BatchWorld,
    DriftingBoxes,
    Scratch,
    lay_out,
)
from guidefield.kernels.collide.self_narrowphase import STACK, never_touching
from guidefield.kernels.simd.packing import Words, pack
from guidefield.kernels.tree.shortcut import shorten
from guidefield.memo import memoized
from guidefield.read_only import read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.model.joints import LocalPoints

MOST_JUDGED_CELLS = 2000  # cells of a grid that are tested to remove a pair of links: a millisecond or two
NO_DRIFT = DriftingBoxes(0, *(np.empty(0, np.float32) for _ in range(5)))
read_only(*NO_DRIFT[1:])
_NO_DRIFT = pack(NO_DRIFT)
TRIES = 60  # shortcuts that `BatchCollision.shorten` tries by default: shorter paths for more time


def prepare_robot(world: World) -> None:
    """Build and keep the tables of a world's robot, whatever its obstacles are; once for alike groups."""
    _robot(world.group, world.pairs.own.tobytes())


def _robot(group: PlanningGroup, pairs: bytes) -> tuple[BatchRobot, Words]:
    """Return the tables of a group and its pairs (int64) that must not touch, and the first words of its worlds."""
    made = _alike_robot(group, pairs)
    return _turn_robot(group, pairs) if turns_freely(made[0].joints) else made


@memoized
def _turn_robot(group: PlanningGroup, pairs: bytes) -> tuple[BatchRobot, Words]:
    robot, _ = _alike_robot(group, pairs)
    return _with_words(dataclasses.replace(robot, joints=turn_from(robot.joints, group)), group)


@memoized_for_alike
def _alike_robot(group: PlanningGroup, pairs: bytes) -> tuple[BatchRobot, Words]:
    pairs_of_bodies = np.frombuffer(pairs, np.int64).reshape(-1, 2)
    robot = batch_robot(group, pairs_of_bodies)
    return _with_words(prune_pairs(robot, group.nv), group)


def _with_words(robot: BatchRobot, group: PlanningGroup) -> tuple[BatchRobot, Words]:
    return robot, pack((robot.joints, robot.bodies, robot.parts, robot.surfaces, robot.fractions, group.nv))


def prune_pairs(robot: BatchRobot, nv: int) -> BatchRobot:
    """Remove pairs of links that keep apart wherever their nv coordinates are within their limits.

    A robot's description rarely names all pairs that can't collide.
    """
    bodies = robot.bodies
    layout = scratch_layout(robot, nv, len(bodies.pairs) // PAIR, 0)
    views = layout.views(np.zeros(layout.size, np.int64), 0)
    scratch = Scratch(**{name: views[name] for name in Scratch._fields})
    alone = BatchRobotTables(robot.joints, bodies, robot.parts, robot.surfaces, scratch)
    never = np.zeros(bodies.n_link_pairs, np.bool_)
    never_touching(pack(alone), MOST_JUDGED_CELLS, np.zeros(STACK, np.int64), never)
    link_pairs = bodies.link_pairs.reshape(-1, LINK_PAIR)[~never].ravel()
    grids = bodies.grids.reshape(-1, GRID_PLACES)[~never].ravel()
    numbers = bodies.grid_numbers.reshape(-1, GRID_NUMBERS)[~never].ravel()
    for array in (link_pairs, grids, numbers):
        array.setflags(write=False)
    left = bodies._replace(
        n_link_pairs=len(link_pairs) // LINK_PAIR, link_pairs=link_pairs, grids=grids, grid_numbers=numbers
    )
    return dataclasses.replace(robot, bodies=left)


@dataclass(frozen=True, eq=False)
class BatchCollision:
    """A world for the kernels of SIMD batches; like the world itself it answers one question at a time.

    The words are a packed `BatchWorld`: addresses that are valid as long as `memory`, `scene` and `robot` are held. The
    first array begins at `begins` in the memory [bytes].
    """

    world: World
    words: Words
    memory: np.ndarray
    begins: int
    scene: BatchScene
    robot: BatchRobot
    drifting: DriftingBoxes = NO_DRIFT

    @classmethod
    def build(cls, world: World) -> BatchCollision:
        """Make the tables of a world."""
        robot, words, scene, layout = _of(world)
        memory = np.zeros(layout.size, np.int64)
        all_words = np.empty(len(words) + SCENE_WORDS + MEMORY_WORDS + DRIFT_WORDS, np.int64)
        all_words[-DRIFT_WORDS:] = _NO_DRIFT
        bodies, moving, left_out = robot.bodies.size, world.pairs.moving, world.pairs.bodies_left_out()
        begins = lay_out(words, scene.words, layout.offsets, scene.owners, bodies, moving, left_out, memory, all_words)
        return cls(world, all_words, memory, begins, scene, robot)

    @cached_property
    def tables(self) -> BatchWorld:
        """The world as arrays."""
        robot, scene, layout = self.robot, self.scene, _of(self.world)[3]
        views = layout.views(self.memory, self.begins)
        return BatchWorld(
            joints=robot.joints,
            bodies=robot.bodies,
            parts=robot.parts,
            surfaces=robot.surfaces,
            fractions=robot.fractions,
            nv=self.world.group.nv,
            obstacles=scene.tables[0]._replace(ignored=views["ignored"]),
            scene=scene.tables[1],
            scratch=Scratch(**{name: views[name] for name in Scratch._fields}),
            block=views["block"],
            drifting=self.drifting,
        )

    def among(self, drifting: DriftingBoxes) -> BatchCollision:
        """Return the same world, in the same memory, in which motions also keep away from boxes that drift."""
        words = self.words.copy()
        words[-DRIFT_WORDS:] = pack(drifting)
        return dataclasses.replace(self, words=words, drifting=drifting)

    def gaps(self, boxes: np.ndarray, zs: LocalPoints, most: float) -> np.ndarray:
        """Return distances of the robot at local coordinates (n, nv) from rounded boxes (k, ROUNDED_BOX); (n, k) [m].

        They are cut off at `most`, and measured from the links' bounding spheres: the links are as far at least.
        """
        gaps = np.empty((len(zs), len(boxes)), np.float32)
        write_gaps(
            self.words, np.ascontiguousarray(boxes, np.float32), most, np.ascontiguousarray(zs, np.float32), gaps
        )
        return gaps.astype(float)

    def touching(self, zs: LocalPoints, clearance: float = 0.0) -> np.ndarray:
        """Return at which points (n, nv) the robot touches itself or lacks a clearance [m] from obstacles; (n,).

        Raises ValueError if a coordinate is not a finite number.
        """
        if not np.isfinite(zs).all():
            raise ValueError("a local coordinate is not a number")
        touching = np.empty(len(zs), np.bool_)
        touching_configurations(self.words, clearance, np.ascontiguousarray(zs, np.float32), touching)
        return touching

    def free_until(self, path: LocalPoints, resolution: float, clearance: float = 0.0) -> int:
        """Count the straight motions along a path (n, nv) that are free before the first that is not.

        Resolution and clearance are as in `shorten`. The first point itself is not tested.
        """
        return int(path_free_until(self.words, clearance, np.ascontiguousarray(path, np.float32), resolution))

    def shorten(self, path: LocalPoints, resolution: float, clearance: float = 0.0, tries: int = TRIES) -> LocalPoints:
        """Shorten a path (n, nv) by shortcuts that are free at samples; return one with the same ends, (k, nv).

        The resolution is in samples per length in local coordinates [1/rad or 1/m]; the clearance is of obstacles [m].
        """
        most, nv = len(path) + tries + 2, path.shape[1]
        rows, short = np.empty((most, nv), np.float32), np.empty((most, nv))
        count = shorten(self.words, np.ascontiguousarray(path, float), clearance, resolution, tries, rows, short)
        return cast(LocalPoints, short[:count].copy())


def _of(world: World) -> tuple[BatchRobot, Words, BatchScene, BufferLayout]:
    own = world.pairs.own
    robot, words = _robot(world.group, own.tobytes())
    scene = batch_scene(world.scene)
    return robot, words, scene, scratch_layout(robot, len(world.group.lower), len(own), len(scene.owners))
