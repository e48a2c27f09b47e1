"""The objective of a motion, its derivatives and its model, against plain formulas and finite differences."""

import dataclasses
import functools
import math
from typing import Any

import numpy as np
import pytest

from guidefield.kernels.linalg.bordered_band import COUPLED
from guidefield.kernels.optimize.clearance_model import ClearanceModel, MotionSamples, clearance_along
from guidefield.kernels.optimize.limit_barrier import MotionLimits, TimeLimits, limit_barrier
from guidefield.kernels.optimize.motion_objective import MotionEnds, motion_objective
from guidefield.kernels.optimize.obstacle_barrier import nothing_remembered
from guidefield.kernels.optimize.penalties import KeptSamples, LoadModel
from guidefield.planner.motion.bspline import BSpline, End
from guidefield.planner.optimize.clearance_samples import Sections, constraint_samples
from guidefield.planner.optimize.interior_point import no_loads
from guidefield.planner.task.problem import Problem
from guidefield.robot.group.path_constraints import ConstrainedFrames
from guidefield.scene.distance_tables import moving_tables
from tests.kernels.optimize.test_robot_barrier import GROUPS, made, sampled
from tests.planner.problems import problem, scene_of
from tests.planner.test_moving_kinds import KINDS, moving

PIECES = 9

GIVEN = TimeLimits(departs=0, latest=math.inf, earliest=-math.inf, unit=1.0)
"""The departure is given, and any arrival is good."""


def frozen(layout: type, *rows: np.ndarray) -> Any:
    for row in rows:
        row.setflags(write=False)
    return layout(*rows)


def plain_limits(points: np.ndarray, step: float, limits: MotionLimits) -> float:
    """The barrier of limits, written down once more."""
    beside = np.diff(points, axis=0)[[1, -2]] / (limits.velocity * step)
    ratios = [
        np.diff(points, n=order, axis=0)[3 - order : len(points) - 3] / (limit * step**order)
        for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), 1)
    ]
    with np.errstate(invalid="ignore"):
        inner = (2.0 * points[3:-3] - limits.lower - limits.upper) / (limits.upper - limits.lower)
    ratios.append(np.where(np.isfinite(limits.upper - limits.lower), inner, 0.0))
    if max(np.abs(ratio).max() for ratio in ratios) >= 1.0 or np.abs(beside).max() > 1.0 + 1e-9:
        return math.inf
    return -sum(float(np.log(1.0 - ratio**2).sum()) for ratio in ratios)


def motion(name: str, moving: bool) -> tuple[BSpline, MotionLimits]:
    """A motion about a configuration where some points are near obstacles, within limits of its own; else infinite."""
    made_for, z = made(name)
    rng, nv = np.random.default_rng(5), made_for.group.nv
    points = z + 0.02 * rng.normal(size=(PIECES + 3, nv))
    ends = [End(points[k], 0.01 * moving * rng.normal(size=nv), 0.02 * moving * rng.normal(size=nv)) for k in (0, -1)]
    spline = BSpline.between(ends[0], ends[1], points[3:-3], 0.4)
    velocity, acceleration, jerk = (
        3.0 * np.abs(np.diff(spline.points, n=order, axis=0)).max(axis=0) / 0.4**order for order in (1, 2, 3)
    )
    jerk[0] = np.inf
    lower, upper = spline.points.min(axis=0) - 0.05, spline.points.max(axis=0) + 0.03
    lower[-1], upper[-1] = -np.inf, np.inf
    return spline, frozen(MotionLimits, velocity, acceleration, jerk, lower, upper, np.ones(nv))


def ends_of(spline: BSpline) -> MotionEnds:
    both = spline.start, spline.end
    rows = ([one.position for one in both], [one.velocity for one in both], [one.acceleration for one in both])
    return frozen(MotionEnds, *map(np.array, rows))


def look(name: str, points: np.ndarray) -> ClearanceModel:
    """The clearance of a motion."""
    return look_at(made(name)[0], points, 0.4, 0.0)


