"""The order along a Morton curve, against codes bit by bit."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.geometry.curve_order import FINEST, along_curve, change_along, curve_order


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


@pytest.mark.parametrize("seed", range(20))
def test_the_order_after_a_change_is_the_one_that_is_found_anew(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    points = np.concatenate([corners, rng.integers(0, 6, (int(rng.integers(0, 60)), 3)) / 5.0])  # many in one place
    left = np.append([True, True], rng.random(len(points) - 2) < 0.8)
    among = np.append([False, False], rng.random(int(left.sum()) - 2 + int(rng.integers(0, 5))) < 0.2)
    among[int(left.sum()) :] = True
    stayed = np.flatnonzero(left)[~among[: left.sum()]]
    now = np.full(len(points), -1)
    now[stayed] = np.flatnonzero(~among)
    after = rng.integers(0, 6, (len(among), 3)) / 5.0
    after[~among] = points[stayed]
    fresh = np.flatnonzero(among).tolist()
    known, expected = along_curve(points, 16), along_curve(after, 16)
    found = change_along(known, now, fresh, after[fresh], len(after))
    assert found.along.order.tolist() == expected.order.tolist()
    assert found.along.places.tolist() == expected.places.tolist()
    assert found.along.is_of(np.hstack([after - 0.5, after + 0.5]))
    assert not found.along.is_of(np.hstack([after, after + 0.5]))
    others, numbers = iter(found.fresh.tolist()), list[int]()
    for begin, count in found.runs:
        stood = known.order[begin : begin + count]
        numbers += now[stood].tolist() if begin >= 0 else [fresh[next(others)] for _ in range(count)]
    assert numbers == expected.order.tolist()
