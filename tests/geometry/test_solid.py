"""Solids: depths, hollows and pieces within them, and the same with fewer triangles."""

import functools

import numpy as np
import pytest

from guidefield.geometry import surfaces
from guidefield.geometry.convex import hull_planes
from guidefield.geometry.cover import cover
from guidefield.geometry.decomposition import decompose
from guidefield.geometry.primitive_covers import inner_balls
from guidefield.geometry.solid import CELL, WORTH, Solid, coarse_solid, fill_hollows, find_nested, solid
from tests.geometry import solids
from tests.scene.solids import prism

CLOSED = {
    "box": solids.box((0.1, 0.2, 0.3)),
    "ring": solids.torus(),
    "channel": solids.lying(solids.channel()),
    "hollow": solids.hollow(),
    "inside out": solids.turned(solids.hollow()),
}


@pytest.mark.parametrize("mesh", CLOSED.values(), ids=CLOSED)
def test_depth_is_the_distance_to_the_surface(mesh: solids.Mesh) -> None:
    body = solid(*mesh)
    assert body.closed
    points = solids.in_box_of(mesh, 1000, np.random.default_rng(0))
    inside = np.abs(solids.winding(points, mesh)) > 0.5
    expected = np.where(inside, 1.0, -1.0) * solids.distance(points, mesh)
    assert body.depths(points) == pytest.approx(expected, abs=1e-12)
    assert body.distances(points) == pytest.approx(np.abs(expected), abs=1e-12)


def test_where_solids_overlap_the_deeper_one_counts() -> None:
    first, second = solids.box((0.1, 0.06, 0.06)), solids.box((0.06, 0.1, 0.05), (0.05, 0.03, 0.0))
    body = solid(*solids.together(first, second))
    assert len(body.spans) == 2
    points = solids.in_box_of(solids.overlapping(), 1500, np.random.default_rng(1))
    signed = [
        np.where(solids.winding(points, part) > 0.5, 1.0, -1.0) * solids.distance(points, part)
        for part in (first, second)
    ]
    assert body.depths(points) == pytest.approx(np.maximum(*signed), abs=1e-12)


def test_a_piece_inside_out_in_nothing_is_a_solid() -> None:
    mesh = solids.together(solids.box((0.2, 0.2, 0.2)), solids.turned(solids.box((0.1, 0.1, 0.1), (0.5, 0.0, 0.0))))
    body = solid(*mesh)
    assert len(body.spans) == 2
    assert body.depths(np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.3, 0.0, 0.0]])) == pytest.approx(
        [0.1, 0.05, -0.15]
    )


def test_a_crack_is_closed_if_it_may_be() -> None:
    mesh = solids.cracked()
    centre = np.zeros((1, 3))
    open_body, closed_body = solid(*mesh, widest_gap=0.001), solid(*mesh, widest_gap=0.02)
    assert not open_body.closed
    assert open_body.lids == 0
    assert open_body.depths(centre)[0] == pytest.approx(-solids.distance(centre, mesh)[0])
    assert closed_body.closed
    assert closed_body.lids >= 2
    assert closed_body.depths(centre)[0] == pytest.approx(solids.distance(centre, mesh)[0], rel=1e-2)
    assert len(closed_body.owners) == len(mesh[1]) + closed_body.lids


def test_an_open_surface_has_no_inside() -> None:
    mesh = solids.bowl()
    body = solid(*mesh, widest_gap=0.02)
    assert not body.closed
    points = solids.in_box_of(mesh, 300, np.random.default_rng(0))
    assert body.depths(points) == pytest.approx(-solids.distance(points, mesh), abs=1e-12)


@pytest.mark.parametrize(
    ("vertices", "triangles"),
    [(np.zeros((3, 3)), np.array([[0, 1, 2]])), (np.outer(np.arange(3.0), [1, 1, 1]), np.array([[0, 1, 2]]))],
    ids=["point", "line"],
)
def test_what_has_no_area_is_refused(vertices: np.ndarray, triangles: np.ndarray) -> None:
    with pytest.raises(ValueError, match="area"):
        solid(vertices, triangles)


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


