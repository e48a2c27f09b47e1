"""Anchors: how a solid winds around them is known, and so on which side of what is seen of it any place is."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.curve_order import along_curve
from guidefield.geometry.surface_rows import box_nodes
from guidefield.kernels.cover.crop_to_ball import distance_to_triangles
from guidefield.kernels.distance.ray_winding import BALL, PLACE, REACH, ROOM, TURNS, surely_outside_seen
from guidefield.kernels.distance.triangle_distance import Span, SurfaceTables
from guidefield.kernels.jit.arrays import Rows
from guidefield.kernels.jit.decorators import kernel
from guidefield.read_only import read_only
from guidefield.scene.cropped_surface import anchor_of
from tests.geometry import solids
from tests.kernels.distance.test_closed_meshes import voxels


@kernel
def outside_seen(x: float, y: float, z: float, surfaces: SurfaceTables, span: Span, anchors: Rows, row: int) -> bool:
    """The machine code that only kernels call."""
    return surely_outside_seen(x, y, z, surfaces, span, anchors, row)


SOLIDS = {
    "ring": solids.torus(),
    "fine ring": solids.lying(solids.torus(around=60, across=16), 1),
    "channel": solids.lying(solids.channel(), 5),
    "hollow": solids.hollow(),
    "overlapping": solids.overlapping(),
    "twice": solids.together(solids.torus(), solids.torus(0.1, 0.028)),
    "inside out": solids.turned(solids.torus()),
    "cells": voxels(3)[1],
}


def ball_about(mesh: solids.Mesh, seed: int) -> tuple[np.ndarray, float]:
    """A ball that the surface goes through."""
    rng = np.random.default_rng(seed)
    centre = solids.in_box_of(mesh, 1, rng)[0] + 0.01 * rng.normal(size=3)
    return centre, float(rng.uniform(1.05, 1.6) * solids.distance(centre[None], mesh)[0] + 0.01)


def seen_in(mesh: solids.Mesh, centre: np.ndarray, radius: float) -> SurfaceTables:
    """The triangles that a ball meets, and a few others, as kernels read them."""
    near = [solids.distance(centre[None], (mesh[0], one[None]))[0] <= radius for one in mesh[1]]
    near = np.array(near) | (np.random.default_rng(0).random(len(near)) < 0.05)
    a, b, c = np.moveaxis(mesh[0][mesh[1][near]], 1, 0)
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    order = along_curve(0.5 * (low + high)).order
    corners = np.ascontiguousarray(np.hstack([a, b - a, c - a])[order])
    tables = SurfaceTables(box_nodes(np.hstack([low, high])[order]), corners, np.zeros((len(corners), 21)))
    read_only(*tables)
    return tables


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("mesh", SOLIDS.values(), ids=SOLIDS)
def test_sides_within_the_ball_are_those_that_all_of_the_surface_tells(mesh: solids.Mesh, seed: int) -> None:
    centre, radius = ball_about(mesh, seed)
    anchor = anchor_of(*mesh, centre, radius)
    assert anchor[ROOM] > 0.0
    tables, rng = seen_in(mesh, centre, radius), np.random.default_rng(seed)
    span = 0, (len(tables.nodes) + 1) // 2, 0, len(tables.corners)
    away = rng.normal(size=(150, 3))
    away *= (radius * rng.random(150) ** (1 / 3) / np.linalg.norm(away, axis=1))[:, None]
    points = np.concatenate([centre + away, centre + 0.99 * radius * np.eye(3), anchor[None, PLACE:ROOM]])
    points = points[solids.distance(points, mesh) > 1e-9]
    outside = np.rint(solids.winding(points, mesh)) == 0.0
    told = [outside_seen(*point, tables, span, anchor[None], 0) for point in points.tolist()]
    np.testing.assert_array_equal(told, outside)


def test_beyond_the_ball_and_without_room_nothing_is_certain() -> None:
    mesh, centre = solids.torus(), np.zeros(3)
    tables = seen_in(mesh, centre, 1.0)
    span, anchor = (0, (len(tables.nodes) + 1) // 2, 0, len(tables.corners)), anchor_of(*mesh, centre, 0.5)
    for place, wanted in (((0.0, 0.01, 0.3), True), ((0.0, 0.01, 0.6), False), ((0.1, 0.0, 0.0), False)):
        assert outside_seen(*place, tables, span, anchor[None], 0) == wanted
    anchor[ROOM] = 0.0
    assert not outside_seen(0.0, 0.01, 0.3, tables, span, anchor[None], 0)


@pytest.mark.parametrize("mesh", SOLIDS.values(), ids=SOLIDS)
def test_what_is_about_it_is_free_and_in_the_ball(mesh: solids.Mesh) -> None:
    for seed in range(2):
        centre, radius = ball_about(mesh, seed)
        anchor = anchor_of(*mesh, centre, radius)
        np.testing.assert_array_equal(anchor[[*range(BALL, REACH), REACH]], [*centre, radius])
        place = anchor[None, PLACE:ROOM]
        assert 0.0 < anchor[ROOM] <= 0.5 * solids.distance(place, mesh)[0] * (1.0 + 1e-12)
        assert np.linalg.norm(place - centre) + anchor[ROOM] <= radius
        assert anchor[TURNS] == np.rint(solids.winding(place, mesh)[0])


def test_a_ball_about_a_place_on_the_surface_has_it_elsewhere() -> None:
    mesh = solids.torus()
    anchor = anchor_of(*mesh, mesh[0][5], 0.05)
    assert np.linalg.norm(anchor[PLACE:ROOM] - mesh[0][5]) > 0.02
    assert anchor[ROOM] > 0.004


def test_where_windings_are_no_whole_numbers_there_is_no_room() -> None:
    assert anchor_of(*solids.bowl(), np.array([0.0, 0.0, -0.04]), 0.2)[ROOM] == 0.0


@pytest.mark.parametrize("mesh", SOLIDS.values(), ids=SOLIDS)
def test_the_distance_to_all_triangles_is_the_least_of_each(mesh: solids.Mesh) -> None:
    points = solids.in_box_of(mesh, 60, np.random.default_rng(3))
    arrays = np.ascontiguousarray(mesh[0]), np.ascontiguousarray(mesh[1], np.int64)
    found = [distance_to_triangles(*point, *arrays) for point in points.tolist()]
    np.testing.assert_allclose(found, solids.distance(points, mesh), rtol=1e-9, atol=1e-12)
    assert distance_to_triangles(0.0, 0.0, 0.0, arrays[0], np.empty((0, 3), np.int64)) == np.inf
