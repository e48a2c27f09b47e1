"""What is left beside planes, against triangles clipped one plane at a time, and points looked through by NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.decomposition import clip_at
from guidefield.geometry.directions import heights_along
from guidefield.geometry.elements import Pieces, bisect_pieces
from guidefield.kernels.cover.cut_halves import count_cut, cut_halves, furthest_out
from tests.geometry import solids

AXES = {"slanted": np.array([0.48, -0.6, 0.64]), "along z": np.array([0.0, 0.0, 1.0])}


@pytest.mark.parametrize("axis", AXES.values(), ids=AXES)
@pytest.mark.parametrize("mesh", [solids.torus(), solids.channel()], ids=["ring", "channel"])
def test_halves_are_what_clipping_leaves_and_its_furthest_points(mesh: solids.Mesh, axis: np.ndarray) -> None:
    vertices, triangles = mesh
    pieces = bisect_pieces(Pieces(vertices[triangles], np.arange(len(triangles))), 0.02)
    points = np.unique(pieces.corners.reshape(-1, 3), axis=0)
    along, corners = heights_along(points, axis), heights_along(pieces.corners, axis)
    low, high = float(along.min()), float(along.max())
    # beyond both ends, through corners, and between them
    places = np.array([low - 1.0, low, *along[:: max(1, len(along) // 5)], 0.3 * low + 0.7 * high, high, high + 1.0])
    cut, first = np.empty((count_cut(corners, places), 3)), np.empty(2 * len(places) + 1, np.int64)
    cut_halves(pieces.corners, corners, places, cut, first)
    assert first[-1] == len(cut)
    directions = np.random.default_rng(0).normal(size=(3, 20))
    origins, furthest = np.empty((2 * len(places), 3)), np.empty((2 * len(places), 20, 3))
    furthest_out(points, along, cut, first, places, directions, origins, furthest)
    least, most = corners.min(axis=1), corners.max(axis=1)
    for k, place in enumerate(places):
        across = pieces.some((least <= place) & (most >= place) & (least < most))
        for half, (normal, offset) in enumerate([(axis, place), (-axis, -place)]):
            expected = clip_at(across, np.append(normal, offset)).corners.reshape(-1, 3)
            assert (cut[first[2 * k + half] : first[2 * k + half + 1]] == expected).all()
            together = np.vstack([points[along < place if half == 0 else along > place], expected])
            if not len(together):
                assert np.isnan(origins[2 * k + half]).all()
                continue
            assert (origins[2 * k + half] == together[0]).all()
            heights = np.einsum("dj,dj->d", furthest[2 * k + half], directions.T)
            assert heights == pytest.approx((together @ directions).max(axis=0), abs=1e-12)
            assert {row.tobytes() for row in furthest[2 * k + half]} <= {row.tobytes() for row in together}
