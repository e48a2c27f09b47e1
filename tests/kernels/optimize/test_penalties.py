"""The penalties of loads and of path constraints: their values by Pinocchio, derivatives by it and by differences."""

import math
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.kernels.linalg.bordered_band import COUPLED
from guidefield.kernels.optimize.load_expansions import expand_torque_loads
from guidefield.kernels.optimize.penalties import KeptSamples, add_constraint_penalty, constraint_penalty, load_penalty
from guidefield.planner.motion.bspline import BSpline, End
from guidefield.planner.optimize.clearance_samples import (
    CONSTRAINT_ROOM,
    CONSTRAINT_WEIGHT,
    Sections,
    constraint_samples,
)
from guidefield.planner.optimize.interior_point import FREE_SHARE, LoadSamples
from guidefield.planner.task.effort import EffortLimit, tree_of
from guidefield.planner.task.motion_limits import MotionLimit, frame_limit, link_limit
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.path_constraints import ConstrainedFrames
from tests.kernels.optimize.test_motion_objective import moved, objective_of_loads
from tests.kernels.tree.test_path_constraints import random_frames
from tests.planner.task.test_motion_limits import TREES, weighty_chain
from tests.robots import group

ARM, STEP, PIECES, WEIGHT = group("panda"), 0.4, 9, 50.0
EFFORTS = np.array([2.0, 20.0, 4.0, 10.0, 0.5, 1.0, np.inf])


def torque_limit() -> EffortLimit:
    tree = tree_of(ARM)
    return EffortLimit(tree, EFFORTS.copy(), tuple(ARM.velocity_names))


LIMITS: dict[str, Callable[[], MotionLimit]] = {
    "torque": torque_limit,
    "frame": lambda: frame_limit(ARM, "panda_hand_tcp", 0.1, math.inf),
    "link": lambda: link_limit(ARM, "panda_hand", 0.1, math.inf),
}


def some_motion(seed: int = 3, planned: PlanningGroup = ARM) -> BSpline:
    rng = np.random.default_rng(seed)
    points = planned.robot.rest[: planned.nv] + np.cumsum(rng.normal(0.0, 0.06, (PIECES + 3, planned.nv)), axis=0)
    ends = [End(points[k], *0.1 * rng.normal(size=(2, planned.nv))) for k in (0, -1)]
    return BSpline.between(ends[0], ends[1], points[3:-3], STEP)


def states(spline: BSpline, samples: LoadSamples) -> list[np.ndarray]:
    """Points, velocities and accelerations at all samples."""
    about = np.stack([spline.points[i : i + 4] for i in range(spline.pieces)])
    by_order = np.einsum("soa,iaj->oisj", samples.bases, about).reshape(3, -1, spline.points.shape[1])
    return [rows / spline.step**order for order, rows in enumerate(by_order)]


def loads_at(limit: MotionLimit, spline: BSpline, samples: LoadSamples) -> np.ndarray:
    """All loads at all samples, by Pinocchio; of a link's speed that of the points that are looked at."""
    found, data = [], ARM.model.createData()
    for z, dz, ddz in zip(*states(spline, samples), strict=True):
        if isinstance(limit, EffortLimit):
            found.append(np.abs(pin.rnea(ARM.model, data, z, dz, ddz)) / EFFORTS)
            continue
        body = samples.speeds[0].body
        pin.forwardKinematics(ARM.model, data, z, dz)
        joint = body.joints.table.parents.shape[0] - 1
        velocity = pin.getVelocity(ARM.model, data, joint, pin.LOCAL)
        speeds = np.linalg.norm(velocity.linear + np.cross(velocity.angular, body.points), axis=1)
        found.append([(speeds + body.radii * np.linalg.norm(velocity.angular)).max() / 0.1])
    return np.array(found)


@pytest.mark.parametrize("kind", LIMITS)
def test_the_value_is_of_pinocchios_loads(kind) -> None:
    limit, spline = LIMITS[kind](), some_motion()
    samples = LoadSamples.of((limit,), PIECES, ARM.nv)
    beyond = np.maximum(loads_at(limit, spline, samples) - FREE_SHARE, 0.0)
    total = samples.measure(spline)
    assert total == pytest.approx(float((beyond**2).sum()))
    assert total > 0.1
    model = samples.linearize(spline, 0, WEIGHT)
    value = load_penalty(model, spline.points, spline.step)
    assert value == pytest.approx(0.5 * WEIGHT * total / len(beyond))


@pytest.mark.parametrize("kind", LIMITS)
def test_its_gradient_is_that_of_its_value(kind) -> None:
    limit, spline = LIMITS[kind](), some_motion()
    samples = LoadSamples.of((limit,), PIECES, ARM.nv)
    samples.measure(spline)
    model = samples.linearize(spline, 0, WEIGHT)
    _, gradient, hessian = objective_of_loads(spline, model)
    rng, by = np.random.default_rng(1), 1e-6
    for along in [*rng.normal(size=(6, len(gradient))), np.eye(len(gradient))[-1]]:
        there, back = (samples.measure(moved(spline, along, side * by)) for side in (1.0, -1.0))
        slope = 0.5 * samples.weight(WEIGHT) * (there - back) / (2.0 * by)
        assert gradient @ along == pytest.approx(slope, rel=2e-4, abs=1e-4 * np.linalg.norm(gradient))
    assert np.linalg.eigvalsh(hessian).min() > -1e-9 * np.abs(hessian).max()


