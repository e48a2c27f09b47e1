from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.elements import Pieces, bisected, blocks, gathered, united
from tests.geometry import solids


def pieces(mesh: solids.Mesh) -> Pieces:
    return Pieces(mesh[0][mesh[1]], np.arange(len(mesh[1])))


@pytest.mark.parametrize("size", [1.0, 0.07, 0.01])
def test_halves_are_small_and_make_up_the_whole(size: float) -> None:
    whole = pieces(solids.lying(solids.box((0.3, 0.2, 0.1))))
    halves = bisected(whole, size)
    edges = np.linalg.norm(np.roll(halves.corners, -1, axis=1) - halves.corners, axis=2)
    assert edges.max() <= size
    for source in range(len(whole.sources)):
        own = halves.some(halves.sources == source)
        assert own.area == pytest.approx(whole.some(np.array([source])).area)
        across = np.cross(own.corners[:, 1] - own.corners[:, 0], own.corners[:, 2] - own.corners[:, 0])
        a, b, c = whole.corners[source]
        assert (across @ np.cross(b - a, c - a) > 0.0).all()


def test_elements_hold_all_pieces_in_balls_about_them() -> None:
    whole = bisected(pieces(solids.lying(solids.torus())), 0.005)
    elements = gathered(whole, 0.01)
    assert len(elements.bounds) < len(whole.sources)
    assert sorted(map(tuple, elements.pieces.corners.reshape(-1, 9))) == sorted(
        map(tuple, whole.corners.reshape(-1, 9))
    )
    assert elements.first[0] == 0
    assert elements.first[-1] == len(whole.sources)
    assert (np.diff(elements.first) > 0).all()
    for k, (x, y, z, radius) in enumerate(elements.bounds):
        own = elements.points[elements.first_point[k] : elements.first_point[k + 1]]
        assert (np.linalg.norm(own - [x, y, z], axis=1) <= radius).all()
    assert elements.bounds[:, 3].max() <= 0.5 * np.sqrt(3.0) * (0.01 + 2 * 0.005)


def test_blocks_contain_sixty_four_each() -> None:
    elements = gathered(bisected(pieces(solids.torus()), 0.004), 0.004)
    around = blocks(elements)
    assert len(around) == -(-len(elements.bounds) // 64)
    for k, (x, y, z, radius) in enumerate(around):
        own = elements.points[
            elements.first_point[64 * k] : elements.first_point[min(64 * (k + 1), len(elements.bounds))]
        ]
        assert (np.linalg.norm(own - [x, y, z], axis=1) <= radius).all()
    # neighbours stand together: a block is far smaller than the ring
    assert np.median(around[:, 3]) < 0.04


def test_parts_make_up_the_whole_again() -> None:
    elements = gathered(bisected(pieces(solids.torus()), 0.01), 0.01)
    mask = np.random.default_rng(0).random(len(elements.bounds)) < 0.3
    again = united([elements.some(mask), elements.some(~mask)])
    assert again.first[-1] == elements.first[-1]
    assert sorted(map(tuple, again.bounds)) == sorted(map(tuple, elements.bounds))
    assert sorted(again.pieces.sources) == sorted(elements.pieces.sources)
    k = int(mask.sum())  # the first of the second part
    first = int(np.flatnonzero(~mask)[0])
    own = again.points[again.first_point[k] : again.first_point[k + 1]]
    assert (own == elements.points[elements.first_point[first] : elements.first_point[first + 1]]).all()


def test_points_of_an_element_are_the_corners_of_its_pieces_once() -> None:
    elements = gathered(bisected(pieces(solids.lying(solids.torus())), 0.005), 0.01)
    for k in range(len(elements.bounds)):
        own = elements.points[elements.first_point[k] : elements.first_point[k + 1]].tolist()
        corners = elements.pieces.corners[elements.first[k] : elements.first[k + 1]].reshape(-1, 3).tolist()
        assert set(map(tuple, own)) == set(map(tuple, corners))
        assert len(own) <= len(corners)
    assert len(elements.points) < 2 * len(elements.pieces.sources), "of 3 corners each"
