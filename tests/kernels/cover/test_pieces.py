"""Pieces and elements by NumPy, step by step: the kernels' are the same to the last bit."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.curve_order import curve_order
from guidefield.geometry.elements import Pieces, bisect_pieces, gather_elements, join_pieces
from tests.geometry import solids

MESHES = {
    "torus": solids.lying(solids.torus()),
    "channel": solids.channel(),
    "flat": (np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]])),
    "needle": (np.array([[0.0, 0, 0], [3, 1e-9, 0], [1.5, 0, 0]]), np.array([[0, 1, 2]])),
}


def plainly_bisected(pieces: Pieces, size: float) -> Pieces:
    corners, sources = pieces
    done = []
    while len(corners):
        lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        large = lengths.max(axis=1) > size
        done.append(Pieces(corners[~large], sources[~large]))
        corners, sources, longest = corners[large], sources[large], lengths[large].argmax(axis=1)
        row = np.arange(len(corners))
        a, b, c = (corners[row, (longest + turn) % 3] for turn in range(3))
        middle = 0.5 * (a + b)
        corners = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        sources = np.tile(sources, 2)
    return join_pieces(done)


def pieces(name: str) -> Pieces:
    vertices, triangles = MESHES[name]
    return Pieces(vertices[triangles], np.arange(len(triangles)))


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("size", [5.0, 0.03, 0.007])
def test_pieces_are_halved_as_numpy_halves_them(name: str, size: float) -> None:
    whole = pieces(name) if name != "flat" else Pieces(0.1 * pieces(name).corners, pieces(name).sources)
    found, expected = bisect_pieces(whole, size), plainly_bisected(whole, size)
    assert (found.corners == expected.corners).all()
    assert (found.sources == expected.sources).all()


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("size", [10.0, 0.02, 0.004])
def test_elements_are_gathered_as_numpy_gathers_them(name: str, size: float) -> None:
    small = bisect_pieces(pieces(name), max(size, 0.02 if name in ("flat", "needle") else 0.0))
    found = gather_elements(small, size)
    centroids = small.corners.mean(axis=1)
    cells = np.floor((centroids - centroids.min(axis=0)) / size).astype(np.int64)
    _, owner = np.unique(cells, axis=0, return_inverse=True)
    owner = owner.reshape(-1)
    members = [np.flatnonzero(owner == k) for k in range(owner.max() + 1)]
    boxes = [(small.corners[own].min(axis=(0, 1)), small.corners[own].max(axis=(0, 1))) for own in members]
    turn = curve_order(np.array([0.5 * (low + high) for low, high in boxes]))
    assert (found.pieces.corners == np.concatenate([small.corners[members[k]] for k in turn])).all()
    assert (found.pieces.sources == np.concatenate([small.sources[members[k]] for k in turn])).all()
    assert (np.diff(found.first) == [len(members[k]) for k in turn]).all()
    for k, bound in zip(turn, found.bounds, strict=True):
        low, high = boxes[k]
        assert (bound[:3] == 0.5 * (low + high)).all()
        reach = np.linalg.norm(small.corners[members[k]].reshape(-1, 3) - bound[:3], axis=1).max()
        assert bound[3] == reach * (1.0 + 1e-12)
