"""Boxes, spheres, capsules and planes against the high-precision oracle, and against what each is a limit of."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from guidefield.geometry import surfaces
from guidefield.kernels.field.box import CAPSULE_SHELL, capsule_at
from tests.kernels.evaluation import Field, field, gradient_by_differences, rigid_motions, vectors
from tests.kernels.parts import from_python
from tests.oracles import EPS, SolidCase, distance_to_segment, distance_to_triangle, solid_cases

laws = settings(max_examples=18)

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
def test_motion_and_scaling(size, point, motion, scale):
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


capsule_field = from_python(capsule_at)


SPHERES = [case for case in solid_cases() if case.kind == "sphere"]
CAPSULES = [case for case in solid_cases() if case.kind == "capsule_surrogate"]

CENTRE = np.array([0.1, -0.2, 0.3])
RADIUS = 0.4


def sphere(point: np.ndarray, radius: float = RADIUS, charge: float = 1.0) -> Field:
    return field(point, spheres=[[*CENTRE, radius, charge]])


def capsule(point: np.ndarray, p0: np.ndarray, p1: np.ndarray, radius: float) -> tuple[float, np.ndarray]:
    potential, *gradient = capsule_field(*map(float, (*point, *p0, *p1, radius)))
    return potential, np.array(gradient)


@pytest.mark.parametrize("case", SPHERES, ids=lambda case: case.name)
def test_sphere_agrees_with_the_high_precision_oracle(case: SolidCase) -> None:
    radius = case.shape["radius"]
    at = field(case.point, spheres=[[*case.shape["center"], radius, 1.0]])
    # The point's distance from the surface is known to EPS times its distance from the centre.
    r = float(np.linalg.norm(case.point - case.shape["center"]))
    K = (r + radius) / abs(r - radius)
    assert at.potential == pytest.approx(case.potential, rel=8 * EPS * K)
    assert np.linalg.norm(at.gradient - case.gradient) <= 16 * EPS * K * np.linalg.norm(case.gradient)
    assert at.winding == case.winding


@pytest.mark.parametrize("case", CAPSULES, ids=lambda case: case.name)
def test_capsule_agrees_with_the_high_precision_oracle(case: SolidCase) -> None:
    p0, p1, radius = np.array(case.shape["p0"]), np.array(case.shape["p1"]), case.shape["radius"]
    K = 1.0 + np.linalg.norm(case.point) / (distance_to_segment(case.point, p0, p1) - radius)
    potential, gradient = capsule(case.point, p0, p1, radius)
    assert potential == pytest.approx(case.potential, rel=8 * EPS * K)
    assert np.linalg.norm(gradient - case.gradient) <= 16 * EPS * K * np.linalg.norm(case.gradient)
    obstacle = field(case.point, capsules=[[*p0, *p1, radius, 2.5]])
    assert obstacle.potential == pytest.approx(2.5 * potential, rel=1e-12)
    assert obstacle.gradient == pytest.approx(2.5 * gradient, rel=1e-12)
    assert obstacle.winding == 0.0


@laws
@given(vectors(2.0))
def test_sphere_gradient_and_curvature_are_derivatives(point: np.ndarray) -> None:
    r = float(np.linalg.norm(point - CENTRE))
    gap = abs(r - RADIUS)
    assume(gap > 0.02 and r > 0.02)
    at = sphere(point)
    differences = gradient_by_differences(point, 1e-3 * gap, spheres=[[*CENTRE, RADIUS, 1.0]])
    assert differences == pytest.approx(at.gradient, rel=0.0, abs=1e-8 * at.potential / gap)
    outward = (point - CENTRE) / r
    step = 1e-4 * gap
    ahead, behind = sphere(point + step * outward).gradient, sphere(point - step * outward).gradient
    assert at.curvature == pytest.approx((ahead - behind) @ outward / (2.0 * step), rel=1e-5)
    assert at.curvature > 0.0


@laws
@given(vectors(3.0), st.floats(0.1, 5.0))
def test_plane_is_what_a_large_square_tends_to(point: np.ndarray, charge: float) -> None:
    normal = np.array([2.0, -1.0, 2.0]) / 3.0
    height = float(normal @ point - 0.25)
    assume(abs(height) > 0.01)
    at = field(point, planes=[[*normal, 0.25, charge]])
    assert at.potential == pytest.approx(charge * 2.0 * math.pi / abs(height), rel=1e-12)
    first = np.array([1.0, 2.0, 0.0]) / math.sqrt(5.0)
    axes = 1e4 * np.array([first, np.cross(normal, first)])
    a, b, c, d = 0.25 * normal - axes[0] - axes[1], axes[0] - axes[1], axes[0] + axes[1], axes[1] - axes[0]
    square = np.array([a, 0.25 * normal + b, 0.25 * normal + c, 0.25 * normal + d])
    large = field(point, np.array([square[[0, 1, 2]], square[[0, 2, 3]]]), triangle_charge=[charge, charge])
    assert at.potential == pytest.approx(large.potential, rel=2e-3)
    assert at.gradient == pytest.approx(large.gradient, rel=0.0, abs=1e-5 * np.linalg.norm(at.gradient))
    assert at.curvature == pytest.approx(large.curvature, rel=1e-3)
    assert at.winding == (1.0 if height < 0.0 else 0.0)


@laws
@given(vectors(2.0), vectors(1.0), vectors(1.0), st.floats(0.05, 0.5))
def test_capsule_gradient_is_the_derivative(point: np.ndarray, p0: np.ndarray, p1: np.ndarray, radius: float) -> None:
    gap = distance_to_segment(point, p0, p1) - radius
    assume(gap > 0.05 * radius)
    potential, gradient = capsule(point, p0, p1, radius)
    differences = gradient_by_differences(point, 1e-3 * gap, capsules=[[*p0, *p1, radius, 1.0]])
    assert differences == pytest.approx(gradient, rel=0.0, abs=1e-8 * potential / gap)


@laws
@given(vectors(2.0), vectors(1.0), vectors(1.0), st.floats(0.05, 0.5), rigid_motions(), st.floats(-4.0, 4.0))
def test_capsule_moves_turns_round_and_scales(point, p0, p1, radius, motion, exponent):
    assume(distance_to_segment(point, p0, p1) > 0.01)
    rotation, translation = motion
    size = 10.0**exponent
    potential, gradient = capsule(point, p0, p1, radius)
    scale = float(np.linalg.norm(gradient))
    moved = capsule(*(rotation @ p + translation for p in (point, p1, p0)), radius)
    assert moved[0] == pytest.approx(potential, rel=1e-11)
    assert moved[1] == pytest.approx(rotation @ gradient, rel=0.0, abs=1e-10 * scale)
    scaled = capsule(size * point, size * p0, size * p1, size * radius)
    assert size * scaled[0] == pytest.approx(potential, rel=1e-11)
    assert size**2 * scaled[1] == pytest.approx(gradient, rel=0.0, abs=1e-10 * scale)


@laws
@given(vectors(2.0), st.floats(0.05, 0.5))
def test_capsule_of_no_length_is_a_sphere(point: np.ndarray, radius: float) -> None:
    assume(np.linalg.norm(point - CENTRE) > (1.0 + CAPSULE_SHELL) * radius)
    potential, gradient = capsule(point, CENTRE, CENTRE, radius)
    exact = sphere(point, radius)
    assert potential == pytest.approx(exact.potential, rel=1e-12)
    assert gradient == pytest.approx(exact.gradient, rel=0.0, abs=1e-11 * np.linalg.norm(exact.gradient))


@laws
@given(vectors(1.0), vectors(1.0), vectors(1.0), st.floats(0.05, 0.5), st.floats(0.0, 1.0 + CAPSULE_SHELL))
def test_inside_the_shell_a_capsule_has_the_field_of_the_shell(p0, p1, direction, radius, share):
    length = float(np.linalg.norm(p1 - p0))
    assume(length > 1e-3 and share > 1e-3)
    across = np.cross(direction, p1 - p0)
    assume(np.linalg.norm(across) > 1e-3)
    across /= np.linalg.norm(across)
    outward_from_end = (p1 - p0) / length + across
    outward_from_end /= np.linalg.norm(outward_from_end)
    for foot, outward in ((0.5 * (p0 + p1), across), (p1, outward_from_end)):
        potential, gradient = capsule(foot + share * radius * outward, p0, p1, radius)
        on_shell = capsule(foot + (1.0 + CAPSULE_SHELL) * radius * outward, p0, p1, radius)
        # A ray from the axis is known to a last digit of its length.
        accuracy = 1e-11 / share
        assert potential == pytest.approx(on_shell[0], rel=accuracy)
        assert gradient == pytest.approx(on_shell[1], rel=0.0, abs=accuracy * np.linalg.norm(on_shell[1]))
        assert gradient @ outward < 0.0