def look_at(
    made_for: Problem, points: np.ndarray, step: float, begin: float, only: int | None = None
) -> ClearanceModel:
    """The same among any obstacles, of pieces of a length and a departure [s]; perhaps of a single sample."""
    robot, tables = sampled(made_for)
    n, nv = points.shape
    s = 1.0 - (t := np.full(PIECES, 0.3))
    basis = np.column_stack([s**3, 3 * t**3 - 6 * t**2 + 4, 3 * s**3 - 6 * s**2 + 4, t**3]) / 6.0
    samples = frozen(
        MotionSamples,
        np.arange(PIECES),
        np.arange(PIECES) + 0.3,
        basis,
        np.linspace(0.5, 1.0, PIECES) * (1.0 if only is None else np.eye(PIECES)[only]),
        np.full(PIECES, 0.08),
        np.full(PIECES, 0.05),
        np.tile([1.0, 0.0, 2.0], PIECES)[:PIECES],
    )
    gradient, hessians = np.full((n, nv), np.nan), np.full((PIECES, nv, nv), np.nan)
    pieces, at = np.full(PIECES, -1), np.full((PIECES, 4), np.nan)
    border, by_times, corner = np.full((2, n, nv), np.nan), np.full(2, np.nan), np.full((2, 2), np.nan)
    near, moving = nothing_remembered(PIECES, len(robot.groups)), moving_tables(made_for.scene)
    value, count = clearance_along(
        robot, tables, moving, samples, points, step, begin, 0.01, math.inf, near, gradient, pieces, at, hessians,
        border, by_times, corner,
    )  # fmt: skip
    for row in (gradient, pieces, at, hessians, border, by_times, corner):
        row.setflags(write=False)
    return ClearanceModel(value, points, step, begin, gradient, count, pieces, at, hessians, border, by_times, corner)


def unconstrained(name: str) -> KeptSamples:
    """Without path constraints."""
    none = ConstrainedFrames(made(name)[0].group, ())
    return constraint_samples(Sections.whole(none), PIECES, (), 1)


def of(
    name: str,
    spline: BSpline,
    limits: MotionLimits,
    model: ClearanceModel | None = None,
    times: TimeLimits = GIVEN,
    loads: LoadModel | None = None,
) -> tuple[float, np.ndarray, np.ndarray]:
    """The objective, its gradient, and the whole Hessian, by a model or a look."""
    n, nv = spline.points.shape
    inner, more = n - 6, 1 + times.departs
    free = inner * nv
    blocks = np.full((n, nv, (COUPLED + 1) * nv), np.nan)
    border, corner, gradient = (np.full(shape, np.nan) for shape in ((more, free), (more, more), free + more))
    value = motion_objective(
        model or look(name, spline.points), loads or no_loads(nv), ends_of(spline), limits,
        times, unconstrained(name), np.array([0, nv]), spline.points, spline.step, spline.begin, 0.3, 0.02, blocks,
        border, corner, gradient,
    )  # fmt: skip
    hessian = np.zeros((free + more, free + more))
    for f in range(inner):
        for c in range(COUPLED + 1):
            if (k := f - COUPLED + c) >= 0:
                block = blocks[3 + f, :, c * nv : (c + 1) * nv]
                hessian[f * nv : (f + 1) * nv, k * nv : (k + 1) * nv] = block
                hessian[k * nv : (k + 1) * nv, f * nv : (f + 1) * nv] = block.T
    hessian[free:, :free], hessian[:free, free:], hessian[free:, free:] = border, border.T, corner
    return value, gradient, hessian


def objective_of_loads(spline: BSpline, loads: LoadModel) -> tuple[float, np.ndarray, np.ndarray]:
    """What loads add to an objective, its gradient, and its Hessian."""
    limits = motion("panda", moving=False)[1]
    unlimited = frozen(MotionLimits, *(np.full(7, np.inf) for _ in range(3)), *limits[3:])
    unlimited = unlimited._replace(lower=np.full(7, -np.inf), upper=np.full(7, np.inf))
    unlimited.lower.setflags(write=False), unlimited.upper.setflags(write=False)
    model = look("panda", spline.points)
    one, other = (of("panda", spline, unlimited, model, loads=each) for each in (loads, None))
    return one[0] - other[0], one[1] - other[1], one[2] - other[2]


