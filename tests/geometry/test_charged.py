from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from guidefield.geometry import surfaces
from guidefield.geometry.charged import at_angle, convex_quads, field_tables
from guidefield.kernels.field.box import BOX_COLUMNS, FAR
from guidefield.kernels.field.faces import ORDINARY
from guidefield.kernels.field.field_tables import CHARGE_PER_AREA, NODE_COLUMNS, QUAD_COLUMNS, TRIANGLE_COLUMNS
from tests.kernels.evaluation import triangles
from tests.oracles import EPS


@settings(deadline=None, max_examples=15)
@given(triangles)
def test_rows_describe_the_triangle(corners: np.ndarray) -> None:
    tables = field_tables(corners[None])
    a, b, c = tables.vertices[tables.triangle_corners[0]]
    row = tables.triangles[0]
    point, normal, half = row[:3], row[3:6], row[6:]
    t, length, tau, e, twice_area = half[6:9], half[9], half[10], half[11:14], 0.5 * half[0]
    order = [int(np.flatnonzero((corners == corner).all(axis=1))[0]) for corner in (a, b, c)]
    assert order in ([0, 1, 2], [1, 2, 0], [2, 0, 1])
    assert length == pytest.approx(max(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)))
    assert a + length * t == pytest.approx(b)
    assert a + tau * t + e == pytest.approx(c)
    assert e @ t == pytest.approx(0.0, abs=1e-15)
    assert normal * twice_area == pytest.approx(np.cross(b - a, c - a))
    assert (point == a).all()
    assert half[1:3] == pytest.approx([half[0] ** 2, half[0] / np.tan(np.pi / 16)])
    assert half[3:6] == pytest.approx([np.sum((b - c) ** 2), np.sum((c - a) ** 2), np.sum((a - b) ** 2)])
    assert tables.nodes[0, CHARGE_PER_AREA] == 1.0
    # The only face of its block is counted as what it is.
    ordinary = twice_area >= ORDINARY * length**2
    assert tables.links[0, 3:6].tolist() == [0, int(ordinary), 1]


@pytest.mark.skipif(np.finfo(np.longdouble).eps == EPS, reason="this machine has no extended precision")
@pytest.mark.parametrize("width", [1e-4, 1e-8, 1e-10])
def test_area_of_an_oblique_sliver_is_exact(width: float) -> None:
    turn = np.linalg.qr(np.array([[1.0, 2.0, 0.5], [0.3, -1.0, 2.0], [2.0, 0.1, 1.0]]))[0]
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.4, width, 0.0]]) @ turn.T
    a, b, c = ([Fraction(float(x)) for x in corner] for corner in corners)
    u, v = ([end[i] - a[i] for i in range(3)] for end in (b, c))
    cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    # A square root of a fraction, to more digits than a float has.
    exact = float(sum(x * x for x in cross) * Fraction(10) ** 60) ** 0.5 / 1e30
    assert field_tables(corners[None]).triangles[0, 6] == pytest.approx(2.0 * exact, rel=8 * EPS)


def test_corners_are_shared_within_a_block() -> None:
    ball = surfaces.sphere(1.0, subdivisions=1)
    tables = field_tables(ball.corners[:40])
    assert len(tables.links) == 1
    assert len(tables.vertices) == len(np.unique(ball.corners[:40].reshape(-1, 3), axis=0))
    there = tables.vertices[tables.triangle_corners]
    assert {frozenset(map(tuple, corners)) for corners in there} == {
        frozenset(map(tuple, corners)) for corners in ball.corners[:40]
    }


def test_a_surface_of_many_faces_becomes_a_tree_and_few_faces_do_not() -> None:
    large, small = surfaces.sphere(1.0, subdivisions=3), surfaces.box((1.0, 1.0, 1.0))
    corners = np.concatenate([large.corners, small.corners])
    owners = np.repeat([0, 1], [len(large.triangles), len(small.triangles)])
    tables = field_tables(corners, triangle_owner=owners, opening=at_angle(0.2))
    leaves = tables.links[:, 2] > tables.links[:, 1]
    assert tables.links[leaves, 3].tolist() == [0, *tables.links[leaves, 5][:-1].tolist()]
    assert tables.links[leaves, 5][-1] == len(corners)
    # The root stands for all of the large one and leads to the small one, which is only a block.
    assert np.isfinite(tables.reach[:-1]).all()
    assert tables.links[0, 0] == len(tables.links) - 1
    assert tables.reach[-1] == np.inf
    assert tables.nodes[0, 3] == pytest.approx(4.0 * np.pi, rel=0.05)
    assert np.isinf(field_tables(corners, triangle_owner=owners).reach).all()


