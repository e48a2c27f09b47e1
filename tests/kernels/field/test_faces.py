"""Triangles and quadrilaterals against the high-precision oracle, laws of the field, forms for flat and steep faces."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from numba import njit

from guidefield.geometry import surfaces
from guidefield.geometry.charged import convex_quads
from guidefield.kernels.field.box import FAR
from guidefield.kernels.field.faces import FLAT, flat_pair, single_field, steep_pair
from guidefield.kernels.simd.vector import load, store
from tests.kernels.evaluation import field, gradient_by_differences, rigid_motions, triangles, vectors
from tests.oracles import (
    EPS,
    PolygonCase,
    SolidCase,
    distance_to_triangle,
    edge_sum_potential,
    fan,
    polygon_cases,
    solid_cases,
)

# What an ulp in a corner changes is about EPS * K, K = farthest corner over distance; see oracle/README.md.
POTENTIAL_ULPS = 8
GRADIENT_ULPS = 16

laws = settings(max_examples=18)

MESHES = [case for case in solid_cases() if case.kind == "mesh"]


def condition(point: np.ndarray, corners: np.ndarray) -> float:
    corners = corners.reshape(-1, 3, 3)
    extent = np.linalg.norm(corners - point, axis=2).max()
    return float(extent / min(distance_to_triangle(point, triangle) for triangle in corners))


@pytest.mark.parametrize("case", polygon_cases(), ids=lambda case: case.name)
def test_polygon_agrees_with_the_high_precision_oracle(case: PolygonCase) -> None:
    at = field(case.point, case.triangles)
    assert abs(at.potential - case.potential) <= POTENTIAL_ULPS * EPS * case.condition * case.potential
    error = np.linalg.norm(at.gradient - case.gradient)
    assert error <= GRADIENT_ULPS * EPS * case.condition * np.linalg.norm(case.gradient)
    assert -4.0 * math.pi * at.winding == pytest.approx(case.solid_angle, rel=8 * EPS * case.condition, abs=8 * EPS)


@pytest.mark.parametrize("case", MESHES, ids=lambda case: case.name)
def test_closed_mesh_agrees_with_the_high_precision_oracle(case: SolidCase) -> None:
    at = field(case.point, case.shape["triangles"])
    K = condition(case.point, case.shape["triangles"])
    assert abs(at.potential - case.potential) <= POTENTIAL_ULPS * EPS * K * case.potential
    # Faces on opposite sides cancel: the scale of the gradient is 3 Phi / distance at most.
    distance = min(distance_to_triangle(case.point, triangle) for triangle in case.shape["triangles"])
    assert np.linalg.norm(at.gradient - case.gradient) <= GRADIENT_ULPS * EPS * K * 3.0 * case.potential / distance
    assert at.winding == pytest.approx(case.winding, abs=1e-14)


@laws
@given(triangles, vectors(2.0))
def test_agrees_with_the_edge_sum(corners: np.ndarray, point: np.ndarray) -> None:
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    assume(abs(normal @ (point - corners[0])) > 0.05 * np.linalg.norm(normal))
    assert field(point, corners[None]).potential == pytest.approx(edge_sum_potential(point, corners), rel=1e-11)


@laws
@given(triangles, vectors(2.0))
def test_gradient_is_the_derivative_of_the_potential(corners: np.ndarray, point: np.ndarray) -> None:
    distance = distance_to_triangle(point, corners)
    assume(distance > 0.01)
    at = field(point, corners[None])
    differences = gradient_by_differences(point, 1e-3 * distance, triangles=corners[None])
    assert differences == pytest.approx(at.gradient, rel=0.0, abs=1e-8 * at.potential / distance)


@laws
@given(triangles, vectors(2.0))
def test_curvature_is_the_derivative_with_the_height_at_constant_denominator(corners, point):
    # Phi = (2/h) atan2(4 A h, F): the classical F, differentiated numerically in h alone.
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    area = 0.5 * float(np.linalg.norm(normal))
    normal /= 2.0 * area
    h = abs(float(normal @ (point - corners[0])))
    assume(h > 0.05)
    l1, l2, l3 = np.linalg.norm(corners - point, axis=1)
    L1, L2, L3 = (np.linalg.norm(corners[(i + 2) % 3] - corners[(i + 1) % 3]) for i in range(3))
    F = (l1 + l2) * (l2 + l3) * (l3 + l1) - L1**2 * l1 - L2**2 * l2 - L3**2 * l3

    def phi(height: float) -> float:
        return 2.0 / height * math.atan2(4.0 * area * height, F)

    step = 1e-3 * h
    slope = (8.0 * (phi(h + step) - phi(h - step)) - phi(h + 2 * step) + phi(h - 2 * step)) / (12.0 * step)
    at = field(point, corners[None])
    assert at.curvature == pytest.approx(-2.0 * slope / h, rel=1e-6, abs=1e-8 * at.potential / h**2)


@laws
@given(triangles, vectors(2.0), st.floats(-1e-9, 1e-9))
def test_curvature_is_never_negative(corners: np.ndarray, point: np.ndarray, height: float) -> None:
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    in_plane = point - normal * (normal @ (point - corners[0]))
    for p in (point, in_plane, in_plane + height * normal, corners[0], corners.mean(axis=0)):
        curvature = field(p, corners[None]).curvature
        assert curvature >= 0.0
        assert math.isfinite(curvature)


@laws
@given(triangles, vectors(2.0), st.floats(0.1, 0.9), st.floats(0.1, 0.9))
def test_splitting_changes_nothing(corners: np.ndarray, point: np.ndarray, s: float, t: float) -> None:
    assume(distance_to_triangle(point, corners) > 0.05)
    a, b, c = corners
    inside = a + s * (1.0 - t) * (b - a) + t * (c - a) * (1.0 - s)
    on_edge = a + s * (b - a)
    whole = field(point, corners[None])
    for parts in ([[a, b, inside], [b, c, inside], [c, a, inside]], [[a, on_edge, c], [on_edge, b, c]]):
        split = field(point, np.array(parts))
        assert split.potential == pytest.approx(whole.potential, rel=1e-12)
        assert split.gradient == pytest.approx(whole.gradient, rel=0.0, abs=1e-11 * np.linalg.norm(whole.gradient))
        assert split.winding == pytest.approx(whole.winding, abs=1e-14)


@laws
@given(st.lists(st.tuples(triangles, st.just(0.0) | st.floats(1e-6, 5.0)), min_size=1, max_size=20), vectors(2.0))
def test_superposition(charged: list[tuple[np.ndarray, float]], point: np.ndarray) -> None:
    assume(all(distance_to_triangle(point, corners) > 0.01 for corners, _ in charged))
    singles = [field(point, corners[None]) for corners, _ in charged]
    charges = np.array([charge for _, charge in charged])
    together = field(point, np.array([corners for corners, _ in charged]), triangle_charge=charges)
    assert together.potential == pytest.approx(charges @ [at.potential for at in singles], rel=1e-12)
    scale = charges @ [np.linalg.norm(at.gradient) for at in singles]
    assert together.gradient == pytest.approx(charges @ [at.gradient for at in singles], rel=0.0, abs=1e-12 * scale)
    assert together.curvature == pytest.approx(charges @ [at.curvature for at in singles], rel=1e-12)
    assert together.winding == pytest.approx(sum(at.winding for at in singles), abs=1e-13)


@laws
@given(triangles, vectors(2.0), st.floats(-6.0, 6.0).map(lambda exponent: 10.0**exponent))
def test_scaling(corners: np.ndarray, point: np.ndarray, size: float) -> None:
    assume(distance_to_triangle(point, corners) > 0.05)
    unit, scaled = field(point, corners[None]), field(size * point, size * corners[None])
    assert size * scaled.potential == pytest.approx(unit.potential, rel=1e-12)
    assert size**2 * scaled.gradient == pytest.approx(unit.gradient, rel=0.0, abs=1e-12 * np.linalg.norm(unit.gradient))
    assert size**3 * scaled.curvature == pytest.approx(unit.curvature, rel=1e-9)
    assert scaled.winding == pytest.approx(unit.winding, abs=1e-13)


@laws
@given(triangles, vectors(2.0), rigid_motions())
def test_rigid_motion(corners: np.ndarray, point: np.ndarray, motion: tuple[np.ndarray, np.ndarray]) -> None:
    assume(distance_to_triangle(point, corners) > 0.05)
    rotation, translation = motion
    here = field(point, corners[None])
    there = field(rotation @ point + translation, (corners @ rotation.T + translation)[None])
    assert there.potential == pytest.approx(here.potential, rel=1e-12)
    scale = float(np.linalg.norm(here.gradient))
    assert there.gradient == pytest.approx(rotation @ here.gradient, rel=0.0, abs=1e-11 * scale)
    assert there.curvature == pytest.approx(here.curvature, rel=1e-9)
    assert there.winding == pytest.approx(here.winding, abs=1e-13)


@laws
@given(triangles, vectors(2.0))
def test_mirror_image_in_its_plane(corners: np.ndarray, point: np.ndarray) -> None:
    corners[:, 2] = 0.0
    assume(np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0])) > 0.05)
    assume(distance_to_triangle(point, corners) > 1e-3)
    above, below = field(point, corners[None]), field(point * [1, 1, -1], corners[None])
    assert below.potential == above.potential > 0.0
    assert (below.gradient == above.gradient * [1, 1, -1]).all()
    assert below.curvature == above.curvature
    assert below.winding == -above.winding


def _near_places(
    corners: np.ndarray, up: np.ndarray, out: np.ndarray, angle: float
) -> list[tuple[np.ndarray, np.ndarray, float]]:
    """Where a triangle is near: the place on it, the way off it, and the potential times the distance there.

    Args:
        corners: The triangle, shape (3, 3).
        up: Off its plane, shape (3,).
        out: In its plane, off its first edge, shape (3,).
        angle: At its first corner [rad].
    """
    a, b, _ = corners
    middle = 0.5 * (a + b)
    centroid = corners.mean(axis=0)
    return [(centroid, up, 2.0 * math.pi), (middle, up, math.pi), (a, up, angle), (middle, out, 2.0)]


@laws
@given(triangles, st.floats(-6.0, -3.0))
def test_near_law_of_any_triangle(corners: np.ndarray, exponent: float) -> None:
    a, b, c = corners
    normal = np.cross(b - a, c - a)
    twice_area = float(np.linalg.norm(normal))
    longest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max())
    room = twice_area / longest / 6.0  # around each place the face goes on at least so far, but for its own edges
    distance = 10.0**exponent * room
    up = distance * normal / twice_area
    out = np.cross(b - a, up) / np.linalg.norm(b - a)
    angle = math.atan2(twice_area, float((b - a) @ (c - a)))
    rounding = 256 * EPS * (longest + float(np.abs(corners).max())) / distance
    for nearest, away, strength in _near_places(corners, up, out, angle):
        at = field(nearest + away, corners[None])
        assert at.potential * distance == pytest.approx(strength, rel=4.0 * distance / room + rounding)
        assert -at.gradient @ away * distance == pytest.approx(strength, rel=4.0 * distance / room + 2.0 * rounding)


@laws
@given(triangles, vectors(1.0).filter(lambda v: np.linalg.norm(v) > 0.1), st.floats(1.0, 5.0))
def test_far_law(corners: np.ndarray, direction: np.ndarray, exponent: float) -> None:
    r = 10.0**exponent
    direction /= np.linalg.norm(direction)
    at = field(corners.mean(axis=0) + r * direction, corners[None])
    area = 0.5 * np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    assert at.potential == pytest.approx(area / r**3, rel=30.0 / r**2 + 1e-12)
    assert at.gradient == pytest.approx(
        -3.0 * area / r**4 * direction, rel=0.0, abs=3.0 * area / r**4 * (60.0 / r**2 + 1e-12)
    )


CONVEX = [case for case in polygon_cases() if len(case.vertices) > 3 and "nonconvex" not in case.tags]


@st.composite
def convex_quads_in_space(draw: st.DrawFn) -> np.ndarray:
    """A flat convex quadrilateral of ordinary proportions, shape (4, 3)."""
    angles = [draw(st.floats(k + 0.1, k + 0.9)) * 0.5 * np.pi for k in range(4)]
    rotation, translation = draw(rigid_motions())
    stretch = draw(st.floats(0.2, 1.0))
    return np.array([(np.cos(a), stretch * np.sin(a), 0.0) for a in angles]) @ rotation.T + translation


@pytest.mark.parametrize("case", CONVEX, ids=lambda case: case.name)
def test_polygons_agree_with_the_high_precision_oracle(case: PolygonCase) -> None:
    quads, rest = convex_quads(case.vertices)
    at = field(case.point, rest, quads=quads)
    assert abs(at.potential - case.potential) <= 8 * EPS * case.condition * case.potential
    assert np.linalg.norm(at.gradient - case.gradient) <= 16 * EPS * case.condition * np.linalg.norm(case.gradient)
    assert -4.0 * np.pi * at.winding == pytest.approx(case.solid_angle, rel=8 * EPS * case.condition, abs=8 * EPS)


@laws
@given(convex_quads_in_space(), vectors(2.0))
def test_a_quad_agrees_with_its_two_triangles(corners: np.ndarray, point: np.ndarray) -> None:
    assume(min(distance_to_triangle(point, triangle) for triangle in fan(corners)) > 0.01)
    one, two = field(point, quads=corners[None]), field(point, fan(corners))
    assert one.potential == pytest.approx(two.potential, rel=1e-12)
    steep = float(np.linalg.norm(two.gradient))
    assert one.gradient == pytest.approx(two.gradient, rel=0.0, abs=1e-11 * steep)
    assert one.curvature == pytest.approx(two.curvature, rel=1e-9, abs=1e-12 * two.potential**3)
    assert one.curvature >= 0.0
    assert one.winding == pytest.approx(two.winding, abs=1e-14)


@laws
@given(vectors(1.5))
def test_a_prism_of_quads_is_the_prism_of_triangles(point: np.ndarray) -> None:
    prism = surfaces.cylinder(0.3, 0.8)
    near = min(distance_to_triangle(point, corners) for corners in prism.corners)
    assume(near > 1e-4)
    quads, mesh = field(point, quads=surfaces.prism_quads(0.3, 0.8)), field(point, prism.corners)
    assert quads.potential == pytest.approx(mesh.potential, rel=1e-14 / near)
    assert quads.gradient == pytest.approx(mesh.gradient, rel=0.0, abs=1e-13 * mesh.potential / near**2)
    assert quads.winding == pytest.approx(mesh.winding, abs=1e-12)


solid_angle_laws = settings(max_examples=30)
LANES = 16  # as many as any precision has

solid_angles = st.lists(st.floats(0.02, 3.0), min_size=LANES, max_size=LANES).map(np.array)
flat_angles = st.lists(st.floats(0.02, np.pi / 16 - 1e-6), min_size=LANES, max_size=LANES).map(np.array)
heights = st.floats(-3.0, 1.0).map(lambda exponent: 10.0**exponent)


@njit
def one_triangle(h: Any, F: Any, row: Any, out: Any) -> None:
    for k, lanes in enumerate(single_field(load(h, 0), load(F, 0), row[0], row[1], row[2])):
        store(out[k], 0, lanes)


@njit
def two_triangles(h: Any, F: Any, row: Any, flat: Any, steep: Any) -> None:
    height, F1, F2 = load(h, 0), load(F[0], 0), load(F[1], 0)
    for k, lanes in enumerate(flat_pair(height * height, F1, F2, row[0], row[1])):
        store(flat[k], 0, lanes)
    for k, lanes in enumerate(steep_pair(height, F1, F2, row[0], row[1])):
        store(steep[k], 0, lanes)


def exactly(h: Any, F: Any, a: Any) -> tuple[Any, Any, Any]:
    """Phi, curvature and slope of a triangle in extended precision."""
    h, F, a = (np.asarray(value, np.longdouble) for value in (h, F, a))
    phi = 2 / h * np.arctan2(a * h, F)
    N = F * F + a * a * h * h
    return phi, 2 * (phi - 2 * a * F / N) / h**2, 2 * a / N


@pytest.mark.skipif(np.finfo(np.longdouble).eps == EPS, reason="this machine has no extended precision")
@pytest.mark.parametrize("kind", [np.float64, np.float32])
@pytest.mark.parametrize("drawn", ["all flat", "mixed"])
def test_triangles(kind: type, drawn: str) -> None:
    @solid_angle_laws
    @given(flat_angles if drawn == "all flat" else solid_angles, heights)
    def agree(half: np.ndarray, h: float) -> None:
        a = kind(0.3)
        at = np.full(LANES, h, kind)
        F = (a * h / np.tan(half)).astype(kind)
        ours = np.empty((3, LANES), kind)
        step = 8 if kind == np.float64 else 16
        for i in range(0, LANES, step):
            one_triangle(at[i:], F[i:], np.array([a, a * a, a * FLAT], kind), ours[:, i:])
        eps = float(np.finfo(kind).eps)
        phi, curvature, slope = exactly(at, F, a)
        assert np.abs(ours[0] / phi - 1).max() < 4 * eps
        assert np.abs(ours[2] / slope - 1).max() < 6 * eps
        # What cancels in the curvature is of the size of Phi/h^2, but for flat faces of F's.
        scale = curvature + phi / np.asarray(at, np.longdouble) ** 2 * np.where(half < np.pi / 16, half**2, 1)
        assert np.abs((ours[1] - curvature) / scale).max() < 16 * eps

    agree()


@solid_angle_laws
@given(st.lists(st.floats(1e-6, np.pi / 16 - 1e-6), min_size=16, max_size=16), heights)
def test_flat_and_steep_forms_of_pairs_agree(halves: list[float], h: float) -> None:
    row = np.array([0.3, 0.2])
    F = row[:, None] * h / np.tan(np.array(halves).reshape(2, 8))
    flat, steep = np.empty((2, 4, 8))
    two_triangles(np.full(8, h), F, row, flat, steep)
    assert flat == pytest.approx(steep, rel=1e-12)


@solid_angle_laws
@given(st.tuples(*[st.floats(0.02, 1.0)] * 3).map(np.array), vectors(1.0).filter(lambda v: np.linalg.norm(v) > 0.1))
def test_faces_of_a_far_box_are_flat(size: np.ndarray, direction: np.ndarray) -> None:
    point = FAR * 0.5 * np.linalg.norm(size) * direction / np.linalg.norm(direction)
    box = surfaces.box(tuple(size))
    for k in range(6):
        face = box.corners[2 * k : 2 * k + 2]
        assert 2.0 * np.pi * abs(field(point, face).winding) < np.pi / 8
