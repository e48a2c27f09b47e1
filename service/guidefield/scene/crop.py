"""Crop a scene to what may be nearest to some place in a ball: distances from all places in the ball stay the same.

Of very many obstacles those are kept that may be nearest, of large surfaces and clouds the triangles and points that
may be: tables of all others are never made. `handlers/preparation.py` crops to the ball that the robot can reach.
Thresholds decide when cropping pays; that distances stay exact rests on the proof below and on `RELATIVE_ROUNDING`.

Let r be the ball's radius and d the distance of its centre from that of an obstacle, which contains a ball of radius a
and is within one of radius b. From anywhere in the ball the obstacle is at least d - r - b away, and at most d + r - a.
So an obstacle that is at least farther away than another is at most is never the nearest. For an obstacle that moves
the distances are those at all times: it is left out if it never gets near, and others only for where it always is.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.geometry.cache import Arrays, find_or_compute, is_large
from guidefield.kernels.collide.primitive import gaps_from_ball
from guidefield.memo import memoized_by
from guidefield.memory import content_key
from guidefield.scene.cloud import Cloud, cloud_specks
from guidefield.scene.cropped_surface import crop_surface, nearest_parts
from guidefield.scene.incremental import MANY, Rows, incremental
from guidefield.scene.movers import gaps_from_boxes, moving_ball, sweep_obstacles
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.recipe import Facets
from guidefield.scene.scene import Scene, declare_with, rows_of, with_others

NOBODY: frozenset[str] = frozenset()

RELATIVE_ROUNDING = 1e-9
"""Bounds on distances are wider by this times 1 m plus the distance from the origin."""

MANY_MOVING = 16  # number of moving obstacles from which some are left out: each is evaluated at many times
KEPT_BALLS = 2  # crops of an obstacle that stay in memory: tables of crops of large meshes are large
MAX_CROPPED_SHARE = 0.7  # an obstacle of which a larger share would be left is prepared whole


class Ball(NamedTuple):
    """A ball in the world: centre and radius [m]."""

    x: float
    y: float
    z: float
    radius: float


class NearestObstacles(NamedTuple):
    """The obstacles of a scene that may be nearest to some place in a ball."""

    least: np.ndarray  # lower bounds on each obstacle's distance from any place in the ball, at any time, (n,) [m]
    most: np.ndarray  # upper bounds, shape (n,) [m]
    chosen: np.ndarray  # those that may be nearest, ascending indices, shape (k,)
    some: Scene | None  # the scene with these alone; None: they are all of it

    def of(self, scene: Scene) -> Scene:
        """Return the kept part of the scene that this was found for."""
        return self.some or scene


def has_many(scene: Scene) -> bool:
    """Return whether a scene has enough obstacles, or moving ones, for it to pay to leave some out."""
    return (
        len(scene.obstacles) >= MANY or sum(scene.obstacles[k].motion is not None for k in scene.others) >= MANY_MOVING
    )


def has_large(scene: Scene) -> bool:
    """Return whether a scene has an obstacle at rest so large that it pays to prepare a part of it."""
    return is_large(scene.most_faces) and any(map(_is_large, map(scene.obstacles.__getitem__, scene.others)))


def crop(
    scene: Scene, ball: Ball, named: frozenset[str] = NOBODY, deadline: Deadline = UNLIMITED
) -> tuple[Scene, np.ndarray | None]:
    """Crop a scene to a ball; return it, itself if all is kept, and its obstacles' former indices (k,), None if all.

    Named obstacles are kept, and no other is left out for them: something may touch them, and then the nearest of the
    others counts. Raises DeadlineExpired if time was up before.
    """
    chosen = None
    if has_many(scene):
        deadline.check(f"what is in reach of scene {scene.name}")
        nearest = nearest_obstacles(scene, ball, named)
        if nearest.some is not None:
            scene, chosen = nearest.some, nearest.chosen
    if has_large(scene):
        deadline.check(f"what is in reach of scene {scene.name}")
        scene = _crop_large(scene, ball) or scene
    return scene, chosen


def _over(
    known: NearestObstacles, rows: Rows, scene: Scene, ball: Ball, named: frozenset[str] = NOBODY
) -> NearestObstacles:
    fresh = _gaps([scene.obstacles[index] for index in rows.fresh], ball, named)
    least, most = rows.carry(known.least, fresh[0]), rows.carry(known.most, fresh[1])
    chosen = _choose(least, most)
    return NearestObstacles(least, most, chosen, _some(known, rows, scene, chosen))


def _some(known: NearestObstacles, rows: Rows, scene: Scene, chosen: np.ndarray) -> Scene | None:
    """Return the scene with the chosen obstacles, None if they are all of it; the one before if it has the same."""
    some = known.some
    if some is None or len(chosen) == rows.count:
        return _of(scene, chosen)
    if len(chosen) < MANY:
        obstacles = tuple(map(scene.obstacles.__getitem__, chosen.tolist()))
        return some if obstacles == some.obstacles else _of(scene, chosen)
    step = rows.among(known.chosen, chosen)
    if not step.fresh and not step.removed:
        return some
    new = chosen[step.fresh].tolist()
    declared = step.listed(some.message.obstacles, [scene.message.obstacles[index] for index in new])
    fresh = [scene.obstacles[index] for index in new]
    return with_others(some, step, fresh, declare_with(scene.message, declared))


def _of(scene: Scene, chosen: np.ndarray) -> Scene | None:
    return None if len(chosen) == len(scene.obstacles) else scene.of(chosen.tolist())


@incremental(_over)
def nearest_obstacles(scene: Scene, ball: Ball, named: frozenset[str] = NOBODY) -> NearestObstacles:
    """Find the obstacles that may be nearest at some time, and all at rest that are no primitives; see `crop`.

    In a changed scene only the distances of other obstacles are found anew; `some` is the scene before if the chosen
    obstacles are the same.
    """
    least, most = _gaps(scene.obstacles, ball, named)
    chosen = _choose(least, most)
    return NearestObstacles(least, most, chosen, _of(scene, chosen))


def _choose(least: np.ndarray, most: np.ndarray) -> np.ndarray:
    return np.flatnonzero(least <= most.min(initial=np.inf))


def _gaps(obstacles: Sequence[Obstacle], ball: Ball, named: frozenset[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return bounds on obstacles' distances from any place in the ball at any time, both of shape (n,) [m].

    Named obstacles, and those at rest that are no primitives, are always kept: minus and plus infinity.
    """
    placed, least, most = rows_of(obstacles), np.empty(len(obstacles)), np.empty(len(obstacles))
    gaps_from_ball(placed, np.array(ball, float), RELATIVE_ROUNDING, least, most)
    moving = [index for index, one in enumerate(obstacles) if one.motion is not None]
    if moving:
        some = [obstacles[index] for index in moving]
        boxes, first, _ = sweep_obstacles(some, list(map(moving_ball, some)))
        nearest, farthest = gaps_from_boxes(boxes, np.array(ball[:3]), ball.radius)
        least[moving], most[moving] = np.minimum.reduceat(nearest, first), np.maximum.reduceat(farthest, first)
    if named:
        unknown = [one.name in named for one in obstacles]
        least[unknown], most[unknown] = -np.inf, np.inf
    return least, most


