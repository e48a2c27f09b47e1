"""The penalty of torques: its value by Pinocchio, and its derivatives by differences of the value."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest

from guidefield.kernels.optimize.effort_penalty import effort_penalty, effort_value
from guidefield.planner.motion.bspline import basis, basis_bends, basis_slopes
from guidefield.planner.task.effort import tree_of
from tests.robots import group

SAMPLES, WEIGHT, SHARE, STEP = 2, 50.0, 0.8, 0.4
ARM = group("panda")
LIMITS = np.array([2.0, 20.0, 4.0, 10.0, 0.5, 1.0, np.inf])


class Added(NamedTuple):
    value: float
    places: int
    gradient: np.ndarray
    pieces: np.ndarray
    basis: np.ndarray
    hessians: np.ndarray
    by_times: np.ndarray
    corner: np.ndarray


def add(points: np.ndarray, step: float = STEP) -> Added:
    tree, (n, nv) = tree_of(ARM), points.shape
    assert not isinstance(tree, str)
    places = 2 * SAMPLES * (n - 3)
    out = np.zeros((n, nv)), np.zeros(places, np.int64), np.zeros((places, 4)), np.zeros((places, nv, nv))
    border, by_times, corner = np.zeros((2, n, nv)), np.zeros(2), np.zeros((2, 2))
    found = effort_penalty(tree, LIMITS, points, step, SAMPLES, WEIGHT, SHARE, 0, *out, border, by_times, corner)
    return Added(*found, *out, by_times, corner)


def some_points(seed: int = 3) -> np.ndarray:
    steps = np.random.default_rng(seed).normal(0.0, 0.06, (10, ARM.nv))
    return np.ascontiguousarray(ARM.robot.rest[: ARM.nv] + np.cumsum(steps, axis=0))


def test_the_value_is_of_what_pinocchios_torques_are_beyond() -> None:
    points, total, data = some_points(), 0.0, ARM.model.createData()
    shares = (np.arange(SAMPLES) + 0.5) / SAMPLES
    for piece in range(len(points) - 3):
        about = points[piece : piece + 4]
        rows = basis(shares) @ about, basis_slopes(shares) @ about / STEP, basis_bends(shares) @ about / STEP**2
        for z, dz, ddz in zip(*rows, strict=True):
            beyond = np.abs(pin.rnea(ARM.model, data, z, dz, ddz)) / LIMITS - SHARE
            total += 0.5 * WEIGHT * float((np.maximum(beyond, 0.0) ** 2).sum()) / (SAMPLES * (len(points) - 3))
    tree = tree_of(ARM)
    assert not isinstance(tree, str)
    assert add(points).value == pytest.approx(total)
    assert effort_value(tree, LIMITS, points, STEP, SAMPLES, WEIGHT, SHARE) == pytest.approx(total)
    assert total > 0.1


@pytest.mark.parametrize("step", [STEP, 2.0])
def test_its_gradient_is_that_of_its_value(step) -> None:
    points, by = some_points(), 1e-6
    found = add(points, step)
    for point, joint in ((0, 1), (4, 1), (5, 3), (9, 5)):
        moved = points.copy()
        moved[point, joint] += by
        slope = (add(moved, step).value - found.value) / by
        assert found.gradient[point, joint] == pytest.approx(slope, rel=1e-3, abs=1e-3)
    longer = (add(points, step * np.exp(by)).value - found.value) / by
    assert found.by_times[0] == pytest.approx(longer, rel=1e-3, abs=1e-5)


def test_its_hessian_is_not_negative_and_of_the_places_alone() -> None:
    found = add(some_points())
    assert 0 < found.places <= len(found.pieces)
    assert found.places % 2 == 0
    assert (np.linalg.eigvalsh(found.hessians[: found.places]) > -1e-9).all()
    assert (found.hessians[found.places :] == 0.0).all()
    assert found.corner[0, 0] > 0.0
    assert (np.diff(found.pieces[: found.places]) >= 0).all()
