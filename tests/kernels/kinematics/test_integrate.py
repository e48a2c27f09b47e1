"""Steps, limits and the tip against Pinocchio, for every kind of joint and for joints that follow."""

import numpy as np
import pinocchio as pin
import pytest

from guidefield.kernels.kinematics.integrate import clamp, integrate, reach
from guidefield.planner.guide.rounds import Aim
from guidefield.robot.group.kinematics import Kinematics, find_planned_values, mover_of
from guidefield.scene.guide_plane import build
from tests.planner.guide.test_guide import plane_at
from tests.robots import box_arm, group, grouped, rest

KINDS = ["x slide oblique", "continuous oblique-continuous y", "x mimic slide y", "planar x y", "continuous screw y"]


def planned_groups():
    return [group(name) for name in ("chain_moving_3x260_r25", "chain_fixed_6x300_r25", "panda")] + [
        grouped(box_arm(kinds, 0)) for kinds in KINDS
    ]


@pytest.mark.parametrize("index", range(7))
def test_a_step_is_pinocchios(index: int) -> None:
    planned = planned_groups()[index]
    rng = np.random.default_rng(index)
    for scale in (1e-6, 0.3, 2.0):
        q, v = planned.random(rng), scale * rng.normal(size=planned.nv)
        reached = np.empty(planned.model.nq)
        integrate(mover_of(planned), planned.expand(q), v, reached)
        expected = planned.integrate(q, v)
        apart = pin.difference(planned.model, planned.expand(expected), reached)  # a quaternion has two signs
        np.testing.assert_allclose(apart, 0.0, atol=1e-9)
        np.testing.assert_allclose(planned.difference(expected, reached[find_planned_values(planned)]), 0.0, atol=1e-9)


def test_limits_stop_a_value_and_its_followers() -> None:
    planned = grouped(box_arm("x mimic slide y", 0))
    z = planned.upper + 0.2
    q = planned.expand_from_chart(z)
    assert clamp(mover_of(planned), q, np.empty(planned.nv))
    np.testing.assert_allclose(q, planned.expand_from_chart(planned.upper), atol=1e-12)


@pytest.mark.parametrize("name", ["panda", "chain_fixed_6x300_r25", "chain_moving_3x260_r25"])
def test_an_advance_reaches_its_point_within_the_limits(name: str) -> None:
    planned = group(name)
    q, kinematics = rest(planned), Kinematics(planned)
    q = planned.integrate(q, 0.1 * np.random.default_rng(0).normal(size=planned.nv))
    point = kinematics.tip_position(q) + np.array([-0.06, -0.05, -0.04])
    reached = np.empty(planned.nq)
    assert reach(mover_of(planned), q, point, reached)
    np.testing.assert_allclose(kinematics.tip_position(reached), point, atol=2e-6)
    z = planned.chart(reached)
    assert np.all((z >= planned.lower - 1e-12) & (z <= planned.upper + 1e-12))
    assert not reach(mover_of(planned), q, point + 50.0, reached) or name.startswith("chain_moving")


@pytest.mark.parametrize("inset", [0.0, 0.03, 0.2])
def test_the_closest_point_of_an_inset_polygon_is_the_guide_planes(inset: float) -> None:
    plane = build(plane_at(0.45), 0)
    aim, rng = Aim(plane, inset), np.random.default_rng(3)
    for point in plane.centroid + 0.2 * rng.normal(size=(50, 3)):
        np.testing.assert_allclose(aim.closest_point(point), plane.closest_point(point, inset), atol=1e-9)
        assert aim.distance(point) == pytest.approx(plane.distance(point, inset), abs=1e-9)


def test_pinocchio_is_the_judge_of_floating_steps() -> None:
    """Small turns, where series stand for sines, join on to the others."""
    planned = group("chain_moving_3x260_r25")
    q, reached = rest(planned), np.empty(planned.nq)
    for angle in (9e-5, 1.1e-4):
        v = np.zeros(planned.nv)
        v[:6] = [0.1, 0.2, -0.3, angle, -angle, angle]
        integrate(mover_of(planned), q, v, reached)
        np.testing.assert_allclose(reached, pin.integrate(planned.model, q, v), atol=1e-13)
