"""Bounds of segments of motions, against the blossoms of their pieces."""

import numpy as np
import pytest

from guidefield.kernels.prove.placement import MOST_ORDER, bound_segment, write_point
from guidefield.kernels.prove.tables import BezierCurve
from guidefield.prove.curve import Curve, restrict_curves

PIECES, NV = 6, 4


def curve_of(order: int) -> BezierCurve:
    rng = np.random.default_rng(order)
    controls = rng.normal(size=(PIECES, order, NV))
    controls[1:, 0] = controls[:-1, -1]
    times = np.cumsum(np.r_[0.0, rng.uniform(0.1, 1.0, PIECES)])
    return BezierCurve(times, times + 0.3, controls, rng.uniform(0.0, 0.1, (PIECES, NV)))


@pytest.mark.parametrize("order", [2, 4, MOST_ORDER])
def test_a_motion_is_where_its_curves_are(order: int) -> None:
    curve, found = curve_of(order), np.empty(NV)
    for time in np.r_[curve.times, np.random.default_rng(1).uniform(0.0, curve.times[-1], 20)]:
        write_point(curve, time, np.empty(MOST_ORDER), found)
        wanted = Curve(curve.positions, curve.times).at(np.array([time]))[0]
        np.testing.assert_allclose(found, wanted, atol=1e-13)


@pytest.mark.parametrize("timed", [False, True])
@pytest.mark.parametrize("order", [2, 4, MOST_ORDER])
def test_how_far_a_motion_goes_is_how_far_the_control_points_of_its_parts_are(order: int, timed: bool) -> None:
    curve, rng = curve_of(order), np.random.default_rng(2)
    for _ in range(30):
        since, until = np.sort(rng.uniform(0.0, curve.times[-1], 2))
        middle, (straight, farthest, aside, tube) = rng.normal(size=NV), np.empty((4, NV))
        scratch = np.empty(MOST_ORDER), np.empty((2, MOST_ORDER, NV))
        now = 0.3 + rng.uniform(since, until)
        share = bound_segment(curve, since, until, now, timed, middle, *scratch, straight, farthest, aside, tube)
        low, high = (np.clip((t - curve.times[:-1]) / np.diff(curve.times), 0.0, 1.0) for t in (since, until))
        met = high > low
        controls = restrict_curves(curve.positions[met], low[met], high[met])
        x, D = controls.reshape(-1, NV) - middle, controls[-1, -1] - controls[0, 0]
        along = x @ D / (D @ D)
        if timed:  # in each piece the time goes on evenly
            begins, ends = np.maximum(curve.times[:-1][met], since), np.minimum(curve.times[1:][met], until)
            times = np.array([np.linspace(*ends_of, order) for ends_of in zip(begins, ends, strict=True)])
            along = (times.ravel() + 0.3 - now) / (until - since)
        np.testing.assert_allclose(straight, D, atol=1e-12)
        beside = np.repeat(curve.tube[met], order, axis=0)
        np.testing.assert_allclose(farthest, (np.abs(x) + beside).max(axis=0), atol=1e-12)
        np.testing.assert_allclose(aside, (np.abs(x - along[:, None] * D) + beside).max(axis=0), atol=1e-12)
        np.testing.assert_allclose(tube, curve.tube[met].max(axis=0))
        assert share == pytest.approx(np.abs(along).max(), rel=1e-9)
