"""A scene as it is met by what stays in a ball: of large surfaces and clouds what may be nearest to some place in it.

All distances from places in the ball are those of the whole scene, and so is the field. Of a scanned hall a robot meets
a corner: tables of all that is elsewhere are never made.
"""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any, NamedTuple

import numpy as np

from guidefield.geometry.cache import is_large, remembered
from guidefield.geometry.entries import Arrays
from guidefield.memo import memoized_by
from guidefield.scene.anchor import anchor_of, no_anchor
from guidefield.scene.cloud import Cloud, cloud_specks
from guidefield.scene.facets import Facets
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene
from guidefield.scene.seen_surface import seen_of, seen_surface

FEW = 2
"""Balls for which what is met of a scene is kept: tables of what is met of large meshes are large."""

WORTH = 0.7
"""Where more of an obstacle is met, all of it is as soon prepared."""


class Ball(NamedTuple):
    """A ball in the world: centre and radius [m]."""

    x: float
    y: float
    z: float
    radius: float


def is_large_scene(scene: Scene) -> bool:
    """Whether anything at rest in a scene is large enough that a part of it is sooner prepared."""
    return is_large(scene.most_faces) and any(map(_is_large, map(scene.obstacles.__getitem__, scene.others)))


def within_ball(scene: Scene, ball: Ball) -> Scene:
    """The scene as it is met in a ball; the same object for the same ball, and the scene itself where all is met."""
    return _met(scene, ball) or scene


def _is_large(obstacle: Obstacle) -> bool:
    return obstacle.motion is None and is_large(obstacle.faces)


def _scene_met(scene: Scene, ball: Ball) -> Scene | None:
    """The scene as it is met; None where all of it is."""
    parts = [_part(one, ball) if _is_large(one) else None for one in scene.obstacles]
    if not any(parts):
        return None
    met = tuple(part or one for part, one in zip(parts, scene.obstacles, strict=True))
    return dataclasses.replace(scene, obstacles=met)


def _obstacle_met(obstacle: Obstacle, ball: Ball) -> Obstacle | None:
    """What is met of an obstacle that rests; None where most of it is."""
    centre = obstacle.placement.actInv(np.array(ball[:3]))
    if obstacle.cloud is not None:
        return _cloud_met(obstacle, obstacle.cloud, centre, ball.radius)
    recipe, message = obstacle.recipe, obstacle.message
    seen = seen_surface(
        lambda: recipe.surface(message),
        lambda: [part[1] for part in obstacle.surfaces],
        anchor_of if obstacle.solid else no_anchor,
        recipe.content,
        centre,
        ball.radius,
        WORTH,
    )
    if seen is None:
        return None
    facets = Facets(seen.count, lambda: seen.surface, seen.content)
    met = recipe._replace(
        surface=lambda _: seen.surface, facets=facets, body=_body_of(facets, obstacle), content=seen.content
    )
    return dataclasses.replace(obstacle, recipe=met, seen=seen)


def _cloud_met(obstacle: Obstacle, cloud: Cloud, centre: np.ndarray, radius: float) -> Obstacle | None:
    """What is met of a cloud; of a large one from disk if it was asked for before."""

    def found() -> Arrays:
        chosen = seen_of(cloud.points, np.arange(len(cloud.points))[:, None], centre, radius)
        return {"points": cloud.points[chosen] if chosen.mean() <= WORTH else np.empty((0, 3))}

    content = obstacle.recipe.content
    if content:
        known = {"content": np.frombuffer(content, np.uint8), "ball": np.array([*centre, radius, WORTH])}
        content = hashlib.sha256(b"".join(one.tobytes() for one in known.values())).digest()
        points = remembered("points", known, found)["points"]
    else:
        points = found()["points"]
    if not len(points):
        return None
    points.setflags(write=False)
    facets = Facets(len(points), lambda: cloud_specks(points), content)
    recipe = obstacle.recipe._replace(facets=facets, body=_body_of(facets, obstacle), content=content)
    return dataclasses.replace(obstacle, recipe=recipe, cloud=Cloud(points, cloud.radius))


def _body_of(facets: Facets, obstacle: Obstacle) -> Any:
    placement = obstacle.placement
    return lambda _: (facets.whole, placement)


_met = memoized_by(lambda scene: scene, _scene_met, FEW)
_part = memoized_by(lambda obstacle: obstacle, _obstacle_met, FEW)