BODIES = {
    "ring": solids.torus(0.02, 0.006, around=160, across=90),
    "plate": solids.together(solids.torus(0.02, 0.006, around=160, across=90), solids.box((0.03, 0.03, 0.0004))),
    "ball": tuple(surfaces.sphere(0.015, 5)),
}

bodies = pytest.mark.parametrize("name", BODIES)


@functools.cache
def coarse(name: str) -> tuple[solids.Mesh, Solid]:
    mesh = BODIES[name]
    body = coarse_solid(*mesh)
    assert body is not None
    return mesh, body


@bodies
def test_it_has_fewer_triangles_and_is_within_reach_of_the_mesh_both_ways(name: str) -> None:
    mesh, body = coarse(name)
    assert len(body.owners) <= WORTH * len(mesh[1])
    assert 0.0 < body.reach <= np.sqrt(3.0) * CELL
    fine = solid(*mesh)
    assert body.distances(solids.on_surface(mesh, 1500, np.random.default_rng(0))).max() <= body.reach + 1e-12
    back = solids.on_surface((body.surface.vertices, body.surface.triangles), 1500, np.random.default_rng(1))
    assert fine.distances(back).max() <= body.reach + 1e-12


@bodies
def test_what_is_further_from_both_is_inside_both_or_neither(name: str) -> None:
    mesh, body = coarse(name)
    points = solids.in_box_of(mesh, 1500, np.random.default_rng(2))
    exact, near = solid(*mesh).depths(points), body.depths(points)
    assert np.abs(exact - near)[np.minimum(np.abs(exact), np.abs(near)) > body.reach].max() <= body.reach + 1e-12


@bodies
def test_a_cover_contains_the_mesh_and_leaves_it_no_further_than_said(name: str) -> None:
    mesh, body = coarse(name)
    balls = cover(body, 0.012)
    assert balls.overhang <= 0.012
    rng = np.random.default_rng(3)
    assert solids.in_balls(solids.on_surface(mesh, 1500, rng), balls.spheres).all()
    fine, points = solid(*mesh), solids.in_box_of(mesh, 1500, rng)
    assert solids.in_balls(points[fine.depths(points) > 0.0], balls.spheres).all()
    around = solids.around(balls.spheres, 60, rng)
    beyond = (-fine.depths(around.reshape(-1, 3))).reshape(len(balls.spheres), -1).max(axis=1)
    assert (beyond <= balls.overhangs + 1e-12).all()
    assert (np.linalg.norm(mesh[0] - balls.bound[:3], axis=1) <= balls.bound[3]).all()


@bodies
def test_inner_balls_are_inside_the_mesh(name: str) -> None:
    mesh, body = coarse(name)
    inner = inner_balls(body)
    assert len(inner)
    assert (solid(*mesh).depths(inner[:, :3]) >= inner[:, 3]).all()


@bodies
def test_convex_parts_contain_the_mesh_and_stand_off_as_far_as_said(name: str) -> None:
    mesh, body = coarse(name)
    found, fine = decompose(body, 0.002, 4), solid(*mesh)
    rng = np.random.default_rng(4)
    points = solids.in_box_of(mesh, 1500, rng)
    points = np.vstack([points[fine.depths(points) > 0.0], solids.on_surface(mesh, 1500, rng)])
    heights = []
    for part in found.parts:
        corners = part.hull.corners
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
        heights.append((points @ normals.T - np.einsum("ij,ij->i", normals, corners[:, 0])).max(axis=1))
        beyond = solids.on_surface((part.hull.vertices, part.hull.triangles), 400, rng)
        assert -fine.depths(beyond).min() <= part.stand_off
    assert np.min(heights, axis=0).max() <= 1e-9
