"""How far off Coal's distances are, and the margins that allow for it."""

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from guidefield.prove.verdict import COAL_ACCURACY, COAL_RELATIVE, with_coal_error

UPRIGHT, LYING = np.eye(3), pin.rpy.rpyToMatrix(np.pi / 2, 0.0, 0.0)

sizes = st.floats(-2.0, 0.0).map(lambda exponent: 10.0**exponent)
apart = st.floats(-4.0, 1.3).map(lambda exponent: 10.0**exponent)
share = st.floats(-0.4, 0.4)


@given(apart, sizes, sizes, st.floats(0.1, 10.0), st.floats(0.1, 10.0), share, share, st.integers(0, 2**32 - 1))
def test_coal_is_as_exact_as_the_margins_allow(distance, one, other, long, tall, along, up, seed):
    # An upright cylinder touches the plane x = 0 from below, a lying one the plane x = distance from above; the lines
    # in which they touch cross, so they are that distance apart.
    first = pin.SE3(UPRIGHT, np.array([-one, 0.0, along * long]))
    second = pin.SE3(LYING, np.array([distance + other, up * tall, 0.0]))
    pose = np.random.default_rng(seed).normal(size=7)
    turned = pin.SE3(pin.Quaternion(pose[3:] / np.linalg.norm(pose[3:])), pose[:3])
    places = [coal.Transform3s(at.rotation, at.translation) for at in (turned * first, turned * second)]
    shapes = coal.Cylinder(one, long), coal.Cylinder(other, tall)
    told = coal.distance(shapes[0], places[0], shapes[1], places[1], coal.DistanceRequest(), coal.DistanceResult())
    assert distance <= with_coal_error(told)
    assert told <= with_coal_error(distance)


@pytest.mark.parametrize("distance", [-2.0, -1e-3, 0.0, 1e-6, 0.3, 20.0])
def test_more_is_asked_for_than_has_to_be_kept(distance):
    error = COAL_ACCURACY + COAL_RELATIVE * abs(distance)
    assert with_coal_error(distance) == pytest.approx(distance + error, rel=0.0, abs=1e-15)
    assert with_coal_error(np.array([distance]))[0] == with_coal_error(distance)
