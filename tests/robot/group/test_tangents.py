"""Tangents along a motion, against the tangent map point by point and its differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.robot.group.tangents import SERIES_BELOW, tangent_accelerations, tangents
from tests.robot.model.test_chart import planned
from tests.robots import group

SIZES = st.sampled_from([0.0, 1e-9, 1e-3, 0.1, 0.14, 0.15, 1.0, 2.5])


@given(seed=st.integers(0, 2**32 - 1), size=SIZES)
@settings(deadline=None, max_examples=12)
def test_rows_are_what_the_tangent_map_makes_of_each(seed: int, size: float) -> None:
    flying, rng = planned(), np.random.default_rng(seed)
    zs, rates, accelerations = rng.normal(size=(3, 4, flying.nv))
    zs *= size
    maps = [flying.tangent_map(z) for z in zs]
    expected = [T @ dz for T, dz in zip(maps, rates, strict=True)]
    np.testing.assert_allclose(tangents(flying, zs, rates), expected, atol=1e-12)
    h = 1e-5
    for z, T, dz, ddz, found in zip(
        zs, maps, rates, accelerations, tangent_accelerations(flying, zs, rates, accelerations), strict=True
    ):
        turning = (flying.tangent_map(z + h * dz) - flying.tangent_map(z - h * dz)) / (2.0 * h)
        np.testing.assert_allclose(found, T @ ddz + turning @ dz, atol=1e-7)


def test_the_series_of_small_angles_goes_on_where_they_are_large() -> None:
    flying = planned()
    root = next(joint for joint in flying.joints if joint.name == "root_joint")
    zs = np.zeros((2, flying.nv))
    zs[:, root.idx_v + 3] = SERIES_BELOW * np.array([1.0 - 1e-12, 1.0 + 1e-12])
    rates = np.tile(np.random.default_rng(2).normal(size=flying.nv), (2, 1))
    for rows in (tangents(flying, zs, rates), tangent_accelerations(flying, zs, rates, rates)):
        np.testing.assert_allclose(rows[0], rows[1], rtol=0.0, atol=1e-10)


def test_an_arm_of_plain_joints_moves_at_its_rates() -> None:
    panda, rng = group("panda"), np.random.default_rng(1)
    zs, rates, accelerations = rng.normal(size=(3, 5, panda.nv))
    assert tangents(panda, zs, rates).tolist() == rates.tolist()
    assert tangent_accelerations(panda, zs, rates, accelerations).tolist() == accelerations.tolist()


def test_rates_that_are_given_stay_as_they_are() -> None:
    flying = planned()
    rates = np.ones((1, flying.nv))
    tangents(flying, np.full((1, flying.nv), 0.3), rates)
    assert rates.tolist() == [pytest.approx([1.0] * flying.nv)]
