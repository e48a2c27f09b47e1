"""Many configurations at once: whether a robot touches anything, by the lane kernels.

What these say is free keeps apart on the exact geometry, within `BAND`; but only at samples. The certificate judges
what is between them.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from guidefield.collision.lane_robot import LaneRobot, lane_robot, turned_from
from guidefield.collision.lane_scene import lane_scene
from guidefield.collision.world import World
from guidefield.kept import kept_with
from guidefield.kernels.lane_kinematics import POSE
from guidefield.kernels.lane_motion import FRACTIONS, LaneWorld, path_free_until, touching_configurations
from guidefield.kernels.lane_shortcut import shortcut, without_detours
from guidefield.kernels.lane_tables import AXIS_AND_REACH, BALL, HITS, Scratch
from guidefield.kernels.lane_words import SCENE_WORDS, scene_words
from guidefield.kernels.lanes import LANES
from guidefield.kernels.packing import Words, packed
from guidefield.kernels.separation import WORK
from guidefield.robot.alike import kept_with_alike
from guidefield.robot.coverage import coverage
from guidefield.robot.group import PlanningGroup

TRIES = 60
"""Straight ways between places on a path that are looked at, unless told otherwise."""


@kept_with
def _robot(group: PlanningGroup, pairs: bytes) -> tuple[LaneRobot, Words]:
    """The tables of a group and the pairs (int64) that must not touch."""
    robot, words = _unturned(group, pairs)
    joints = turned_from(robot.joints, group)
    if joints is robot.joints:
        return robot, words
    return dataclasses.replace(robot, joints=joints), packed((joints, robot.bodies, robot.parts))


@kept_with_alike
def _unturned(group: PlanningGroup, pairs: bytes) -> tuple[LaneRobot, Words]:
    """The same, wherever the group starts."""
    robot = lane_robot(group, coverage(group.robot).shapes, np.frombuffer(pairs, np.int64).reshape(-1, 2))
    return robot, packed((robot.joints, robot.bodies, robot.parts))


@dataclass(frozen=True, eq=False)
class Lanes:
    """A world for the lane kernels; like the world itself it answers one question at a time.

    Attributes:
        world: Robot and obstacles.
        tables: The same as arrays.
        words: Those packed.
    """

    world: World
    tables: LaneWorld
    words: Words

    @classmethod
    def build(cls, world: World) -> Lanes:
        """Make the tables of a world."""
        own, mixed = world.pairs[: world.n_self], world.pairs[world.n_self :]
        robot, words = _robot(world.group, own.tobytes())
        bodies, nv = robot.bodies, world.group.nv
        scene = lane_scene(world.scene)
        tested = np.zeros((bodies.size, len(world.scene.obstacles)), np.int64)
        tested[mixed[:, 0], mixed[:, 1] - bodies.size] = 1
        obstacles = scene.obstacles._replace(tested=_frozen(tested[:, scene.owners].ravel()))
        n_obstacles, n_poses = obstacles.size, robot.joints.size * POSE
        scratch = Scratch(
            poses=np.zeros(n_poses, np.float32),
            centres=np.zeros(bodies.carriers * BALL, np.float32),
            found=np.zeros(3 * (bodies.size * n_obstacles + len(own) + 1), np.int64),
            obstacle_axes=np.zeros(AXIS_AND_REACH * bodies.size * n_obstacles),
            pair_axes=np.zeros(AXIS_AND_REACH * robot.pieces_paired),
            pose_a=np.zeros(12),
            pose_b=np.zeros(12),
            work=np.zeros(WORK),
            middle=np.zeros(nv * LANES, np.float32),
            middle_poses=np.zeros(n_poses, np.float32),
            places=np.zeros(2 * LANES, np.float32),
            hits=np.full(3 * HITS, -1, np.int64),
        )
        block = np.zeros(nv * LANES, np.float32)
        rest = (obstacles, scene.parts, scratch, block, FRACTIONS, nv)
        tables = LaneWorld(robot.joints, bodies, robot.parts, *rest)
        all_words = np.empty(len(words) + SCENE_WORDS, np.int64)
        # a robot's words come first, and are the same in every scene
        all_words[: len(words)] = words
        scene_words(rest, all_words[len(words) :])
        return cls(world, tables, all_words)

    def forget(self) -> None:
        """Forget what earlier answers left behind: the same questions from here on have the same answers to the bit."""
        scratch = self.tables.scratch
        scratch.obstacle_axes.fill(0.0)
        scratch.pair_axes.fill(0.0)
        scratch.hits.fill(-1)

    def touching(self, zs: np.ndarray, clearance: float = 0.0) -> np.ndarray:
        """Which of some chart points touch an obstacle or themselves.

        Args:
            zs: Chart points, shape (n, nv) [rad or m].
            clearance: What to keep from obstacles [m].

        Returns:
            Shape (n,), bool.

        Raises:
            ValueError: if a coordinate is not a finite number.
        """
        if not np.isfinite(zs).all():
            raise ValueError("a chart point has a coordinate that is not a number")
        touching = np.empty(len(zs), np.bool_)
        touching_configurations(self.words, clearance, np.ascontiguousarray(zs, np.float32), touching)
        return touching

    def free_until(self, path: np.ndarray, resolution: float, clearance: float = 0.0) -> int:
        """How many of the straight motions along a path are free before the first that is not, by samples.

        Args:
            path: Chart points, shape (n, nv); the first itself is not judged.
            resolution: Samples per length in the chart [1/rad or 1/m].
            clearance: What to keep from obstacles [m].
        """
        return int(path_free_until(self.words, clearance, np.ascontiguousarray(path, np.float32), resolution))

    def shortened(self, path: np.ndarray, resolution: float, clearance: float = 0.0, tries: int = TRIES) -> np.ndarray:
        """A path with the same ends that is no longer; free by samples where it was.

        Args:
            path: Chart points, shape (n, nv).
            resolution: Samples per length in the chart [1/rad or 1/m].
            clearance: What to keep from obstacles [m].
            tries: Straight ways between places on it that are looked at.
        """
        rows = np.empty((len(path) + tries + 2, path.shape[1]), np.float32)
        rows[: len(path)] = path
        count = without_detours(self.words, rows, len(path), clearance, resolution)
        count = shortcut(self.words, rows, count, clearance, resolution, 0, tries)
        count = without_detours(self.words, rows, count, clearance, resolution)
        short = rows[:count].astype(float)
        short[0], short[-1] = path[0], path[-1]  # lanes hold float32: the ends are as they were given
        return short


def _frozen(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array
