"""The order along a Morton curve, against codes bit by bit."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.curve_order import FINEST, curve_order


def code(cells: list[int], bits: int) -> int:
    """Bits of three numbers in turn, the first one's lowest."""
    return sum((cell >> bit & 1) << (3 * bit + axis) for bit in range(bits) for axis, cell in enumerate(cells))


@pytest.mark.parametrize("bits", [1, 4, 16, FINEST])
def test_the_order_is_that_of_interleaved_bits_and_of_the_same_ones_that_of_indices(bits: int) -> None:
    points = np.random.default_rng(0).uniform(-3.0, 5.0, (200, 3))
    points[50:60] = points[3]
    least, size = points.min(axis=0), np.ptp(points, axis=0).max()
    cells = ((points - least) / size * (2**bits - 1)).astype(int).tolist()
    codes = [code(one, bits) for one in cells]
    assert curve_order(points, bits).tolist() == sorted(range(200), key=lambda k: (codes[k], k))


def test_no_points_and_one_place_have_an_order() -> None:
    assert curve_order(np.empty((0, 3))).tolist() == []
    assert curve_order(np.ones((3, 3))).tolist() == [0, 1, 2]
