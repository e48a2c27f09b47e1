"""What lies within a closed surface is found and filled; what crosses it, or only looks so, isn't."""

import numpy as np
import pytest

from guidefield.geometry.convex import hull_planes
from guidefield.geometry.cover import cover
from guidefield.geometry.decomposition import decompose
from guidefield.geometry.solid import fill_hollows, find_nested, solid
from tests.geometry import solids
from tests.scene.solids import prism

WALL = 0.004


def hollow_bracket(*, inverted: bool) -> solids.Mesh:
    """An L with walls of `WALL`, the inner surface facing inwards or outwards."""
    caps = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 5], [3, 4, 5]])
    outline = 0.15 * np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], float)
    inset = outline + WALL * np.array([[1, 1], [-1, 1], [-1, -1], [-1, -1], [-1, -1], [1, -1]])
    vertices, triangles = prism(inset, 0.15 - 2.0 * WALL, caps)
    return solids.together(
        prism(outline, 0.15, caps),
        (vertices + np.array([0.0, 0.0, WALL]), triangles[:, ::-1] if inverted else triangles),
    )


@pytest.mark.parametrize("inverted", [True, False])
def test_a_sealed_hollow_is_found_whichever_way_it_faces(inverted: bool) -> None:
    found = find_nested(*hollow_bracket(inverted=inverted))
    assert found.pieces == 1
    assert (found.outer == np.arange(20)).all()
    inner = (0.15 - 2.0 * WALL) * ((0.3 - 2.0 * WALL) ** 2 - 0.15**2)
    assert found.volume == pytest.approx(inner)


def test_pieces_beside_each_other_or_across_are_not_within() -> None:
    large = solids.box((0.4, 0.4, 0.4))
    for centre in ((0.5, 0.0, 0.0), (0.2, 0.0, 0.0), (0.15, 0.0, 0.0)):
        assert find_nested(*solids.together(large, solids.box((0.1, 0.1, 0.1), centre))).pieces == 0
    # all corners inside of the channel's box, but in the open
    vertices, _ = solids.channel()
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    small = solids.box(tuple(0.1 * (high - low)), tuple(0.5 * (low + high)))
    both = solids.together(solids.channel(), small)
    inside = solids.winding(small[0], solids.channel()) > 0.5
    assert find_nested(*both).pieces == int(inside.all())


def test_what_reaches_through_a_wall_between_its_corners_is_not_within() -> None:
    caps = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 5], [3, 4, 5]])
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]], float)
    bracket = prism(outline, 1.0, caps)
    corners = np.array([[1.8, 0.8, 0.4], [0.8, 1.8, 0.4], [0.5, 0.5, 0.4], [0.6, 0.6, 0.6]])  # an edge in the open
    spike = corners, np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3], [0, 2, 1]])
    assert (solids.winding(corners, bracket) > 0.5).all()
    assert find_nested(*solids.together(bracket, spike)).pieces == 0


@pytest.mark.parametrize("inverted", [True, False])
def test_a_hollow_bracket_is_cut_and_covered_as_a_full_one(inverted: bool) -> None:
    vertices, triangles = hollow_bracket(inverted=inverted)
    body = solid(vertices, triangles, 0.02)
    parts = decompose(fill_hollows(body), 0.005, 8)
    assert len(parts.parts) == 2
    assert parts.stand_off < 0.002
    balls = cover(fill_hollows(body), 0.015).spheres
    rng = np.random.default_rng(0)
    points = np.vstack([solids.on_surface((vertices, triangles), 2000, rng), rng.uniform(0.0, 0.15, (2000, 3))])
    planes = [hull_planes(part.hull, len(part.hull.triangles)) for part in parts.parts]
    heights = [(points[:2000] @ sides[:, :3].T - sides[:, 3]).max(axis=1) for sides in planes]
    assert np.min(heights, axis=0).max() <= 1e-9
    assert solids.in_balls(points, balls).all()
    assert len(balls) < 0.25 * len(cover(body, 0.015).spheres) or not inverted


@pytest.mark.parametrize("inverted", [True, False])
def test_every_triangle_belongs_to_a_solid_that_is_left(inverted: bool) -> None:
    body = fill_hollows(
        solid(*solids.together(solids.box((0.1, 0.1, 0.1), (0.5, 0.0, 0.0)), hollow_bracket(inverted=inverted)))
    )
    assert len(body.spans) == 2
    assert set(body.owners.tolist()) == {0, 1}
