"""Tangents along a motion, against the tangent map point by point and its differences."""

import numpy as np
from hypothesis import given, settings, strategies as st

from guidefield.robot.group.kinematics import tangent_accelerations, tangents
from tests.robot.model.test_joints import planned

SIZES = st.sampled_from([0.0, 1e-9, 1e-3, 0.1, 0.14, 0.15, 1.0, 2.5])


@given(seed=st.integers(0, 2**32 - 1), size=SIZES)
@settings(max_examples=12)
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
