"""The barrier and bodies on screws, by Pinocchio, Coal and differences; Newton's descent never leaves limits."""

import math

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.kernels.distance.distance import distance_at_points
from guidefield.kernels.optimize.barrier import SOFT, barrier, moved_bodies, place_moved
from guidefield.kernels.optimize.clearance_model import ClearanceModel
from guidefield.kernels.optimize.limit_barrier import MotionLimits, TimeLimits, limit_barrier
from guidefield.kernels.optimize.newton_descent import DescentRules, allocate_descent_buffers, newton_descent
from guidefield.kernels.optimize.obstacle_barrier import moving_distance
from guidefield.kernels.optimize.penalties import KeptSamples, constraint_penalty
from guidefield.planner.motion.bspline import BSpline
from guidefield.planner.optimize.clearance_samples import Sections, constraint_samples
from guidefield.planner.optimize.interior_point import no_loads
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.group.path_constraints import ConstrainedFrames, plane
from guidefield.scene.distance_tables import distance_tables, moving_tables
from tests.kernels.optimize.test_motion_objective import GIVEN, ends_of, look, motion, of, unconstrained
from tests.kernels.optimize.test_robot_barrier import made, sampled
from tests.kernels.parts import from_python
from tests.planner.problems import problem, scene_of
from tests.planner.test_moving_kinds import KINDS, moving
from tests.robots import group

of_a_size = from_python(barrier)

RANGES = (0.08, 0.04, 0.012)


def penalty(distance: float, reach: float) -> tuple[float, float, float]:
    """The barrier of a robot of usual size."""
    return of_a_size(distance, reach, 1.0)


@pytest.mark.parametrize("reach", RANGES)
def test_it_is_the_formula_between_soft_and_range(reach: float) -> None:
    for distance in np.linspace(max(SOFT, 0.5 * reach), reach, 20):
        x = distance / reach
        assert penalty(distance, reach)[0] == pytest.approx((1.0 - x) ** 2 / x**3, abs=1e-12)


@pytest.mark.parametrize("reach", RANGES)
def test_its_derivatives_are_its_own(reach: float) -> None:
    step = 1e-6 * reach
    for distance in (-0.3, -0.01, 0.0, 0.004, 0.3 * reach, 0.7 * reach, 0.95 * reach, 1.5 * reach):
        before, here, after = (penalty(distance + k * step, reach) for k in (-1, 0, 1))
        assert here[1] == pytest.approx((after[0] - before[0]) / (2 * step), rel=1e-5, abs=1e-5)
        if abs(distance - SOFT) > step:
            assert here[2] == pytest.approx((after[1] - before[1]) / (2 * step), rel=1e-5, abs=1e-3)


@pytest.mark.parametrize("reach", RANGES)
def test_it_falls_is_convex_and_continuous(reach: float) -> None:
    distances = np.linspace(-0.5, 1.2 * reach, 20001)
    values, slopes, curvatures = np.array([penalty(d, reach) for d in distances]).T
    assert (np.diff(values) <= 0.0).all()
    assert (np.diff(slopes) >= -1e-9 * np.abs(slopes).max()).all()
    assert (curvatures >= 0.0).all()
    for edge in (min(SOFT, 0.5 * reach), reach):
        a, b = penalty(edge - 1e-12, reach), penalty(edge + 1e-12, reach)
        np.testing.assert_allclose(a[:2], b[:2], rtol=1e-6, atol=1e-6)
    assert penalty(reach, reach) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("distance", [-0.01, 0.004, 0.03])
def test_it_goes_with_the_size(distance: float) -> None:
    value, slope, curvature = penalty(distance, 0.08)
    assert of_a_size(8.0 * distance, 8.0 * 0.08, 8.0) == pytest.approx((value, slope / 8.0, curvature / 64.0))


PANDA = group("panda")
FARTHEST = 0.25  # ends count as keeping at most so much [m]
TIMES = (-0.5, 0.2, 0.9, 1.6, 2.3, 9.0)


