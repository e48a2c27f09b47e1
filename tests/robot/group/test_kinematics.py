"""The tip's motion with the local coordinates: against Pinocchio's Jacobian, the tangent map and differences."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.messages.requests import UrdfText
from guidefield.robot.catalog import Catalog
from guidefield.robot.group.kinematics import Kinematics, tangent_accelerations, tangents
from guidefield.robot.group.reduced_model import select
from tests.robot.model.test_joints import planned
from tests.robots import box_arm, group, grouped

JOINTS = ["slide y x", "continuous y x", "y x mimic y", "continuous x screw y", "planar y x", "floating y"]


@pytest.mark.parametrize("joints", [None, *JOINTS])
def test_slopes_of_the_tip_are_pinocchios_and_those_of_differences(joints: str | None) -> None:
    planned = group("panda") if joints is None else grouped(box_arm(joints, 0, size=0.25))
    kinematics = Kinematics(planned)
    z = 0.4 * np.random.default_rng(0).normal(size=planned.nv)
    slopes = kinematics.tip_slopes(z)
    by_pinocchio = kinematics.tip_jacobian(planned.expand_from_local(z))[:3] @ planned.tangent_map(z)
    np.testing.assert_allclose(slopes, by_pinocchio, atol=1e-12)
    moved = 1e-6 * np.eye(planned.nv)
    differences = (kinematics.tip_positions(z + moved) - kinematics.tip_positions(z - moved)).T / 2e-6
    np.testing.assert_allclose(slopes, differences, atol=1e-8)


BRANCHES = ["base", "base", "a1", "b1", "a2", "b2"]
"""Parents of the links of two arms, in turns: joints that lead to one tip stand between others."""


def test_a_tip_beside_other_arms_is_where_pinocchio_has_it() -> None:
    links = [f"{arm}{k}" for k in (1, 2, 3) for arm in "ab"]
    ball = '<collision><geometry><sphere radius="0.01"/></geometry></collision>'
    parts = [f'<link name="{name}">{ball}</link>' for name in ("base", *links)]
    for link, parent in zip(links, BRANCHES, strict=True):
        ends = f'<parent link="{parent}"/><child link="{link}"/><origin xyz="0.1 0.05 0.2" rpy="0.3 0 0.1"/>'
        limit = '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/>'
        parts.append(f'<joint name="j_{link}" type="revolute">{ends}{limit}</joint>')
    model = Catalog().load(UrdfText(text=f'<robot name="two">{"".join(parts)}</robot>'))
    for tip in ("a2", "b3", "base"):
        planned = select(model, [f"j_{link}" for link in links], tip, model.rest, pin.SE3.Identity())
        kinematics, zs = Kinematics(planned), np.random.default_rng(1).normal(size=(5, planned.nv))
        wanted = [kinematics.tip_position(planned.expand_from_local(z)) for z in zs]
        np.testing.assert_allclose(kinematics.tip_positions(zs), wanted, atol=1e-12)


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