def test_faces_without_area_are_left_out() -> None:
    whole = surfaces.box((1.0, 2.0, 3.0)).corners
    slit = np.array([[[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0]], [[1.0, 0.0, 0.0]] * 3])
    charge = np.arange(1.0, 13.0)
    mixed = field_tables(np.concatenate([slit, whole]), np.concatenate([[9.0, 9.0], charge]))
    for ours, theirs in zip(mixed, field_tables(whole, charge), strict=True):
        assert (ours == theirs).all()
    half_flat = [[[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]]]
    tables = field_tables(quads=half_flat)
    assert (len(tables.quads), len(tables.triangles)) == (0, 1)


def test_box_axes_run_from_the_longest_side_to_the_shortest() -> None:
    row = [1, 2, 3, *np.eye(3).ravel(), 0.2, 0.6, 0.4, 1.5]
    box = field_tables(boxes=[row]).boxes[0]
    assert box[:16].tolist() == [1, 2, 3, 0, 1, 0, 0, 0, 1, 1, 0, 0, 0.3, 0.2, 0.1, 1.5]
    assert box[16] == pytest.approx(FAR**2 * 0.14)


@pytest.mark.parametrize("count", [3, 4, 5, 8, 24, 25])
def test_convex_polygons_in_quads(count: int) -> None:
    angles = 2.0 * np.pi * np.arange(count) / count
    polygon = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(count)])
    quads, rest = convex_quads(polygon)
    assert len(quads) == (count - 2) // 2
    assert len(rest) == count % 2
    corners = np.concatenate([rest, quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    areas = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]
    assert (areas > 0.0).all()
    assert areas.sum() == pytest.approx(0.5 * count * np.sin(2.0 * np.pi / count))


def test_tables_are_frozen_and_contiguous() -> None:
    tables = field_tables(
        surfaces.box((1.0, 1.0, 1.0)).corners, None, [[0, 0, 0, 1, 2]], [[0, 0, 0, 1, 0, 0, 0.1, 1]], [[0, 0, 1, 0, 1]]
    )
    for table in tables:
        assert table.flags.c_contiguous
        assert not table.flags.writeable
    matrices = (tables.boxes, tables.triangles, tables.quads, tables.nodes)
    assert [table.shape[1] for table in matrices] == [BOX_COLUMNS, TRIANGLE_COLUMNS, QUAD_COLUMNS, NODE_COLUMNS]
    assert tables.spheres[0].tolist() == [0, 0, 0, 1, 2]


TRIANGLE = [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        ({"triangles": np.zeros((2, 3))}, "`triangles` must have shape"),
        ({"triangles": np.full((1, 3, 3), np.nan)}, "`triangles` must be finite"),
        ({"triangles": TRIANGLE, "triangle_charge": [1.0, 2.0]}, "as many"),
        ({"spheres": [[0, 0, 0, 0, 1]]}, "positive radii"),
        ({"capsules": [[0, 0, 0, 1, 0, 0, -0.1, 1]]}, "positive radii"),
        ({"planes": [[0, 0, 2, 0, 1]]}, "unit normals"),
        ({"planes": [[0, 0, 1, 0]]}, "`planes` must have shape"),
        ({"boxes": [[0, 0, 0, *np.eye(3).ravel(), 1, 0, 1, 1]]}, "positive sizes"),
        ({"boxes": [[0, 0, 0, *(2 * np.eye(3)).ravel(), 1, 1, 1, 1]]}, "unit normals"),
        ({"cloud": [[0, 0, 0, 1, 0]]}, "positive radii"),
    ],
)
def test_what_cannot_be_charged_is_refused(arguments: dict[str, Any], fault: str) -> None:
    with pytest.raises(ValueError, match=fault):
        field_tables(**arguments)
