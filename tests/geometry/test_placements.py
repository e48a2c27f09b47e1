"""Placements by the row are those of Pinocchio."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.placements import frames, se3


def test_rows_of_placements_are_pinocchios() -> None:
    rng = np.random.default_rng(0)
    positions, quaternions = rng.normal(size=(20, 3)), rng.normal(size=(20, 4))
    rows = frames(positions, quaternions).reshape(-1, 3, 4)
    for row, position, quaternion in zip(rows, positions, quaternions, strict=True):
        placed = se3(position.tolist(), quaternion.tolist())
        assert np.allclose(row[:, :3], placed.rotation, atol=1e-14)
        assert np.array_equal(row[:, 3], placed.translation)
