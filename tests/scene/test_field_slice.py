"""Pictures of the field: each pixel where it belongs, solids masked."""

import math

import numpy as np
import pytest

from guidefield.messages import scene as messages
from guidefield.scene.field_slice import SOLID_COLOR, field_slice
from guidefield.scene.scene import build
from tests.scene.slices import horizontal

BALL = build(messages.Scene(name="s", obstacles=[messages.Sphere(name="ball", radius=0.5, position=(0.3, 0.0, 0.0))]))


def test_pixels_hold_the_potential_where_they_are() -> None:
    picture = field_slice(BALL, horizontal((0.0, 0.0, 0.2), 4.0), 40)
    assert picture.image.shape == (40, 40, 3)
    assert picture.image.dtype == np.uint8
    for row, column in ((0, 0), (3, 30), (39, 5)):
        x, y = -2.0 + 4.0 * (column + 0.5) / 40, 2.0 - 4.0 * (row + 0.5) / 40
        r = math.dist((x, y, 0.2), (0.3, 0.0, 0.0))
        expected = math.log10(4 * math.pi * 0.25 / (r * (r * r - 0.25)))
        assert picture.log_potential[row, column] == pytest.approx(expected, rel=1e-6)


def test_solids_are_masked() -> None:
    picture = field_slice(BALL, horizontal((0.3, 0.0, 0.0), 2.0), 32)
    centres = (np.arange(32) + 0.5) / 16 - 1.0
    inside = centres[None] ** 2 + centres[:, None] ** 2 < 0.25
    assert (np.isnan(picture.log_potential) == inside).all()
    assert ((picture.image == SOLID_COLOR).all(axis=2) == inside).all()
