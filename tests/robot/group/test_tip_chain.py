"""The chain to a tip, judged by Pinocchio's placements and logarithm."""

import numpy as np
import pinocchio as pin
import pytest

from guidefield.kernels.kinematics.inverse_kinematics import LEVER, Tolerances, squared_errors
from guidefield.robot.group.kinematics import ChainToTip, Kinematics, chain_to_tip
from tests.robots import box_arm, group, grouped, rest

ARMS_OF_EVERY_KIND = (
    "y slide x",
    "oblique oblique-continuous slide x",
    "y mimic x mimic",
    "planar y x",
    "floating y",
    "x floating slide planar",
)


def distances(chain: ChainToTip, target: pin.SE3, zs: np.ndarray) -> np.ndarray:
    """Lengths of the components of translation and rotation vector from a target to the tip, shape (n, 6).

    One by one: the errors of all others are free.
    """
    found, ones = np.empty((len(zs), 6)), np.ones(zs.shape[1])
    ones.setflags(write=False)
    for row in range(6):
        aimed, squared = np.full(6, np.inf), np.empty(len(zs))
        aimed[row] = 0.0
        aimed.setflags(write=False)
        squared_errors(chain.from_target(target), Tolerances(aimed, aimed, 1.0, ones), zs, squared)
        found[:, row] = np.sqrt(squared) / (1.0 if row < 3 else LEVER)
    return found


@pytest.mark.parametrize(
    "arm", ["panda", "ur5", "kinova", "chain_universal_fixed_6x300_r25", "chain_moving_3x260_r20", *ARMS_OF_EVERY_KIND]
)
def test_offsets_are_pinocchios(arm):
    planned = grouped(box_arm(arm, len(arm.split()))) if " " in arm else group(arm)
    rng, kinematics = np.random.default_rng(3), Kinematics(planned)
    target = pin.SE3.Random()
    qs = [rest(planned), *(planned.random(rng) for _ in range(37))]
    expected = []
    for q in qs:
        offset = target.actInv(kinematics.frame_placement(planned.expand(q), planned.tip_id))
        expected.append(np.r_[offset.translation, pin.log3(offset.rotation)])
    offsets = distances(chain_to_tip(planned), target, np.array([planned.chart(q) for q in qs]))
    np.testing.assert_allclose(offsets, np.abs(expected), rtol=0.0, atol=1e-10)
