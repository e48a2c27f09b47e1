"""Newton's method on a motion: what it lowers, where it ends, and that it never leaves limits."""

import math

import numpy as np
import pytest

from guidefield.kernels.optimize.clearance_model import ClearanceModel
from guidefield.kernels.optimize.limit_barrier import MotionLimits, TimeLimits, limit_barrier
from guidefield.kernels.optimize.newton_descent import DescentRules, newton_descent, room_for_descent
from guidefield.kernels.optimize.penalties import KeptSamples, constraint_penalty
from guidefield.planner.motion.bspline import BSpline
from guidefield.planner.optimize.clearance_samples import Sections, constraint_samples
from guidefield.planner.optimize.interior_point import no_loads
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.group.path_constraints import ConstrainedFrames, plane
from tests.kernels.optimize.test_motion_objective import GIVEN, ends_of, look, motion, of, unconstrained
from tests.kernels.optimize.test_robot_barrier import made

RULES = DescentRules(
    steps=1000,
    tries=40,
    shorter=0.7,
    settled=1e-13,
    little=0.0,
    longest=0.5,
    most_stretched=0.5,
    trusted=math.inf,
    damping=1e-9,
)


def descended(
    spline: BSpline,
    limits: MotionLimits,
    model: ClearanceModel,
    unit: float = 0.3,
    longest_step: float = math.inf,
    kept: KeptSamples | None = None,
    times: TimeLimits = GIVEN,
    **rules: float,
) -> tuple[BSpline, int]:
    """With the weight of limits, and unless told otherwise with the unit of time, that `of` has."""
    points = spline.points.copy()
    asked = RULES._replace(**rules)
    ends, none = ends_of(spline), no_loads(points.shape[1])
    kept = unconstrained("panda") if kept is None else kept
    step, begin, taken, _ = newton_descent(
        model, none, ends, limits, times, kept, asked, unit, longest_step, 0.02, spline.step, spline.begin, points,
        room_for_descent(*points.shape, times),
    )  # fmt: skip
    return BSpline(points, step, spline.start, spline.end, begin), taken


@pytest.mark.parametrize("moving", [False, True], ids=["at rest", "in motion"])
@pytest.mark.parametrize("name", ["panda", "floating"])
def test_it_ends_where_the_gradient_is_zero_within_limits(name: str, moving: bool) -> None:
    spline, limits = motion(name, moving)
    model = look(name, spline.points)
    before, slope, _ = of(name, spline, limits, model)
    after, taken = descended(spline, limits, model)
    value, gradient, _ = of(name, after, limits, model)
    assert 1 < taken < RULES.steps
    assert value < before
    assert np.abs(gradient).max() < 1e-4 * np.abs(slope).max()
    assert math.isfinite(limit_barrier(after.points, after.step, limits))
    again = BSpline.between(spline.start, spline.end, after.inner, after.step)
    np.testing.assert_allclose(after.points, again.points, atol=1e-14, err_msg="the ends are the ends'")


def test_each_step_lowers_the_objective() -> None:
    spline, limits = motion("panda", moving=False)
    model = look("panda", spline.points)
    values = [of("panda", descended(spline, limits, model, steps=n)[0], limits, model)[0] for n in range(6)]
    assert values[0] == of("panda", spline, limits, model)[0]
    assert (np.diff(values) < 0.0).all()


def test_it_keeps_to_a_constraint_that_bends_and_is_tight() -> None:
    wild, limits = motion("panda", moving=False)
    spline = BSpline.between(wild.start, wild.start, wild.inner, wild.step)
    group = made("panda")[0].group
    tip = Kinematics(group).tip_position(group.expand_from_chart(spline.start.position))
    frames = ConstrainedFrames(group, (plane(group.tip, tip, np.array([0.0, 0.6, 0.8]), 1e-3),))
    kept = constraint_samples(Sections.whole(frames), spline.pieces, (), 2)
    model = look("panda", spline.points)
    after, taken = descended(spline, limits, model, kept=kept, steps=60, settled=1e-6)
    assert taken > 1
    assert constraint_penalty(kept, after.points) < 1e-3 * constraint_penalty(kept, spline.points)
    places = np.linspace(0.0, after.pieces, 200)
    assert max(float(frames.values(z)[0]) for z in after.at(places)) <= 1e-3