def moved(spline: BSpline, along: np.ndarray, by: float) -> BSpline:
    """The motion moved along inner control points, u and perhaps the departure."""
    inner, (longer, *later) = np.split(by * along, [spline.inner.size])[0], by * along[spline.inner.size :]
    points, step = spline.inner + inner.reshape(spline.inner.shape), spline.step * math.exp(longer)
    return BSpline.between(spline.start, spline.end, points, step, spline.begin + sum(later))


@pytest.mark.parametrize("moving", [False, True], ids=["at rest", "in motion"])
@pytest.mark.parametrize("name", GROUPS)
def test_the_gradient_is_that_of_finite_differences(name: str, moving: bool) -> None:
    spline, limits = motion(name, moving)
    _, gradient, _ = of(name, spline, limits)
    rng, h = np.random.default_rng(0), 1e-6
    directions = [*rng.normal(size=(3, len(gradient))), np.eye(len(gradient))[-1]]
    for along in directions:
        ahead, behind = (of(name, moved(spline, along, by), limits)[0] for by in (h, -h))
        scale = np.abs(gradient) @ np.abs(along)
        assert (ahead - behind) / (2.0 * h) == pytest.approx(gradient @ along, abs=2e-4 * scale)


@pytest.mark.parametrize("moving", [False, True], ids=["at rest", "in motion"])
@pytest.mark.parametrize("name", ["panda", "floating"])
def test_with_a_model_from_elsewhere_the_gradient_is_that_of_the_value(name: str, moving: bool) -> None:
    seen, limits = motion(name, moving)
    model, rng, h = look(name, seen.points), np.random.default_rng(1), 1e-6
    spline = moved(seen, rng.normal(size=seen.inner.size + 1), 1e-3)
    value, gradient, _ = of(name, spline, limits, model)
    for along in [*rng.normal(size=(3, len(gradient))), np.eye(len(gradient))[-1]]:
        ahead, behind = (of(name, moved(spline, along, by), limits, model)[0] for by in (h, -h))
        error = 1e-6 * np.abs(gradient) @ np.abs(along) + 1e-15 * abs(value) / h
        assert (ahead - behind) / (2.0 * h) == pytest.approx(gradient @ along, abs=error)


# ---- among obstacles that move


WINDOW = TimeLimits(departs=1, latest=2.0, earliest=0.5, unit=3.0)


@functools.cache
def in_time(kind: str) -> tuple[Problem, BSpline, MotionLimits]:
    """A motion of a Panda about which two obstacles of a kind fly meanwhile, and something rests."""
    spline, limits = motion("panda", moving=False)
    spline = dataclasses.replace(spline, begin=0.3)
    made_for = made("panda")[0]
    for seed in range(200):
        rng = np.random.default_rng([seed, KINDS.index(kind)])
        flying = [moving(kind, f"flying{k}", rng, 0.0, 3.0) for k in range(2)]
        found = problem(made_for.group, scene_of(*made_for.scene.message.obstacles[:3], *flying), planes=())
        model = look_at(found, spline.points, spline.step, spline.begin)
        if abs(model.by_times[1]) > 1e-2 and 1e-2 < model.value < 1e10:
            return found, spline, limits
    raise AssertionError("nothing comes near")


@pytest.mark.parametrize("kind", KINDS)
def test_in_time_the_gradient_is_that_of_finite_differences(kind: str) -> None:
    """By control points, by the length of pieces and by the departure: obstacles move on, or are met later."""
    made_for, spline, limits = in_time(kind)

    def at(one: BSpline) -> tuple[float, np.ndarray]:
        model = look_at(made_for, one.points, one.step, one.begin)
        value, gradient, _ = of("panda", one, limits, model, WINDOW)
        return value, gradient

    _, gradient = at(spline)
    rng, h = np.random.default_rng(0), 1e-6
    last = np.eye(len(gradient))[-2:]
    for along in [*rng.normal(size=(2, len(gradient))), *last]:
        ahead, behind = (at(moved(spline, along, by))[0] for by in (h, -h))
        scale = np.abs(gradient) @ np.abs(along)
        assert (ahead - behind) / (2.0 * h) == pytest.approx(gradient @ along, abs=2e-4 * scale)


