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