@settings(max_examples=20)
@given(TREES, st.integers(0, 2**32 - 1))
def test_derivatives_of_torques_are_pinocchios(kinds, seed) -> None:
    planned = weighty_chain(kinds, seed)
    tree, (z, dz, ddz) = tree_of(planned), np.random.default_rng(seed).normal(size=(3, planned.nv))
    nv, bases = planned.nv, np.eye(3, 4)[None]  # of a motion whose control points are point and rates
    rows, slopes = (np.empty(nv, np.int64), np.empty(nv, np.int64), np.empty(nv)), np.empty((nv, 3, nv))
    points = np.array([z, dz, ddz, np.zeros(nv)])
    assert expand_torque_loads(tree, np.ones(nv), points, 1.0, bases, np.zeros(1), -1.0, *rows, slopes) == nv
    expand = planned.expand_velocity
    q, data = planned.expand_from_local(z), planned.model.createData()
    by = pin.computeRNEADerivatives(planned.model, data, q, expand @ dz, expand @ ddz)
    mass = np.triu(by[2]) + np.triu(by[2], 1).T
    for got, row in zip(slopes.swapaxes(0, 1), (by[0], by[1], mass), strict=True):
        np.testing.assert_allclose(got, row, rtol=1e-9, atol=1e-9)


CONSTRAINED_PIECES, SAMPLES_A_PIECE = 7, 2
PLACES = (np.arange(CONSTRAINED_PIECES * SAMPLES_A_PIECE) + 0.5) / SAMPLES_A_PIECE


def constrained_motion(name: str, spread: float) -> tuple[ConstrainedFrames, BSpline, KeptSamples]:
    """A motion about a random configuration, and where its six constraints are looked at."""
    rng = np.random.default_rng(3)
    frames = random_frames(name, rng)
    z = frames.group.to_local(frames.group.random(rng))
    points = z + spread * rng.normal(size=(CONSTRAINED_PIECES + 3, len(z)))
    ends = End.at_rest(points[0]), End.at_rest(points[-1])
    spline = BSpline.between(*ends, points[3:-3], 0.1)
    return frames, spline, constraint_samples(Sections.whole(frames), spline.pieces, (), 1)


def differentiate(kept: KeptSamples, points: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """The penalty, its gradient and its whole Hessian, shape (n nv, n nv)."""
    n, nv = points.shape
    gradient, blocks = np.zeros((n, nv)), np.zeros((n, nv, (COUPLED + 1) * nv))
    value = add_constraint_penalty(kept, points, gradient, blocks)
    hessian = np.zeros((n, nv, n, nv))
    for i in range(n):
        for c in range(COUPLED + 1):
            if (k := i - COUPLED + c) >= 0:
                hessian[i, :, k] = blocks[i, :, c * nv : (c + 1) * nv]
                hessian[k, :, i] = hessian[i, :, k].T
    return value, gradient, hessian.reshape(n * nv, n * nv)


def find_shares(frames: ConstrainedFrames, spline: BSpline) -> tuple[np.ndarray, np.ndarray]:
    """Pinocchio's shares of limits at all samples, shape (s, k), and their derivatives by points, (s, k, n nv)."""
    zs = spline.at(PLACES)
    pairs = [frames.values_and_rows(z) for z in zs]
    rows = np.zeros((len(zs), len(frames.limits), *spline.points.shape))
    pieces, t = spline.piece_of(PLACES)
    s = 1.0 - t
    basis = np.column_stack([s**3, 3 * t**3 - 6 * t**2 + 4, 3 * s**3 - 6 * s**2 + 4, t**3]) / 6.0
    for k, (_, by_z) in enumerate(pairs):
        for a in range(4):
            rows[k, :, pieces[k] + a] = basis[k, a] * by_z / frames.limits[:, None]
    return np.array([values for values, _ in pairs]) / frames.limits, rows.reshape(*rows.shape[:2], -1)


@pytest.mark.parametrize("name", ["panda", "continuous y oblique-continuous mimic"])
def test_the_penalty_of_constraints_is_the_formula_by_pinocchio(name: str) -> None:
    frames, spline, kept = constrained_motion(name, 0.2)
    shares, _ = find_shares(frames, spline)
    beyond = np.maximum(shares - CONSTRAINT_ROOM, 0.0)
    expected = 0.5 * CONSTRAINT_WEIGHT / len(PLACES) * (beyond**2).sum()
    assert expected > 0.0
    assert constraint_penalty(kept, spline.points) == pytest.approx(expected, rel=1e-9)
    assert differentiate(kept, spline.points)[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("name", ["panda", "slide oblique screw x"])
def test_its_gradient_is_that_of_finite_differences(name: str) -> None:
    _, spline, kept = constrained_motion(name, 0.05)
    _, gradient, _ = differentiate(kept, spline.points)
    h = 1e-6
    for along in np.random.default_rng(1).normal(size=(4, *spline.points.shape)):
        ahead, behind = (constraint_penalty(kept, spline.points + by * along) for by in (h, -h))
        scale = np.abs(gradient * along).sum()
        assert (ahead - behind) / (2.0 * h) == pytest.approx((gradient * along).sum(), abs=1e-5 * scale)
