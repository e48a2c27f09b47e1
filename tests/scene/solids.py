"""Meshes written by hand, to build obstacles from."""

import numpy as np

from guidefield.messages.scene import Mesh


def box_mesh(size: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A cube about the origin: vertices and outward triangles."""
    vertices = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * (0.5 * size)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return vertices, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def prism(outline: np.ndarray, height: float, caps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A closed prism over a counter-clockwise outline (k, 2), whose triangles are given: from z = 0 to the height."""
    count = len(outline)
    vertices = np.vstack([np.column_stack([outline, np.full(count, z)]) for z in (0.0, height)])
    here, after = np.arange(count), np.roll(np.arange(count), -1)
    sides = [np.column_stack([here, after, after + count]), np.column_stack([here, after + count, here + count])]
    return vertices, np.vstack([caps[:, ::-1], caps + count, *sides])


def l_prism() -> tuple[np.ndarray, np.ndarray]:
    """An L of two unit squares and a corner, 1 high: closed, not convex, volume 3."""
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], float)
    return prism(outline, 1.0, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 5], [3, 4, 5]]))


def room(outer: float, inner: float) -> tuple[np.ndarray, np.ndarray]:
    """A cube with a cubic hollow, both about the origin: closed, in two pieces."""
    vertices, triangles = box_mesh(outer)
    hollow, _ = box_mesh(inner)
    return np.vstack([vertices, hollow]), np.vstack([triangles, triangles[:, ::-1] + len(vertices)])


def moebius(count: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """A band with one side and one edge."""
    angles = 2 * np.pi * np.arange(count) / count
    across = np.stack([np.cos(angles / 2) * np.cos(angles), np.cos(angles / 2) * np.sin(angles), np.sin(angles / 2)], 1)
    ring = np.stack([np.cos(angles), np.sin(angles), 0 * angles], 1)
    vertices = np.vstack([ring - 0.3 * across, ring + 0.3 * across])
    triangles = []
    for i in range(count):
        a, b, c, d = i, i + count, i + 1 + count, i + 1
        if i == count - 1:
            c, d = 0, count
        triangles += [[a, d, c], [a, c, b]]
    return vertices, np.array(triangles)


def klein_bottle(n: int = 8) -> tuple[np.ndarray, np.ndarray]:
    """Every edge in two triangles and yet no inside: a torus's grid, glued with a flip; the places are arbitrary."""
    vertices = np.random.default_rng(0).normal(size=(n * n, 3))
    triangles = []
    for i in range(n):
        for j in range(n):

            def at(a: int, b: int) -> int:
                return (a % n) * n + (b % n if a < n else (-b) % n)

            triangles += [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
    return vertices, np.array(triangles)


def mesh_message(vertices: np.ndarray, triangles: np.ndarray, name: str = "m", **fields: object) -> Mesh:
    """A mesh obstacle."""
    rows = [tuple(map(float, row)) for row in vertices]
    return Mesh(name=name, vertices=rows, triangles=[tuple(map(int, row)) for row in triangles], **fields)
