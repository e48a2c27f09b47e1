"""Find pairs of bodies that may be near each other, by bounding spheres and boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.collision.bodies import Bodies, bodies
from guidefield.collision.box_tree import CHILDREN
from guidefield.collision.obstacle_boxes import ObstacleBoxes, obstacle_boxes
from guidefield.collision.pairs import Pairs
from guidefield.kernels.collide.near_pairs import BalledRobot, BoxedObstacles
from guidefield.read_only import read_only
from guidefield.robot.group.alike import memoized_for_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import Scene


def balled_robot(group: PlanningGroup, pairs: Pairs) -> BalledRobot:
    """Balls about a robot's bodies, and its own pairs."""
    return _robot(group, pairs.own.tobytes(), pairs.moving.tobytes())


def boxed_obstacles(scene: Scene, pairs: Pairs) -> BoxedObstacles:
    """Boxes about a scene's obstacles, and which pairs with them are left out."""
    boxes = obstacle_boxes(scene)
    order = boxes.tree.order
    obstacles = BoxedObstacles(
        axes=boxes.axes,
        middles=boxes.centres,
        halves=boxes.halves,
        nodes=boxes.tree.nodes,
        levels=boxes.tree.firsts,
        children=CHILDREN,
        order=boxes.bounded[order] if len(boxes.endless) else order,
        endless=boxes.endless,
        left_out=pairs.left_out.astype(np.int64),
    )
    read_only(*obstacles)
    return obstacles


@memoized_for_alike
def _robot(group: PlanningGroup, own_pairs: bytes, moving: bytes) -> BalledRobot:
    """A robot with its own pairs and the bodies that are tested against obstacles, both arrays of int64."""
    about = bodies(group)
    robot = BalledRobot(
        carriers=about.joints.astype(np.int64),
        centres=np.array(about.centres, float, order="C").reshape(-1, 3),
        radii=np.array(about.radii, float),
        part_centres=np.array(about.part_centres, float, order="C"),
        part_radii=np.array(about.part_radii, float),
        own=np.frombuffer(own_pairs, np.int64).reshape(-1, 2),
        moving=np.frombuffer(moving, np.int64),
    )
    read_only(*robot)
    return robot


SLACK = 1e-9
"""What boxes about balls are wider by, for rounding [m]."""


@dataclass(frozen=True, eq=False)
class NearPairs:
    """Lower bounds of the signed distances of pairs, and the pairs whose bounds are low.

    Attributes:
        pairs: The pairs.
        bodies: Balls about the robot's bodies.
        boxes: Boxes about obstacles.
    """

    pairs: Pairs
    bodies: Bodies
    boxes: ObstacleBoxes

    def separations(self, centres: np.ndarray, which: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Lower bounds of the signed distances of chosen pairs, by one ball about each of the robot's bodies.

        A ball that overlaps another, or a box from outside, bounds the depth too; a centre inside a box bounds nothing:
        minus infinity.

        Args:
            centres: Centres of the balls at s configurations, shape (s, r, 3) [m, world].
            which: Configuration at which each pair is asked for, shape (m,).
            pairs: Indices of the pairs, shape (m,).

        Returns:
            Shape (m,) [m].
        """
        first, second = self.pairs.bodies(pairs).T
        own, radii, found = pairs < self.pairs.n_self, self.bodies.radii, np.empty(len(pairs))
        a, b = first[own], second[own]
        between = centres[which[own], a] - centres[which[own], b]
        found[own] = np.sqrt(np.einsum("mi,mi->m", between, between)) - radii[a] - radii[b]
        body, obstacle = first[~own], second[~own] - self.pairs.links
        gaps = self.boxes.gaps(centres[which[~own], body][:, None], obstacle)[:, 0]
        found[~own] = np.where(gaps > 0.0, gaps - radii[body], -np.inf)
        return found

    def closer_separations(self, placements: np.ndarray, which: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """The same by the balls about parts of bodies: closer to the distances.

        Where balls overlap they bound no depth, because bodies can overlap in several parts: minus infinity.

        Args:
            placements: ``T_world_joint`` of every joint of the model at s configurations, shape (s, njoints, 3, 4) [m].
            which: As in `separations`.
            pairs: As there.

        Returns:
            Shape (m,) [m].
        """
        first, second = self.pairs.bodies(pairs).T
        own, radii, found = pairs < self.pairs.n_self, self.bodies.part_radii, np.empty(len(pairs))
        centres = self.bodies.part_centres_in_world(placements, which, first)
        if own.any():
            others = self.bodies.part_centres_in_world(placements, which[own], second[own])
            between = centres[own][:, :, None] - others[:, None]
            nearest = np.sqrt(np.einsum("mabi,mabi->mab", between, between).min(axis=(1, 2)))
            found[own] = nearest - radii[first[own]] - radii[second[own]]
        gaps = self.boxes.gaps(centres[~own], second[~own] - self.pairs.links).min(axis=1)
        found[~own] = gaps - radii[first[~own]]
        return np.where(found > 0.0, found, -np.inf)

    def by_place(self, centres: np.ndarray, margins: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The pairs with obstacles whose boxes are within margins of the boxes about balls: no others are as near.

        Args:
            centres: As in `separations`.
            margins: Of the robot's bodies, shape (s, r) [m].

        Returns:
            Configuration and index of each of them, both of shape (k,).
        """
        moving = self.pairs.moving
        middle = centres[:, moving].reshape(-1, 3)
        reach = (self.bodies.radii[moving] + margins[:, moving]).reshape(-1, 1) + SLACK * (1.0 + np.abs(middle))
        asked, obstacles = self.boxes.overlapping(middle - reach, middle + reach)
        which, rows = np.divmod(asked, max(1, len(moving)))
        are, pairs = self.pairs.with_obstacles(rows, obstacles)
        return which[are], pairs
