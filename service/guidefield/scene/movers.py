"""Moving obstacles of a scene, balls about them, and their swept volumes: boxes about the balls between placements.

By these boxes, which must not be too small, `scene/crop.py` leaves movers out of a scene, for plans and proofs alike.
On a screw from one place to another that is c away, a point moves by a length L at one speed. So it stays within
sqrt(L^2 - c^2) / 2 of the straight line between the two: any farther place would make its path longer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from guidefield.memo import memoized
from guidefield.read_only import ReadOnly
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.obstacle_message import ObstacleMotion, ball_rates
from guidefield.scene.scene import Scene

ROUNDING = 1e-6  # margin of the boxes: this times 1 m plus the distance from the origin and the travel
EVERYWHERE = np.repeat([-np.inf, np.inf], 3)  # the box about a half-space

_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])


class MovingBall(NamedTuple):
    """A ball about an obstacle that moves: centre (3,) in the frame of the motion, and radius [m]."""

    centre: np.ndarray
    radius: float


class Swept(NamedTuple):
    """The swept volumes of moving obstacles."""

    # boxes along the world's axes, lower then upper corners (n, 6) [m], one obstacle's behind the other's: where it is
    # before it moves, from each of its placements to the next, and after that; of a half-space infinite
    boxes: np.ndarray
    first: np.ndarray  # index of the first box of each obstacle, shape (m,)
    speeds: np.ndarray  # largest speed of any of its points during each, shape (n,) [m/s]; 0 for a half-space


def motion_of(obstacle: Obstacle) -> ObstacleMotion:
    """Return the motion of an obstacle that moves."""
    assert obstacle.motion is not None, "only what moves is asked for"
    return obstacle.motion


def moving_ball(obstacle: Obstacle) -> MovingBall | None:
    """Return a ball about an obstacle that moves; None for a half-space."""
    if obstacle.endless:
        return None
    (low, high), placement = obstacle.box, obstacle.placement
    if obstacle.cloud is not None:
        middle = 0.5 * (low + high)
    else:
        vertices = obstacle.vertices
        middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    corners = (low + _CORNERS * (high - low)) @ placement.rotation.T + placement.translation
    centre = np.asarray(motion_of(obstacle).placements[0].actInv(middle))
    return MovingBall(centre, float(np.linalg.norm(corners - middle, axis=1).max()) + obstacle.rounding)


def sweep_obstacles(obstacles: Sequence[Obstacle], balls: Sequence[MovingBall | None]) -> Swept:
    """Return the swept volumes of moving obstacles, given the balls about them, `moving_ball`."""
    motions = [motion_of(one) for one in obstacles]
    counts = np.array([len(motion.times) for motion in motions], int)
    if not len(counts):
        return Swept(np.empty((0, 6)), np.empty(0, int), np.empty(0))
    origin = np.zeros(3)
    centres = [origin if ball is None else ball.centre for ball in balls]
    radii = np.array([0.0 if ball is None else ball.radius for ball in balls])
    there = np.array([at.act(c) for motion, c in zip(motions, centres, strict=True) for at in motion.placements])
    steps = np.repeat(np.arange(len(counts)), counts - 1)
    twists = np.concatenate([motion.twists for motion in motions])
    lasting = np.concatenate([np.diff(motion.times) for motion in motions])
    of_centre, angular = ball_rates(twists, np.array(centres)[steps], 0.0)[0], np.linalg.norm(twists[:, 3:], axis=1)
    begins = np.delete(np.arange(len(there)), np.cumsum(counts) - 1)
    way, straight = of_centre * lasting, np.linalg.norm(there[begins + 1] - there[begins], axis=1)
    # a row before each obstacle's first placement, one for each step, one after its last
    first = np.cumsum(counts + 1) - (counts + 1)
    of_row = np.repeat(np.arange(len(counts)), counts + 1)
    at_step = np.delete(np.arange(len(of_row)), np.concatenate([first, first + counts]))
    sideways, speeds = np.zeros(len(of_row)), np.zeros(len(of_row))
    sideways[at_step] = 0.5 * np.sqrt(np.maximum(way**2 - straight**2, 0.0))
    speeds[at_step] = of_centre + radii[steps] * angular
    far = np.abs(there).max(axis=1)
    before = np.arange(len(of_row)) - of_row
    after = np.minimum(before, np.repeat(np.cumsum(counts) - 1, counts + 1))
    before = np.maximum(before - 1, np.repeat(np.cumsum(counts) - counts, counts + 1))
    wide = sideways + radii[of_row] + ROUNDING * (1.0 + np.maximum(far[before], far[after]) + sideways)
    low, high = np.minimum(there[before], there[after]), np.maximum(there[before], there[after])
    boxes = np.hstack([low - wide[:, None], high + wide[:, None]])
    endless = np.array([ball is None for ball in balls])[of_row]
    boxes[endless], speeds[endless] = EVERYWHERE, 0.0
    return Swept(boxes, first, speeds)


def gaps_from_boxes(boxes: np.ndarray, centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Bound the distances of points in boxes (n, 6), lower then upper corners, from places in a ball: least, most."""
    below, above = boxes[:, :3] - centre, centre - boxes[:, 3:]
    least = np.linalg.norm(np.maximum(np.maximum(below, above), 0.0), axis=1) - radius
    most = np.linalg.norm(np.maximum(np.abs(below), np.abs(above)), axis=1) + radius
    return least, most


@dataclass(frozen=True, eq=False)
class Movers(ReadOnly):
    """Obstacles that move."""

    indices: np.ndarray  # in the scene, ascending, shape (m,)
    obstacles: tuple[Obstacle, ...]
    balls: tuple[MovingBall | None, ...]  # None about a half-space
    boxes: np.ndarray  # about their shapes along their own axes, shape (m, 2, 3) [m]
    rounded: np.ndarray  # radii by which they are rounded, shape (m,) [m]
    times: tuple[list[float], ...]  # of each one's placements [s]
    speeds: tuple[list[float], ...]  # largest at which each may lose distance from one placement to the next [m/s]
    endless: bool  # whether there is a half-space


@memoized
def movers(scene: Scene) -> Movers:
    """Return the moving obstacles of a scene."""
    indices = [index for index in scene.others if scene.obstacles[index].motion is not None]
    obstacles = tuple(scene.obstacles[index] for index in indices)
    balls = tuple(map(moving_ball, obstacles))
    ways = sweep_obstacles(obstacles, balls)
    ends = [*ways.first.tolist(), len(ways.speeds)]
    return Movers(
        np.array(indices, np.int64),
        obstacles,
        balls,
        np.array([one.box for one in obstacles]).reshape(-1, 2, 3),
        np.array([one.rounding for one in obstacles]),
        tuple(motion_of(one).times.tolist() for one in obstacles),
        tuple(ways.speeds[begin + 1 : end - 1].tolist() for begin, end in pairwise(ends)),
        any(ball is None for ball in balls),
    )
