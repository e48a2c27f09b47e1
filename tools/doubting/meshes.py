"""Meshes at random, and whether a mesh is closed."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, cKDTree

Mesh = tuple[np.ndarray, np.ndarray]
"""Vertices (v, 3) [m] and triangles (t, 3), counter-clockwise from outside."""


def closed(rng: np.random.Generator, size: float) -> Mesh:
    """A closed mesh of about a radius [m]: a convex body, of which two in three are dented."""
    vertices, triangles = convex(rng, size)
    return dented(rng, vertices, triangles) if rng.random() < 2 / 3 else (vertices, triangles)


def convex(rng: np.random.Generator, size: float) -> Mesh:
    """The hull of points near an ellipsoid of about a radius [m]."""
    points = rng.normal(size=(int(rng.integers(6, 30)), 3))
    points *= size * rng.uniform(0.5, 1.5, 3) / np.linalg.norm(points, axis=1, keepdims=True)
    return outward(points, ConvexHull(points).simplices)


def outward(points: np.ndarray, simplices: np.ndarray) -> Mesh:
    """The triangles of a hull, turned counter-clockwise from outside, with the points that they have."""
    used = np.unique(simplices)
    index = np.full(len(points), -1)
    index[used] = np.arange(len(used))
    vertices, triangles = points[used], index[simplices]
    normals = np.cross(*(vertices[triangles[:, k]] - vertices[triangles[:, 0]] for k in (1, 2)))
    inward = (normals * (vertices[triangles].mean(axis=1) - vertices.mean(axis=0))).sum(axis=1) < 0.0
    triangles[inward] = triangles[inward][:, ::-1]
    return vertices, triangles


def dented(rng: np.random.Generator, vertices: np.ndarray, triangles: np.ndarray) -> Mesh:
    """Some triangles of a convex body get a corner in their middle that is pressed inwards."""
    middle, count = vertices.mean(axis=0), len(triangles)
    corners, faces = [*vertices], []
    for index, triangle in enumerate(triangles.tolist()):
        if index and rng.random() < 0.7 and index < count - 1:
            faces.append(triangle)
            continue
        centre = vertices[triangle].mean(axis=0)
        corners.append(centre + rng.uniform(0.1, 0.7) * (middle - centre))
        faces += [[triangle[k], triangle[(k + 1) % 3], len(corners) - 1] for k in range(3)]
    return np.array(corners), np.array(faces)


SQUARES = 72
"""Of a ground, along each side: more than ten thousand triangles are looked at for what a robot can meet."""


def ground(rng: np.random.Generator, side: float) -> Mesh:
    """Uneven ground of about a side [m], about the origin; every other one is the top of a slab, which is closed."""
    axis = np.linspace(-0.5, 0.5, SQUARES + 1)
    x, y = (side * one.ravel() for one in np.meshgrid(axis, axis, indexing="ij"))
    heights = 0.5 * side / SQUARES * rng.normal(size=len(x)) * rng.uniform(0.0, 1.0)
    top = np.column_stack([x, y, heights])
    at = np.arange(len(x)).reshape(SQUARES + 1, SQUARES + 1)
    a, b, c, d = (one.ravel() for one in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    upper = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    if rng.random() < 0.5:
        return top, upper
    count, thick = len(top), side * rng.uniform(0.05, 0.3)
    begin = np.concatenate([at[:-1, 0], at[-1, :-1], at[:0:-1, -1], at[0, :0:-1]])
    end = np.roll(begin, -1)
    walls = np.concatenate(
        [np.column_stack([end, begin, begin + count]), np.column_stack([end, begin + count, end + count])]
    )
    bottom = np.column_stack([x, y, np.full(count, -thick)])
    return np.concatenate([top, bottom]), np.concatenate([upper, upper[:, ::-1] + count, walls])


def triangles_of(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Corners of the triangles, shape (t, 3, 3)."""
    return vertices[triangles]


CRACK = 1e-3
"""Corners that are no farther apart are at one place [m]."""


def is_closed(vertices: np.ndarray, triangles: np.ndarray, crack: float = CRACK) -> bool:
    """Return whether each edge is run through as often in one sense as in the other, corners at one place being one."""
    places, corners = np.unique(vertices, axis=0, return_inverse=True)
    near = cKDTree(places).query_pairs(crack, output_type="ndarray")
    links = coo_array((np.ones(len(near), bool), (near[:, 0], near[:, 1])), shape=(len(places), len(places)))
    merged = connected_components(links, directed=False)[1][corners.reshape(-1)][triangles]
    starts, ends = merged.reshape(-1).astype(np.int64), np.roll(merged, -1, axis=1).reshape(-1).astype(np.int64)
    differ = starts != ends
    forth, back = np.sort((starts * len(places) + ends)[differ]), np.sort((ends * len(places) + starts)[differ])
    return bool(np.array_equal(forth, back))
