from __future__ import annotations

import math

import numpy as np
import pytest

from guidefield.messages import scene as messages
from guidefield.scene.field_slice import SlicePlane, horizontal, potential_slice, shaded
from guidefield.scene.scene import build

BALL = build(messages.Scene(name="s", obstacles=[messages.Sphere(name="ball", radius=0.5, position=(0.3, 0.0, 0.0))]))


def test_pixels_hold_the_potential_where_they_are() -> None:
    image = potential_slice(BALL.tables, horizontal((0.0, 0.0, 0.2), 4.0), 40)
    assert image.shape == (40, 40)
    for row, column in ((0, 0), (3, 30), (39, 5)):
        x, y = -2.0 + 4.0 * (column + 0.5) / 40, 2.0 - 4.0 * (row + 0.5) / 40
        r = math.dist((x, y, 0.2), (0.3, 0.0, 0.0))
        assert image[row, column] == pytest.approx(math.log10(4 * math.pi * 0.25 / (r * (r * r - 0.25))), rel=1e-9)


def test_the_inside_of_solids_is_marked() -> None:
    image = potential_slice(BALL.tables, horizontal((0.3, 0.0, 0.0), 2.0), 32)
    centres = (np.arange(32) + 0.5) / 16 - 1.0
    inside = centres[None] ** 2 + centres[:, None] ** 2 < 0.25
    assert (np.isnan(image) == inside).all()
    assert (shaded(image)[inside] == 255).all()
    assert shaded(image).min() == 0


def test_the_longer_side_has_the_resolution() -> None:
    plane = SlicePlane(np.zeros(3), np.array([2.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.5]))
    assert potential_slice(BALL.tables, plane, 16).shape == (4, 16)


def test_an_empty_scene_is_dark() -> None:
    image = potential_slice(build(messages.Scene(name="s")).tables, horizontal((0, 0, 0), 1.0), 4)
    assert np.isneginf(image).all()
    assert not shaded(image).any()


def test_a_picture_needs_pixels() -> None:
    with pytest.raises(ValueError, match="resolution"):
        potential_slice(BALL.tables, horizontal((0, 0, 0), 1.0), 0)