def _is_large(obstacle: Obstacle) -> bool:
    return obstacle.motion is None and is_large(obstacle.faces)


def _with_cropped(scene: Scene, ball: Ball) -> Scene | None:
    parts = [_crop_obstacle(one, ball) if _is_large(one) else None for one in scene.obstacles]
    if not any(parts):
        return None
    cropped = tuple(part or one for part, one in zip(parts, scene.obstacles, strict=True))
    return dataclasses.replace(scene, obstacles=cropped)


def _crop(obstacle: Obstacle, ball: Ball) -> Obstacle | None:
    centre, recipe = obstacle.placement.actInv(np.array(ball[:3])), obstacle.recipe
    if obstacle.cloud is not None:
        return _crop_cloud(obstacle, obstacle.cloud, centre, ball.radius)
    part = crop_surface(
        lambda: recipe.surface(obstacle.message),
        lambda: [surface[1] for surface in obstacle.surfaces],
        recipe.content,
        centre,
        ball.radius,
        solid=obstacle.solid,
        most=MAX_CROPPED_SHARE,
    )
    if part is None:
        return None
    made = _with_facets(obstacle, Facets(part.count, lambda: part.surface, part.content), part.content)
    return dataclasses.replace(made, recipe=made.recipe._replace(surface=lambda _: part.surface), cropped=part)


def _crop_cloud(obstacle: Obstacle, cloud: Cloud, centre: np.ndarray, radius: float) -> Obstacle | None:

    def find() -> Arrays:
        chosen = nearest_parts(cloud.points, np.arange(len(cloud.points))[:, None], centre, radius)
        return {"points": cloud.points[chosen] if chosen.mean() <= MAX_CROPPED_SHARE else np.empty((0, 3))}

    content = obstacle.recipe.content
    if content:
        known = {"content": np.frombuffer(content, np.uint8), "ball": np.array([*centre, radius, MAX_CROPPED_SHARE])}
        content = content_key(*known.values())
        points = find_or_compute("points", known, find)["points"]
    else:
        points = find()["points"]
    if not len(points):
        return None
    points.setflags(write=False)
    made = _with_facets(obstacle, Facets(len(points), lambda: cloud_specks(points), content), content)
    return dataclasses.replace(made, cloud=Cloud(points, cloud.radius))


def _with_facets(obstacle: Obstacle, facets: Facets, content: bytes) -> Obstacle:
    placement = obstacle.placement
    recipe = obstacle.recipe._replace(facets=facets, body=lambda _: (facets.whole, placement), content=content)
    return dataclasses.replace(obstacle, recipe=recipe)


_crop_large = memoized_by(lambda scene: scene, _with_cropped, KEPT_BALLS)
_crop_obstacle = memoized_by(lambda obstacle: obstacle, _crop, KEPT_BALLS)