@pytest.mark.parametrize("kind", ["box", "cloud"])
def test_in_time_the_clearance_is_that_of_each_sample_among_what_stands_then(kind: str) -> None:
    made_for, spline, _ = in_time(kind)
    alone = [one for one in made_for.scene.message.obstacles if one.trajectory is not None]
    flying = problem(made_for.group, scene_of(*alone), planes=())
    value = look_at(flying, spline.points, spline.step, spline.begin).value
    expected = 0.0
    for piece in range(PIECES):
        then = flying.at(spline.begin + (piece + 0.3) * spline.step)
        expected += look_at(then, spline.points, 1.0, 0.0, only=piece).value
    assert value == pytest.approx(expected, rel=1e-5)


def test_in_time_a_model_from_elsewhere_is_consistent_and_its_hessian_positive_definite() -> None:
    made_for, seen, limits = in_time("box")
    model, rng, h = look_at(made_for, seen.points, seen.step, seen.begin), np.random.default_rng(1), 1e-6
    size = seen.inner.size + 2
    spline = moved(seen, rng.normal(size=size), 1e-3)
    value, gradient, hessian = of("panda", spline, limits, model, WINDOW)
    assert np.linalg.eigvalsh(hessian).min() > 0.0
    for along in [*rng.normal(size=(3, size)), *np.eye(size)[-2:]]:
        ahead, behind = (of("panda", moved(spline, along, by), limits, model, WINDOW) for by in (h, -h))
        error = 1e-6 * np.abs(gradient) @ np.abs(along) + 1e-15 * abs(value) / h
        assert (ahead[0] - behind[0]) / (2.0 * h) == pytest.approx(gradient @ along, abs=error)


@pytest.mark.parametrize("name", ["panda", "planar"])
def test_a_model_is_the_quadratic_form_of_its_look(name: str) -> None:
    spline, limits = motion(name, moving=False)
    model, rng = look(name, spline.points), np.random.default_rng(2)
    n, nv = spline.points.shape
    dense = np.zeros((n, nv, n, nv))
    assert 0 < model.places <= PIECES
    for s in range(model.places):
        for a, b in np.ndindex(4, 4):
            share = model.basis[s, a] * model.basis[s, b]
            dense[model.pieces[s] + a, :, model.pieces[s] + b] += share * model.hessians[s]
    far = moved(spline, rng.normal(size=spline.inner.size + 1), 1e-2)
    way = far.points - spline.points
    change = np.einsum("ip,ip->", model.gradient, way) + 0.5 * np.einsum("ip,ipkq,kq->", way, dense, way)
    empty = model._replace(value=0.0, gradient=np.zeros_like(model.gradient), places=0)
    empty.gradient.setflags(write=False)
    rest = of(name, far, limits, empty)[0]
    assert of(name, far, limits, model)[0] - rest == pytest.approx(model.value + change, rel=1e-10)


@pytest.mark.parametrize("name", ["panda", "ball joints"])
def test_the_hessian_is_positive_definite_and_nears_the_true_one_where_nothing_is_near_its_limits(name: str) -> None:
    spline, limits = motion(name, moving=False)
    wide = frozen(MotionLimits, *(1e3 * one for one in limits[:3]), *(row.copy() for row in limits[3:]))
    _, _, hessian = of(name, spline, limits)
    assert np.linalg.eigvalsh(hessian).min() > 0.0
    value, gradient, flat = of(name, spline, wide)
    assert value > 0.0
    h, step = 1e-5, np.zeros(len(gradient))
    step[-1] = 1.0  # of the length of pieces, on which the clearance does not depend
    change = of(name, moved(spline, step, h), wide)[1] - of(name, moved(spline, step, -h), wide)[1]
    assert change[-1] / (2.0 * h) == pytest.approx(flat[-1, -1], rel=1e-3)


@pytest.mark.parametrize("name", ["panda", "floating"])
def test_the_barrier_of_limits_is_the_formula(name: str) -> None:
    spline, limits = motion(name, moving=True)
    expected = plain_limits(spline.points, spline.step, limits)
    assert limit_barrier(spline.points, spline.step, limits) == pytest.approx(expected, rel=1e-12)
    for step in (0.9 * spline.step, 0.3 * spline.step):
        expected = plain_limits(spline.points, step, limits)
        assert limit_barrier(spline.points, step, limits) == pytest.approx(expected, rel=1e-12)
    assert math.isinf(expected), "so fast it exceeds a limit"
