"""The metric on the joint space: what counts as one radian, joint by joint."""

from __future__ import annotations

import math

import numpy as np

from guidefield.robot.group.group import LENGTH_OF_A_RADIAN
from tests.robots import box_arm, grouped


def test_lengths_count_by_what_is_one_radian_whatever_joint_they_are_of() -> None:
    for arm, lengths in {
        "y slide": [False, True],
        "planar y": [True, True, False, False],
        "floating continuous": [True, True, True, False, False, False, False],
        "slide mimic y": [True, False],
    }.items():
        planned = grouped(box_arm(arm, len(arm.split())))
        # what drives or flies goes as far however small it is
        slide = LENGTH_OF_A_RADIAN * (planned.size if "slide" in arm else max(planned.size, 1.0))
        np.testing.assert_array_equal(planned.units, np.where(lengths, slide, 1.0))
        assert not planned.units.flags.writeable


def test_a_unit_divides_without_rounding() -> None:
    assert math.frexp(LENGTH_OF_A_RADIAN)[0] == 0.5
