from __future__ import annotations

import numpy as np
import pytest

from guidefield.kernels.cover.ball_cover import count_missing, held_points


@pytest.mark.parametrize("points", [1, 63, 64, 65, 300])
def test_points_are_held_by_distance_and_counted_where_they_are_missing(points: int) -> None:
    rng = np.random.default_rng(points)
    balls = np.column_stack([rng.normal(size=(40, 3)), rng.uniform(0.1, 2.0, 40)])
    cloud = rng.normal(size=(points, 3))
    bits = np.full((40, -(-points // 64)), ~np.uint64(0))
    held_points(balls, cloud, bits)
    held = np.linalg.norm(cloud - balls[:, None, :3], axis=2) <= balls[:, 3:]
    found = np.unpackbits(bits.view(np.uint8), axis=1, bitorder="little").astype(bool)
    assert (found[:, :points] == held).all()
    assert not found[:, points:].any()
    missing = rng.random(64 * bits.shape[1]) < 0.4
    counts = np.empty(40, np.int64)
    count_missing(bits, np.packbits(missing, bitorder="little").view(np.uint64), counts)
    assert (counts == (held & missing[:points]).sum(axis=1)).all()
