"""Triangles clipped at planes keep their area and stay on their side."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.geometry.decomposition import clip_at
from guidefield.geometry.elements import Pieces


@settings(deadline=None, max_examples=12)
@given(st.integers(0, 10**6))
def test_both_sides_make_the_whole(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pieces = Pieces(rng.normal(size=(30, 3, 3)), np.arange(30))
    normal = rng.normal(size=3)
    plane = np.append(normal / np.linalg.norm(normal), rng.normal(scale=0.5))
    below, above = clip_at(pieces, plane), clip_at(pieces, -plane)
    assert below.area + above.area == pytest.approx(pieces.area)
    assert (below.corners @ plane[:3] <= plane[3] + 1e-12).all()
    assert (above.corners @ plane[:3] >= plane[3] - 1e-12).all()
    for part in (below, above):
        for corners, source in zip(part.corners, part.sources, strict=True):
            a, b, c = pieces.corners[source]
            shares = np.linalg.lstsq(np.column_stack([a, b, c]), corners.T, rcond=None)[0]
            assert np.column_stack([a, b, c]) @ shares == pytest.approx(corners.T)
            assert shares.min() >= -1e-9
            assert shares.sum(axis=0) == pytest.approx(1.0)
