"""The obstacles of a scene that move, and what there is about each of them; made once for each scene."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from guidefield.memo import memoized
from guidefield.read_only import ReadOnly
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene
from guidefield.scene.swept import MovingBall, Swept, gaps_from_boxes, motion_of, moving_ball, swept


@dataclass(frozen=True, eq=False)
class Movers(ReadOnly):
    """Obstacles that move.

    Attributes:
        indices: Which they are of the scene's obstacles, ascending, shape (m,).
        obstacles: Each of them.
        balls: About each; None about a half-space.
        boxes: About their shapes along their own axes, shape (m, 2, 3) [m].
        rounded: What they are rounded by, shape (m,) [m].
        times: When each is on its placements [s].
        speeds: How fast each loses distance at most from one placement to the next; 0 of a half-space [m/s].
        swept: Where they get.
        endless: Whether any is a half-space.
    """

    indices: np.ndarray
    obstacles: tuple[Obstacle, ...]
    balls: tuple[MovingBall | None, ...]
    boxes: np.ndarray
    rounded: np.ndarray
    times: tuple[list[float], ...]
    speeds: tuple[list[float], ...]
    swept: Swept
    endless: bool

    def near(self, centre: np.ndarray, radius: float, margin: float) -> np.ndarray:
        """Which of them come within a margin [m] of a ball at any time.

        Args:
            centre: Of the ball, shape (3,) [m, world].
            radius: Its radius [m].
            margin: The margin [m].

        Returns:
            Shape (m,), bool.
        """
        gaps = gaps_from_boxes(self.swept.boxes, centre, radius)[0]
        near: np.ndarray = np.minimum.reduceat(gaps, self.swept.first) <= margin
        return near


@memoized
def movers(scene: Scene) -> Movers:
    """The obstacles of a scene that move."""
    indices = [index for index in scene.others if scene.obstacles[index].motion is not None]
    obstacles = tuple(scene.obstacles[index] for index in indices)
    balls = tuple(map(moving_ball, obstacles))
    ways = swept(obstacles, balls)
    ends = [*ways.first.tolist(), len(ways.speeds)]
    return Movers(
        np.array(indices, np.int64),
        obstacles,
        balls,
        np.array([one.box for one in obstacles]).reshape(-1, 2, 3),
        np.array([one.rounding for one in obstacles]),
        tuple(motion_of(one).times.tolist() for one in obstacles),
        tuple(ways.speeds[begin + 1 : end - 1].tolist() for begin, end in pairwise(ends)),
        ways,
        any(ball is None for ball in balls),
    )
