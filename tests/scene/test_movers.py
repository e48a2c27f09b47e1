"""What moves stays in its ball and in the boxes that it is said to stay in, between its placements too."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.scene.movers import EVERYWHERE, gaps_from_boxes, moving_ball, sweep_obstacles
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import build
from tests.scene.test_motion import KINDS

BOUNDED = [one for one in KINDS if not isinstance(one, messages.HalfSpace)]


def wandering(seed: int) -> messages.ObstacleTrajectory:
    """Placements far apart, turned by up to half a turn from one to the next."""
    rng = np.random.default_rng(seed)
    turns = [pin.Quaternion(pin.exp3(rng.normal(size=3) * rng.uniform(0.1, 3.0))).coeffs() for _ in range(4)]
    places = [Placement(tuple(rng.normal(size=3).tolist()), tuple(turn.tolist())) for turn in turns]
    return messages.ObstacleTrajectory(np.cumsum(rng.uniform(0.1, 2.0, 4)).tolist(), places)


def moving(kind: messages.Obstacle, seed: int) -> Obstacle:
    declared = type(kind)(**{**{f: getattr(kind, f) for f in kind.__struct_fields__}, "trajectory": wandering(seed)})
    return build(messages.Scene("s", obstacles=[declared])).obstacles[0]


def boxes_of(one: Obstacle) -> np.ndarray:
    return sweep_obstacles([one], [moving_ball(one)]).boxes


@pytest.mark.parametrize("kind", BOUNDED, ids=lambda one: type(one).__name__)
@pytest.mark.parametrize("seed", range(3))
def test_it_stays_in_the_box_of_each_stretch(kind: messages.Obstacle, seed: int) -> None:
    one = moving(kind, seed)
    times = [-1.0, *one.motion.times.tolist(), one.motion.end + 1.0]
    boxes, (centre, radius) = boxes_of(one), moving_ball(one)
    assert boxes.shape == (len(times) - 1, 6)
    points = one.cloud.points if one.cloud is not None else one.vertices
    local = np.array([one.placement.actInv(point) for point in np.asarray(points, float)])
    for box, begin, end in zip(boxes, times[:-1], times[1:], strict=True):
        for time in np.linspace(begin, end, 60):
            there = one.placement_at(float(time))
            placed = local @ there.rotation.T + there.translation
            middle = one.motion.at(float(time)).act(centre)
            assert (np.linalg.norm(placed - middle, axis=1) + one.rounding <= radius + 1e-9).all()
            assert (placed - one.rounding >= box[:3] - 1e-12).all()
            assert (placed + one.rounding <= box[3:] + 1e-12).all()


def test_what_is_endless_is_everywhere() -> None:
    floor = next(one for one in KINDS if isinstance(one, messages.HalfSpace))
    one = build(messages.Scene("s", obstacles=[floor])).obstacles[0]
    assert moving_ball(one) is None
    assert (boxes_of(one) == EVERYWHERE).all()


@pytest.mark.parametrize("seed", range(4))
def test_gaps_are_those_of_places_in_the_ball_and_the_boxes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low = rng.normal(size=(20, 3))
    boxes, centre, radius = np.hstack([low, low + rng.uniform(size=(20, 3))]), rng.normal(size=3), rng.uniform(0.1, 1.0)
    least, most = gaps_from_boxes(boxes, centre, radius)
    away = rng.normal(size=(400, 3))
    places = centre + radius * away / np.linalg.norm(away, axis=1)[:, None]
    for box, at_least, at_most in zip(boxes, least, most, strict=True):
        within = rng.uniform(box[:3], box[3:], (400, 3))
        apart = np.linalg.norm(places[:, None] - within[None], axis=2)
        assert at_least <= apart.min() + 1e-12
        assert apart.max() <= at_most + 1e-12
