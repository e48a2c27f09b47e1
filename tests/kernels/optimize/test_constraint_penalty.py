"""The penalty of leaving path constraints, by Pinocchio's numbers and rows, and by finite differences."""

import numpy as np
import pytest

from guidefield.kernels.linalg.bordered_band import COUPLED
from guidefield.kernels.optimize.constraint_penalty import KeptSamples, add_constraint_penalty, constraint_penalty
from guidefield.planner.motion.bspline import BSpline, End
from guidefield.planner.optimize.clearance_samples import (
    CONSTRAINT_ROOM,
    CONSTRAINT_WEIGHT,
    Sections,
    constraint_samples,
)
from guidefield.robot.group.path_constraints import ConstrainedFrames
from tests.kernels.tree.test_path_constraints import random_frames

PIECES, SAMPLES = 7, 2
PLACES = (np.arange(PIECES * SAMPLES) + 0.5) / SAMPLES


def motion(name: str, spread: float) -> tuple[ConstrainedFrames, BSpline, KeptSamples]:
    """A motion about a random configuration, and where its six constraints are looked at."""
    rng = np.random.default_rng(3)
    frames = random_frames(name, rng)
    z = frames.group.chart(frames.group.random(rng))
    points = z + spread * rng.normal(size=(PIECES + 3, len(z)))
    ends = End.at_rest(points[0]), End.at_rest(points[-1])
    spline = BSpline.between(*ends, points[3:-3], 0.1)
    return frames, spline, constraint_samples(Sections.whole(frames), spline.pieces, (), 1)


def of(kept: KeptSamples, points: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
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


def looked_at(frames: ConstrainedFrames, spline: BSpline) -> tuple[np.ndarray, np.ndarray]:
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
def test_the_penalty_is_the_formula_by_pinocchio(name: str) -> None:
    frames, spline, kept = motion(name, 0.2)
    shares, _ = looked_at(frames, spline)
    beyond = np.maximum(shares - CONSTRAINT_ROOM, 0.0)
    expected = 0.5 * CONSTRAINT_WEIGHT / len(PLACES) * (beyond**2).sum()
    assert expected > 0.0
    assert constraint_penalty(kept, spline.points) == pytest.approx(expected, rel=1e-9)
    assert of(kept, spline.points)[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("name", ["panda", "slide oblique screw x"])
def test_the_gradient_is_that_of_finite_differences(name: str) -> None:
    _, spline, kept = motion(name, 0.05)
    _, gradient, _ = of(kept, spline.points)
    h = 1e-6
    for along in np.random.default_rng(1).normal(size=(4, *spline.points.shape)):
        ahead, behind = (constraint_penalty(kept, spline.points + by * along) for by in (h, -h))
        scale = np.abs(gradient * along).sum()
        assert (ahead - behind) / (2.0 * h) == pytest.approx((gradient * along).sum(), abs=1e-5 * scale)
