"""How the tip moves with the chart: against Pinocchio's Jacobian and against differences of its positions."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.robot.group.kinematics import Kinematics
from tests.robots import box_arm, group, grouped

JOINTS = ["slide y x", "continuous y x", "y x mimic y", "continuous x screw y", "planar y x", "floating y"]


@pytest.mark.parametrize("joints", [None, *JOINTS])
def test_slopes_of_the_tip_are_pinocchios_and_those_of_differences(joints: str | None) -> None:
    planned = group("panda") if joints is None else grouped(box_arm(joints, 0, size=0.25))
    kinematics = Kinematics(planned)
    z = 0.4 * np.random.default_rng(0).normal(size=planned.nv)
    slopes = kinematics.tip_slopes(z)
    by_pinocchio = kinematics.tip_jacobian(planned.expand_from_chart(z))[:3] @ planned.tangent_map(z)
    np.testing.assert_allclose(slopes, by_pinocchio, atol=1e-12)
    moved = 1e-6 * np.eye(planned.nv)
    differences = (kinematics.tip_positions(z + moved) - kinematics.tip_positions(z - moved)).T / 2e-6
    np.testing.assert_allclose(slopes, differences, atol=1e-8)
