from __future__ import annotations

import numpy as np

from guidefield.geometry.elements import Pieces, bisect_pieces, blocks, gather_elements, unite_elements
from tests.geometry import solids


def pieces(mesh: solids.Mesh) -> Pieces:
    return Pieces(mesh[0][mesh[1]], np.arange(len(mesh[1])))


def test_blocks_contain_sixty_four_each() -> None:
    elements = gather_elements(bisect_pieces(pieces(solids.torus()), 0.004), 0.004)
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
    elements = gather_elements(bisect_pieces(pieces(solids.torus()), 0.01), 0.01)
    mask = np.random.default_rng(0).random(len(elements.bounds)) < 0.3
    again = unite_elements([elements.some(mask), elements.some(~mask)])
    assert again.first[-1] == elements.first[-1]
    assert sorted(map(tuple, again.bounds)) == sorted(map(tuple, elements.bounds))
    assert sorted(again.pieces.sources) == sorted(elements.pieces.sources)
    k = int(mask.sum())  # the first of the second part
    first = int(np.flatnonzero(~mask)[0])
    own = again.points[again.first_point[k] : again.first_point[k + 1]]
    assert (own == elements.points[elements.first_point[first] : elements.first_point[first + 1]]).all()
