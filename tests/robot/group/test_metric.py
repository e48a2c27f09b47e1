"""The metric on the joint space: what counts as one radian, joint by joint."""

from __future__ import annotations

import math

import numpy as np

from guidefield.robot.group.group import LENGTH_OF_A_RADIAN
from tests.robots import box_arm, grouped


def test_lengths_count_by_what_is_one_radian_whatever_joint_they_are_of() -> None:
    slide = LENGTH_OF_A_RADIAN
    for arm, expected in {
        "y slide": [1.0, slide],
        "planar y": [slide, slide, 1.0, 1.0],
        "floating continuous": [slide, slide, slide, 1.0, 1.0, 1.0, 1.0],
        "slide mimic y": [slide, 1.0],
    }.items():
        planned = grouped(box_arm(arm, len(arm.split())))
        np.testing.assert_array_equal(planned.units, expected)
        assert not planned.units.flags.writeable


def test_a_unit_divides_without_rounding() -> None:
    assert math.frexp(LENGTH_OF_A_RADIAN)[0] == 0.5