@pytest.mark.parametrize("kind", ["box", "half space", "cloud", "dented mesh"])
def test_frames_are_where_pinocchio_has_them_and_as_fast_as_they_move(kind: str) -> None:
    scene = scene_of(*(moving(kind, f"o{k}", np.random.default_rng([k, 3])) for k in range(3)))
    tables = moving_tables(scene)
    moved, ahead, behind = (moved_bodies(tables, 1, 1) for _ in range(3))
    h, point = 1e-6, np.array([0.4, -0.3, 0.7])
    for time in TIMES:
        for each, at in ((moved, time), (ahead, time + h), (behind, time - h)):
            place_moved(tables, at, each)
        for k, one in enumerate(scene.obstacles):
            np.testing.assert_allclose(moved.frames[k], one.motion.at(time).homogeneous[:3], atol=1e-12)
            body = one.motion.at(time).actInv(point)
            way = pin.SE3(_whole(ahead.frames[k])).act(body) - pin.SE3(_whole(behind.frames[k])).act(body)
            expected = moved.velocities[k, :3] + np.cross(moved.velocities[k, 3:], point)
            np.testing.assert_allclose(way / (2.0 * h), expected, atol=1e-6 * (1.0 + np.abs(expected).max()))


def _whole(placement: np.ndarray) -> np.ndarray:
    return np.vstack([placement, [0.0, 0.0, 0.0, 1.0]])


@pytest.mark.parametrize("kind", KINDS)
def test_the_distance_is_that_to_the_obstacles_as_they_stand_then(kind: str) -> None:
    """By tables of the scene at that time, in which clouds and surfaces are built anew; of convex ones by Coal too."""
    rng = np.random.default_rng([KINDS.index(kind), 5])
    scene = scene_of(*(moving(kind, f"o{k}", rng) for k in range(2)))
    made, z = problem(PANDA, scene, planes=()), PANDA.to_local(PANDA.random(rng))
    robot, _ = sampled(made)
    data = PANDA.model.createData()
    pin.forwardKinematics(PANDA.model, data, PANDA.expand_from_local(z))
    joints = robot.groups[:, 0].tolist()
    points = np.concatenate(
        [
            robot.points[:, first:last].T @ data.oMi[joint].rotation.T + data.oMi[joint].translation
            for joint, (first, last) in zip(joints, robot.groups[:, 1:3].tolist(), strict=True)
        ]
    )
    for time in TIMES:
        found = moving_distance(robot, moving_tables(scene), z, time, 5.0)
        then = distance_at_points(distance_tables(scene.at(time)), points)[0].min()
        assert found == pytest.approx(min(then, 5.0), abs=2e-6)
        if kind in ("box", "sphere", "capsule", "cylinder", "half space"):
            apart = min(_by_coal(one, time, point) for one in scene.obstacles for point in points)
            assert found == pytest.approx(min(apart, 5.0), abs=1e-6)
    assert moving_distance(robot, moving_tables(scene), z, 0.0, 1e-3) <= FARTHEST


def _by_coal(one: object, time: float, point: np.ndarray) -> float:
    at = one.placement_at(time)
    there = coal.Transform3s(at.rotation, at.translation)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return coal.distance(coal.Sphere(1e-12), coal.Transform3s(np.eye(3), point), one.shape, there, request, result)


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
        allocate_descent_buffers(*points.shape, times),
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
    tip = Kinematics(group).tip_position(group.expand_from_local(spline.start.position))
    frames = ConstrainedFrames(group, (plane(group.tip, tip, np.array([0.0, 0.6, 0.8]), 1e-3),))
    kept = constraint_samples(Sections.whole(frames), spline.pieces, (), 2)
    model = look("panda", spline.points)
    after, taken = descended(spline, limits, model, kept=kept, steps=60, settled=1e-6)
    assert taken > 1
    assert constraint_penalty(kept, after.points) < 1e-3 * constraint_penalty(kept, spline.points)
    places = np.linspace(0.0, after.pieces, 200)
    assert max(float(frames.values(z)[0]) for z in after.at(places)) <= 1e-3
