"""Crop a scene to what may be nearest to some place in a ball: distances from all places in the ball stay the same.

Of very many obstacles those are kept that may be nearest, of large surfaces and clouds the triangles and points that
may be: tables of all others are never made. `handlers/preparation.py` crops to the ball that the robot can reach.
Thresholds decide when cropping pays; that distances stay exact rests on the proof below, and on both roundings.

Let r be the ball's radius and d the distance of its centre from that of an obstacle, which contains a ball of radius a
and is within one of radius b. From anywhere in the ball the obstacle is at least d - r - b away, and at most d + r - a.
So an obstacle that is at least farther away than another is at most is never the nearest. For an obstacle that moves
the distances are those at all times: it is left out if it never gets near, and others only for where it always is.

Signed distances from a cropped surface stay exact by the neighbours of the kept triangles and, for a solid, an anchor:
a place from which the sides are known (kernels/distance/winding.py). Kept parts are cached on disk by the surface's
hash.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.geometry.cache import Arrays, find_or_compute, is_large
from guidefield.geometry.closed import boxes_about, drop_unused
from guidefield.geometry.distance_bodies import NO_TRIANGLES, are_wide
from guidefield.geometry.surfaces import box_about
from guidefield.kernels.collide.primitive import gaps_from_ball
from guidefield.kernels.cover.crop_to_ball import crop_to_ball, distance_to_triangles
from guidefield.kernels.distance.winding import ANCHOR, BALL, PLACE, REACH, ROOM, TURNS, winding_by_angles
from guidefield.memo import memoized_by
from guidefield.memory import content_key
from guidefield.scene.cloud import Cloud, cloud_specks
from guidefield.scene.incremental import MANY, Rows, incremental
from guidefield.scene.movers import gaps_from_boxes, moving_ball, sweep_obstacles
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.obstacle_parts import CroppedSurface, Facets, Whole
from guidefield.scene.scene import Scene, declare_with, rows_of, with_others

NOBODY: frozenset[str] = frozenset()

RELATIVE_ROUNDING = 1e-9
"""Bounds on distances are wider by this times 1 m plus the distance from the origin."""

MANY_MOVING = 16  # number of moving obstacles from which some are left out: each is evaluated at many times
KEPT_BALLS = 2  # crops of an obstacle that stay in memory: tables of crops of large meshes are large
MAX_CROPPED_SHARE = 0.7  # an obstacle of which a larger share would be left is prepared whole

_GOOD_ANCHOR = 0.05  # the ball's centre serves as anchor if so large a share of its radius about it is free. Unrecorded
ROUNDING = 1e-9  # share by which the ball is larger when solids that come into it are kept: it may grow, not shrink
_WINDING_TOLERANCE = 0.01  # an anchor's winding number is within this, far below 0.5, of a whole one: sides rest on it


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


def _update_nearest(
    known: NearestObstacles, rows: Rows, scene: Scene, ball: Ball, named: frozenset[str] = NOBODY
) -> NearestObstacles:
    fresh = _bound_gaps([scene.obstacles[index] for index in rows.fresh], ball, named)
    least, most = rows.carry(known.least, fresh[0]), rows.carry(known.most, fresh[1])
    chosen = _choose(least, most)
    return NearestObstacles(least, most, chosen, _kept_scene(known, rows, scene, chosen))


def _kept_scene(known: NearestObstacles, rows: Rows, scene: Scene, chosen: np.ndarray) -> Scene | None:
    """Return the scene with the chosen obstacles, None if they are all of it; the one before if it has the same."""
    some = known.some
    if some is None or len(chosen) == rows.count:
        return _chosen_scene(scene, chosen)
    if len(chosen) < MANY:
        obstacles = tuple(map(scene.obstacles.__getitem__, chosen.tolist()))
        return some if obstacles == some.obstacles else _chosen_scene(scene, chosen)
    step = rows.among(known.chosen, chosen)
    if not step.fresh and not step.removed:
        return some
    new = chosen[step.fresh].tolist()
    declared = step.listed(some.message.obstacles, [scene.message.obstacles[index] for index in new])
    fresh = [scene.obstacles[index] for index in new]
    return with_others(some, step, fresh, declare_with(scene.message, declared))


def _chosen_scene(scene: Scene, chosen: np.ndarray) -> Scene | None:
    return None if len(chosen) == len(scene.obstacles) else scene.of(chosen.tolist())


@incremental(_update_nearest)
def nearest_obstacles(scene: Scene, ball: Ball, named: frozenset[str] = NOBODY) -> NearestObstacles:
    """Find the obstacles that may be nearest at some time, and all at rest that are no primitives; see `crop`.

    In a changed scene only the distances of other obstacles are found anew; `some` is the scene before if the chosen
    obstacles are the same.
    """
    least, most = _bound_gaps(scene.obstacles, ball, named)
    chosen = _choose(least, most)
    return NearestObstacles(least, most, chosen, _chosen_scene(scene, chosen))


def _choose(least: np.ndarray, most: np.ndarray) -> np.ndarray:
    return np.flatnonzero(least <= most.min(initial=np.inf))


def _bound_gaps(obstacles: Sequence[Obstacle], ball: Ball, named: frozenset[str]) -> tuple[np.ndarray, np.ndarray]:
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


def _crop_obstacles(scene: Scene, ball: Ball) -> Scene | None:
    parts = [_crop_obstacle(one, ball) if _is_large(one) else None for one in scene.obstacles]
    if not any(parts):
        return None
    cropped = tuple(part or one for part, one in zip(parts, scene.obstacles, strict=True))
    return dataclasses.replace(scene, obstacles=cropped)


def _crop_one(obstacle: Obstacle, ball: Ball) -> Obstacle | None:
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


def crop_surface(
    whole: Whole,
    solids: Callable[[], list[np.ndarray]],
    content: bytes,
    centre: np.ndarray,
    radius: float,
    *,
    solid: bool,
    most: float,
) -> CroppedSurface | None:
    """Crop a surface to a ball: from everywhere in the ball the part is as far as all of it. Small solids stay or go.

    `whole` makes the surface, `solids` the triangles of its solids, or all of a thin one; both only if needed. With the
    surface's hash `content` the part is kept on disk. None if a larger share than `most` of its triangles is left.
    """

    def find() -> Arrays:
        return _find_parts(whole(), solids(), solid, centre, radius, most)

    if not content:
        return _restore_part(find(), whole, solids, b"")
    known = {"content": np.frombuffer(content, np.uint8), "ball": np.array([*centre, radius, most])}
    own = content_key(*known.values())
    return _restore_part(find_or_compute("seen", known, find), whole, solids, own)


def _find_parts(
    surface: tuple[np.ndarray, np.ndarray],
    solids: list[np.ndarray],
    solid: bool,
    centre: np.ndarray,
    radius: float,
    most: float,
) -> Arrays:
    """Return the part as arrays, triangles as int32; if too much is left, empty `counts` alone."""
    vertices, triangles = surface
    if len(solids) > 1:
        solids = _near_solids(vertices, solids, centre, radius)
    parts = [_crop_solid(vertices, one, centre, radius) for one in solids]
    if sum(len(kept) for kept, _ in parts) > most * len(triangles):
        return {"counts": np.empty((0, 2), np.int64)}
    alone, numbers = drop_unused(vertices, np.concatenate([one for part in parts for one in part]))
    anchors = np.zeros((len(parts), ANCHOR))
    for row, one, (_, beside) in zip(anchors, solids, parts, strict=True):
        if solid and len(beside):
            row[:] = anchor_of(vertices, one, centre, radius)
    return {
        "counts": np.array([[len(kept), len(beside)] for kept, beside in parts]),
        "anchors": anchors,
        "box": box_about(vertices),
        "vertices": alone,
        "triangles": numbers.astype(np.int32),
    }


def _near_solids(vertices: np.ndarray, solids: list[np.ndarray], centre: np.ndarray, radius: float) -> list[np.ndarray]:
    """Return the solids that may be nearest to some place in a ball, or around one: whose boxes come into the ball."""
    triangles = np.concatenate(solids)
    ends = np.cumsum([len(one) for one in solids])
    starts = np.concatenate([[0], ends[:-1]])
    near = np.logical_or.reduceat(nearest_parts(vertices, triangles, centre, radius), starts)
    low, high = boxes_about(vertices, solids).swapaxes(0, 1)
    apart = np.linalg.norm(np.maximum(np.maximum(low - centre, centre - high), 0.0), axis=1)
    near |= apart <= radius * (1.0 + ROUNDING)
    return [one for one, kept in zip(solids, near.tolist(), strict=True) if kept]


def _restore_part(
    found: Arrays, whole: Whole, solids: Callable[[], list[np.ndarray]], content: bytes
) -> CroppedSurface | None:
    counts = found["counts"]
    if not len(counts):
        return None
    numbers = np.split(found["triangles"].astype(np.int64), np.cumsum(counts.ravel())[:-1])
    parts = zip(numbers[0::2], numbers[1::2], strict=True)
    kept = tuple((found["vertices"], *part) for part in parts)
    return CroppedSurface(kept, found["anchors"], found["box"], whole, solids, content)


def _crop_solid(
    vertices: np.ndarray, triangles: np.ndarray, centre: np.ndarray, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles of a solid that are kept, and their neighbours."""
    wide = are_wide(vertices, triangles)  # what has no area counts for Coal alone, and hides nothing
    chosen = np.ones(len(triangles), bool)
    if is_large(int(wide.sum())):
        chosen[wide] = nearest_parts(vertices, triangles[wide], centre, radius)
    if chosen.all():
        return triangles, NO_TRIANGLES
    marked = np.zeros(len(vertices), bool)
    marked[triangles[chosen]] = True
    a, b, c = triangles.T
    beside = (marked[a] | marked[b] | marked[c]) & ~chosen
    return triangles[chosen], triangles[beside]


