from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from tests.kernels.evaluation import field, rigid_motions, triangles, vectors
from tests.oracles import EPS, distance_to_triangle

laws = settings(deadline=None, max_examples=18)


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
@given(triangles, vectors(2.0))
def test_order_of_corners_changes_only_the_side(corners: np.ndarray, point: np.ndarray) -> None:
    assume(distance_to_triangle(point, corners) > 0.05)
    whole = field(point, corners[None])
    for turned in (np.roll(corners, 1, axis=0), np.roll(corners, 2, axis=0), corners[::-1]):
        other = field(point, turned[None])
        assert other.potential == pytest.approx(whole.potential, rel=1e-13)
        assert other.gradient == pytest.approx(whole.gradient, rel=0.0, abs=1e-12 * np.linalg.norm(whole.gradient))
        assert other.curvature == pytest.approx(whole.curvature, rel=1e-9)
    assert field(point, corners[::-1][None]).winding == pytest.approx(-whole.winding, abs=1e-14)


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


@pytest.mark.parametrize("distance", [1e-4, 1e-6, 1e-9])
def test_near_law(distance: float) -> None:
    corners = np.array([[0.0, 0.0, 0.0], [1.2, 0.0, 0.0], [0.3, 0.9, 0.0]])
    a, b, c = corners
    up = np.array([0.0, 0.0, distance])
    angle = math.acos((b - a) @ (c - a) / np.linalg.norm(b - a) / np.linalg.norm(c - a))
    out = np.array([0.0, -distance, 0.0])
    for nearest, away, strength in _near_places(corners, up, out, angle):
        at = field(nearest + away, corners[None])
        assert at.potential * distance == pytest.approx(strength, rel=20.0 * distance + 16 * EPS / distance)
        # The field is homogeneous of degree -1 about the nearest point.
        assert -at.gradient @ away * distance == pytest.approx(strength, rel=20.0 * distance + 32 * EPS / distance)
    above = field(corners.mean(axis=0) + up, corners[None])
    assert above.curvature * distance**3 == pytest.approx(4.0 * math.pi, rel=1e-3)


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


@laws
@given(triangles, vectors(2.0))
def test_bounds(corners: np.ndarray, point: np.ndarray) -> None:
    distance = distance_to_triangle(point, corners)
    assume(distance > 1e-3)
    at = field(point, corners[None])
    edges = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(edges, axis=1)
    twice_area = float(np.linalg.norm(np.cross(edges[0], edges[1])))
    assert at.potential <= min(2.0 * math.pi / distance, 0.5 * twice_area / distance**3) * (1.0 + 1e-12)
    w = 0.5 * twice_area / lengths.max()
    cosines = [-edges[i] @ edges[i - 1] / (lengths[i] * lengths[i - 1]) for i in range(3)]
    alpha = min(math.acos(cosine) for cosine in cosines)
    assert at.potential >= alpha * w**2 / (2.0 * distance * (distance + w) ** 2) * (1.0 - 1e-12)
    assert np.linalg.norm(at.gradient) <= 3.0 * at.potential / distance * (1.0 + 1e-12)


@laws
@given(triangles, vectors(2.0), vectors(1.0).filter(lambda v: np.linalg.norm(v) > 0.1), st.floats(0.0, 0.95))
def test_harnack(corners: np.ndarray, point: np.ndarray, direction: np.ndarray, share: float) -> None:
    distance = distance_to_triangle(point, corners)
    assume(distance > 1e-3)
    moved = point + share * distance * direction / np.linalg.norm(direction)
    before, after = field(point, corners[None]).potential, field(moved, corners[None]).potential
    assert before * (1.0 + share) ** -3 * (1.0 - 1e-11) <= after <= before * (1.0 - share) ** -3 * (1.0 + 1e-11)


@laws
@given(triangles, vectors(2.0))
def test_subharmonic(corners: np.ndarray, point: np.ndarray) -> None:
    # trace of the Hessian = -2 (n . grad)/h > 0: there is no local maximum.
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    height = float(normal @ (point - corners[0]))
    distance = distance_to_triangle(point, corners)
    assume(distance > 0.05 and abs(height) > 0.02)
    step = 1e-3 * distance
    at = field(point, corners[None])
    laplacian = sum(
        (field(point + e, corners[None]).gradient - field(point - e, corners[None]).gradient) @ e
        for e in step * np.eye(3)
    ) / (2.0 * step**2)
    expected = -2.0 * float(normal @ at.gradient) / height
    assert laplacian > 0.0
    assert laplacian == pytest.approx(expected, rel=1e-3, abs=1e-4 * at.potential / distance**2)
