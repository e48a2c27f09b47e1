import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from guidefield.geometry import surfaces
from guidefield.geometry.surfaces import Surface
from guidefield.scene.guide_plane import flat_polygons
from tests.geometry.measures import areas, is_closed, volume

laws = settings(deadline=None, max_examples=15)

lengths = st.floats(0.01, 10.0)

SHAPES = {
    "box": surfaces.box((0.4, 1.0, 0.6)),
    "cylinder": surfaces.cylinder(0.3, 1.2),
    "capsule": surfaces.capsule(0.3, 1.2),
    "sphere": surfaces.sphere(0.3),
    "coarse sphere": surfaces.sphere(0.3, subdivisions=0),
}


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_shapes_are_closed_and_turned_outwards(shape: Surface) -> None:
    assert is_closed(shape)
    assert volume(shape) > 0.0
    assert (areas(shape) > 0.0).all()
    # The shapes are convex about the origin: every triangle looks away from it.
    assert (np.linalg.det(shape.corners) > 0.0).all()
    assert len(shape.vertices) - len(shape.triangles) // 2 == 2


@laws
@given(lengths, lengths, lengths)
def test_box(x: float, y: float, z: float) -> None:
    box = surfaces.box((x, y, z))
    assert len(box.triangles) == 12
    assert areas(box).sum() == pytest.approx(2.0 * (x * y + y * z + z * x))
    assert volume(box) == pytest.approx(x * y * z)
    assert np.ptp(box.vertices, axis=0) == pytest.approx([x, y, z])


@laws
@given(lengths, lengths, st.integers(3, 40))
def test_prism_circumscribes_the_cylinder(radius: float, length: float, sides: int) -> None:
    prism = surfaces.cylinder(radius, length, sides)
    assert (np.abs(prism.vertices[:, 2]) == 0.5 * length).all()
    # Its base is the polygon of n sides about a circle.
    base = sides * radius**2 * math.tan(math.pi / sides)
    assert volume(prism) == pytest.approx(base * length)
    assert areas(prism).sum() == pytest.approx(2.0 * base + 2.0 * sides * radius * math.tan(math.pi / sides) * length)
    # The plane of no side comes nearer to the axis than the radius.
    a, b, c = prism.corners.transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sideways = np.abs(normals[:, 2]) < 0.5
    assert (np.einsum("ij,ij->i", normals, a)[sideways] >= radius * (1.0 - 1e-9)).all()


@laws
@given(lengths, lengths)
def test_capsule_has_its_vertices_on_the_capsule(radius: float, length: float) -> None:
    capsule = surfaces.capsule(radius, length)
    feet = np.clip(capsule.vertices[:, 2], -0.5 * length, 0.5 * length)
    offsets = capsule.vertices - np.column_stack([np.zeros((len(feet), 2)), feet])
    assert np.linalg.norm(offsets, axis=1) == pytest.approx(np.full(len(feet), radius))
    exact = math.pi * radius**2 * length + 4.0 / 3.0 * math.pi * radius**3
    assert 0.95 * exact < volume(capsule) < exact


@st.composite
def simple_polygons(draw: st.DrawFn) -> tuple[np.ndarray, float]:
    """Star-shaped polygons, mostly not convex, turned anyhow in space; and their area."""
    radii = np.array(draw(st.lists(st.floats(0.2, 1.0), min_size=3, max_size=20)))
    angles = 2.0 * np.pi * np.arange(len(radii)) / len(radii)
    area = 0.5 * math.sin(2.0 * np.pi / len(radii)) * float(radii @ np.roll(radii, -1))
    axes = np.array(draw(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6))).reshape(3, 2)
    assume(np.linalg.svd(axes, compute_uv=False)[1] > 0.1)
    frame = np.linalg.qr(axes)[0]
    flat = radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    return flat @ frame.T + draw(st.floats(-5.0, 5.0)), area


def triangulated(corners: np.ndarray) -> Surface:
    flat = flat_polygons(corners[None]).one(0)
    return surfaces.surface(corners, surfaces.triangulate_polygon(flat.corners, flat.area))


@laws
@given(simple_polygons())
def test_triangles_cover_a_polygon_once(drawn: tuple[np.ndarray, float]) -> None:
    corners, area = drawn
    result = triangulated(corners)
    assert (result.vertices == corners).all()
    assert areas(result).sum() == pytest.approx(area)
    # All turn as the polygon does, so that their area vectors add up to it, too.
    a, b, c = result.corners.transpose(1, 0, 2)
    assert np.linalg.norm(0.5 * np.cross(b - a, c - a).sum(axis=0)) == pytest.approx(area)
    arms = corners - corners[0]
    turn = np.cross(arms, np.roll(arms, -1, axis=0)).sum(axis=0)
    assert (np.cross(b - a, c - a) @ turn >= -1e-12).all()


def test_what_is_no_simple_polygon_is_refused() -> None:
    hourglass = np.array([[0, 0, 0], [2, 2, 0], [2, 0, 0], [0, 1, 0]], dtype=float)
    with pytest.raises(ValueError, match="cross"):
        triangulated(hourglass)
