"""Boxes against the same boxes as triangles, and against the high-precision oracle."""

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from guidefield.geometry import surfaces
from tests.kernels.evaluation import Field, field, rigid_motions, vectors
from tests.oracles import EPS, SolidCase, distance_to_triangle, solid_cases

laws = settings(deadline=None, max_examples=18)

sizes = st.tuples(*[st.floats(0.02, 1.5)] * 3).map(np.array)

BOXES = [case for case in solid_cases() if case.name.startswith("box_")]


def row(size: np.ndarray, rotation: np.ndarray | None = None, centre: np.ndarray | None = None) -> np.ndarray:
    axes = np.eye(3) if rotation is None else rotation.T
    return np.r_[np.zeros(3) if centre is None else centre, axes.ravel(), size, 1.0]


def as_box(point: np.ndarray, size: np.ndarray) -> Field:
    return field(point, boxes=[row(size)])


def halves(size: np.ndarray) -> np.ndarray:
    """The triangles of a box cut along the diagonals that join corners on opposite sides, as the kernel does."""
    corners = []
    for axis in range(3):
        u, v = (k for k in range(3) if k != axis)
        for side in (-1.0, 1.0):
            for turn in (-1.0, 1.0):
                triangle = np.zeros((3, 3))
                triangle[:, axis] = side
                triangle[:, u], triangle[:, v] = (turn, -turn, turn), (turn, turn, -turn)
                out = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])[axis] * side
                corners.append(triangle if out > 0.0 else triangle[::-1])
    return np.array(corners) * 0.5 * size


def distance(point: np.ndarray, size: np.ndarray) -> float:
    return min(distance_to_triangle(point, corners) for corners in surfaces.box(size).corners)


@pytest.mark.parametrize("case", BOXES, ids=lambda case: case.name)
def test_agrees_with_the_high_precision_oracle(case: SolidCase) -> None:
    corners = case.shape["triangles"].reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    at = field(case.point, boxes=[row(high - low, None, 0.5 * (low + high))])
    near = min(distance_to_triangle(case.point, triangle) for triangle in case.shape["triangles"])
    K = float(np.linalg.norm(corners - case.point, axis=1).max()) / near
    assert abs(at.potential - case.potential) <= 8 * EPS * K * case.potential
    assert np.linalg.norm(at.gradient - case.gradient) <= 16 * EPS * K * 3.0 * case.potential / near
    assert at.winding == case.winding


@laws
@given(sizes, vectors(2.0))
def test_agrees_with_its_triangles(size: np.ndarray, point: np.ndarray) -> None:
    near = distance(point, size)
    assume(near > 1e-6)
    box, mesh = as_box(point, size), field(point, halves(size))
    K = (np.linalg.norm(point) + np.linalg.norm(size)) / near
    assert box.potential == pytest.approx(mesh.potential, rel=16 * EPS * K)
    assert box.gradient == pytest.approx(mesh.gradient, rel=0.0, abs=48 * EPS * K * mesh.potential / near)
    assert box.curvature == pytest.approx(mesh.curvature, rel=64 * EPS * K + 1e-12, abs=64 * EPS * mesh.potential**3)
    assert box.winding == pytest.approx(mesh.winding, abs=1e-12)


@laws
@given(sizes, vectors(2.0), rigid_motions(), st.floats(-3.0, 3.0).map(lambda e: 10.0**e))
def test_motion_and_scaling(
    size: np.ndarray, point: np.ndarray, motion: tuple[np.ndarray, np.ndarray], scale: float
) -> None:
    near = distance(point, size)
    assume(near > 0.05)
    rotation, translation = motion
    here = as_box(point, size)
    there = field(scale * (rotation @ point + translation), boxes=[row(scale * size, rotation, scale * translation)])
    steep = here.potential / near
    assert scale * there.potential == pytest.approx(here.potential, rel=1e-11)
    assert scale**2 * there.gradient == pytest.approx(rotation @ here.gradient, rel=0.0, abs=1e-10 * steep)
    assert scale**3 * there.curvature == pytest.approx(here.curvature, rel=1e-8)
    assert there.winding == here.winding
