"""Pictures of the field: each pixel where it belongs, solids masked, contours where the potential is theirs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from guidefield.messages import scene as messages
from guidefield.scene.field_slice import CONTOURS, SOLID_COLOR, SlicePlane, field_slice
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


def test_brighter_is_nearer() -> None:
    picture = field_slice(BALL, horizontal((0.3, 0.0, 0.0), 6.0), 200)
    light = picture.image[100, 120:].astype(float) @ [0.299, 0.587, 0.114]
    # but for the lines, which are thin
    groups = np.median(light[: 8 * 9].reshape(8, 9), axis=1)
    assert (np.diff(groups) < 0.0).all()


def test_contours_are_where_a_wall_of_their_distance_has_the_potential() -> None:
    wall = build(messages.Scene(name="w", obstacles=[messages.HalfSpace(name="w", normal=(0, 1, 0))]))
    plane = SlicePlane(np.array([0.0, 0.3, 0.0]), np.array([0.02, 0.0, 0.0]), np.array([0.0, -0.3, 0.0]))
    column = field_slice(wall, plane, 600).image[:, 20].astype(float).mean(axis=1)
    y = 0.3 - 0.3 * (np.arange(600) + 0.5) / 600
    jumps = np.abs(column - 0.5 * (np.roll(column, 4) + np.roll(column, -4)))
    for distance in CONTOURS[1:5]:
        at = int(np.abs(y - distance).argmin())
        assert jumps[at - 1 : at + 2].max() > 20.0
    # and none half way between two neighbouring ones
    assert jumps[int(np.abs(y - 0.045).argmin())] < 10.0


@pytest.mark.parametrize("thin", [0.004, 0.3])
def test_fewer_evaluations_show_the_same_walls_however_thin(thin: float) -> None:
    box = messages.Box(name="b", size=(thin, 1.0, 1.0), position=(0.31, 0.1, 0.0))
    scene, plane = build(messages.Scene(name="s", obstacles=[box])), horizontal((0.0, 0.0, 0.0), 2.0)
    exact, quick = field_slice(scene, plane, 101), field_slice(scene, plane, 101, every=3)
    near = ~(exact.log_potential < math.log10(math.pi / (3 * 2.0 / 101) * 1.1))  # solids too
    assert near.any()
    np.testing.assert_allclose(quick.log_potential[near], exact.log_potential[near], rtol=1e-6)
    np.testing.assert_allclose(quick.log_potential[~near], exact.log_potential[~near], atol=0.05)
    assert np.abs(quick.image.astype(int) - exact.image).mean() < 2.0


def test_an_empty_scene_is_of_one_colour() -> None:
    picture = field_slice(build(messages.Scene(name="s")), horizontal((0, 0, 0), 1.0), 4)
    assert np.isneginf(picture.log_potential).all()
    assert (picture.image == picture.image[0, 0]).all()


def test_it_lies_where_its_plane_is() -> None:
    plane = SlicePlane(np.zeros(3), np.array([2.0, 0.0, 0.0]), np.array([0.0, 0.0, -0.5]))
    picture = field_slice(BALL, plane, 16)
    assert picture.image.shape == (4, 16, 3)
    assert picture.size == (2.0, 0.5)
    assert picture.pose.act(np.array([-1.0, 0.25, 0.0])) == pytest.approx(plane.corner)
    assert not picture.image.flags.writeable