def nearest_parts(vertices: np.ndarray, corners: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Choose triangles or points that may be nearest to some place in a ball, shape (n,); see `crop_to_ball`."""
    chosen = np.empty(len(corners), bool)
    vertices, corners = np.ascontiguousarray(vertices, float), np.ascontiguousarray(corners, np.int64)
    crop_to_ball(vertices, corners, np.ascontiguousarray(centre, float), radius, chosen)
    return chosen


def anchor_of(vertices: np.ndarray, triangles: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Return a place from which the sides of a solid are known within a ball, see `winding.surely_outside_seen`.

    It is the ball's centre (3,), or the place around it about which most is free of the surface of vertices (v, 3) and
    triangles (t, 3) [m]. Shape (ANCHOR,); with no room where nothing is known.
    """
    wide = triangles[are_wide(vertices, triangles)]
    surface, row = (np.ascontiguousarray(vertices, float), np.ascontiguousarray(wide, np.int64)), np.zeros(ANCHOR)
    row[BALL:REACH], row[REACH] = centre, radius
    for off in np.vstack([np.zeros(3), 0.5 * np.eye(3), -0.5 * np.eye(3)]):
        x, y, z = (float(one) for one in centre + radius * off)
        free = min(distance_to_triangles(x, y, z, *surface), radius * (1.0 - float(np.linalg.norm(off))))
        if 0.5 * free > row[ROOM]:
            row[PLACE:ROOM], row[ROOM] = (x, y, z), 0.5 * free
        if row[ROOM] >= 0.5 * _GOOD_ANCHOR * radius:
            break
    turns = winding_by_angles(row[PLACE], row[PLACE + 1], row[PLACE + 2], *surface) if row[ROOM] > 0.0 else 0.0
    row[TURNS] = round(turns)
    if abs(turns - row[TURNS]) > _WINDING_TOLERANCE:
        row[ROOM] = 0.0
    return row


_crop_large = memoized_by(lambda scene: scene, _crop_obstacles, KEPT_BALLS)
_crop_obstacle = memoized_by(lambda obstacle: obstacle, _crop_one, KEPT_BALLS)
