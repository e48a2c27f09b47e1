"""Convex parts contain bodies, by subtracting them from every triangle, and stand off as far as said."""

import functools

import numpy as np
import pytest

from guidefield.geometry.decomposition import Decomposition, decompose
from guidefield.geometry.solid import solid
from tests.geometry import solids

TIGHT = 0.005

BODIES = {
    "ring": solids.lying(solids.torus(around=16, across=8)),
    "channel": solids.lying(solids.channel()),
    "hollow": solids.hollow(),
    "overlapping": solids.lying(solids.overlapping()),
    "bowl": solids.lying(solids.bowl()),
    "cracked": solids.cracked(),
    "box": solids.lying(solids.box((0.05, 0.08, 0.12))),
}

bodies = pytest.mark.parametrize("name", BODIES)


@functools.cache
def decomposed(name: str) -> tuple[solids.Mesh, Decomposition]:
    mesh = BODIES[name]
    return mesh, decompose(solid(*mesh, widest_gap=0.02), TIGHT, 12)


def facets(corners: np.ndarray) -> np.ndarray:
    """Planes (t, 4) of a hull's triangles, its inside below."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    wide = np.linalg.norm(normals, axis=1) > 1e-14
    normals = normals[wide] / np.linalg.norm(normals[wide], axis=1)[:, None]
    return np.column_stack([normals, np.einsum("ij,ij->i", normals, corners[wide, 0])])


def left_of(polygon: list[np.ndarray], planes: np.ndarray) -> list[list[np.ndarray]]:
    """What is left of a convex polygon outside of a convex body, as convex polygons."""
    left = []
    for plane in planes:
        below, above = [], []
        for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True):
            ha, hb = a @ plane[:3] - plane[3], b @ plane[:3] - plane[3]
            (below if ha <= 0.0 else above).append(a)
            if (ha <= 0.0) != (hb <= 0.0):
                cut = a + ha / (ha - hb) * (b - a)
                below.append(cut)
                above.append(cut)
        if above and max(p @ plane[:3] - plane[3] for p in above) > 1e-8:
            left.append(above)
        if not below:
            break
        polygon = below
    return left


@bodies
def test_nothing_is_left_of_a_triangle_outside_the_parts(name: str) -> None:
    mesh, found = decomposed(name)
    hulls = [facets(part.hull.corners) for part in found.parts]
    for triangle in np.random.default_rng(0).permutation(len(mesh[1]))[:10].tolist():
        polygons = [list(mesh[0][mesh[1][triangle]])]
        for planes in hulls:
            polygons = [piece for polygon in polygons for piece in left_of(polygon, planes)]
        assert not polygons


@bodies
def test_the_inside_is_contained(name: str) -> None:
    mesh, found = decomposed(name)
    points = solids.in_box_of(mesh, 800, np.random.default_rng(1))
    inside = points[np.abs(solids.winding(points, mesh)) > 0.5]
    if name == "bowl":
        return
    heights = [
        (inside @ planes[:, :3].T - planes[:, 3]).max(axis=1)
        for planes in (facets(part.hull.corners) for part in found.parts)
    ]
    assert len(inside) > 50
    assert np.min(heights, axis=0).max() <= 1e-9


@bodies
def test_no_part_stands_off_by_more_than_said(name: str) -> None:
    mesh, found = decomposed(name)
    for part in (found.hull, *found.parts):
        points = solids.on_surface((part.hull.vertices, part.hull.triangles), 150, np.random.default_rng(2))
        beyond = np.where(np.abs(solids.winding(points, mesh)) > 0.5, 0.0, solids.distance(points, mesh))
        if name == "cracked":
            beyond = np.maximum(np.linalg.norm(points, axis=1) - 0.06, 0.0)
        assert beyond.max() <= part.stand_off + 1e-9
    assert found.stand_off == max(part.stand_off for part in found.parts)
