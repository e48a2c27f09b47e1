"""Laws of guide planes and of the flat polygons that they are, and the faults for which one is refused."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings, strategies as st

from guidefield.errors import SceneInvalid
from guidefield.messages import scene as messages
from guidefield.scene import guide_plane as flats
from guidefield.scene.guide_plane import PLANARITY, FlatPolygon, FlatPolygons, GuidePlane, build, flat_polygons

LAWS = settings(deadline=None, max_examples=18)
seeds = st.integers(0, 2**32 - 1)
EXACT = 1e-9  # rounding of a few products of numbers near 1


def plane(vertices: np.ndarray) -> GuidePlane:
    return build(messages.GuidePlane(name="g", vertices=[tuple(map(float, v)) for v in vertices]), 0)


def random_placement(rng: np.random.Generator) -> pin.SE3:
    q = rng.normal(size=4)
    return pin.SE3(pin.Quaternion(q / np.linalg.norm(q)).matrix(), rng.uniform(-1, 1, 3))


def moved(placement: pin.SE3, corners: np.ndarray) -> np.ndarray:
    return np.column_stack([corners, np.zeros(len(corners))]) @ placement.rotation.T + placement.translation


def tangential(rng: np.random.Generator, radius: float) -> np.ndarray:
    """Corners (k, 2) of a polygon whose edges all touch a circle about the origin: its inradius is known."""
    count = int(rng.integers(3, 9))
    angles = np.sort((np.arange(count) + rng.uniform(-0.35, 0.35, count)) * 2 * np.pi / count)
    steps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    assume(steps.max() < 0.95 * np.pi)
    middles, half = angles + steps / 2, steps / 2
    return radius / np.cos(half)[:, None] * np.column_stack([np.cos(middles), np.sin(middles)])


@LAWS
@given(seeds)
def test_inradius_of_a_tangential_polygon_is_its_circles(seed):
    rng = np.random.default_rng(seed)
    radius = rng.uniform(0.05, 1.0)
    placement = random_placement(rng)
    guide = plane(moved(placement, tangential(rng, radius)))
    assert guide.inradius == pytest.approx(radius, rel=1e-9)
    deepest = guide.closest_point(placement.translation + rng.uniform(-1, 1, 3), inset=2 * radius)
    assert deepest == pytest.approx(placement.translation, abs=1e-6)


@LAWS
@given(seeds)
def test_no_point_is_deeper_than_the_inradius_and_one_is_as_deep(seed):
    rng = np.random.default_rng(seed)
    corners = tangential(rng, 0.5) * [1.0, rng.uniform(0.1, 1.0)]
    shift, turn = rng.uniform(0, 1), rng.uniform(0, np.pi)
    # Cut a corner off, so that edges vanish one after the other.
    corners = np.vstack([corners[0] * 0.8 + corners[1] * 0.2, corners[1:], corners[0] * 0.8 + corners[-1] * 0.2])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    corners = corners @ rotation.T + shift
    edges = np.roll(corners, -1, axis=0) - corners
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    low, high = corners.min(axis=0), corners.max(axis=0)
    cells = np.stack(np.meshgrid(*(np.linspace(a, b, 150) for a, b in zip(low, high, strict=True))), axis=-1).reshape(
        -1, 2
    )
    arms = cells[:, None] - corners
    deepest = (edges[:, 0] * arms[..., 1] - edges[:, 1] * arms[..., 0]).min(axis=1).max()
    inradius = plane(moved(pin.SE3.Identity(), corners)).inradius
    assert deepest <= inradius + EXACT
    assert deepest >= inradius - np.linalg.norm(high - low) / 149


@LAWS
@given(seeds)
def test_vertices_turn_counter_clockwise_about_the_normal(seed):
    rng = np.random.default_rng(seed)
    vertices = moved(random_placement(rng), tangential(rng, 0.5))
    guide = plane(vertices)
    edges = np.roll(guide.vertices, -1, axis=0) - guide.vertices
    assert (np.cross(edges, np.roll(edges, -1, axis=0)) @ guide.normal > 0).all()
    assert np.linalg.norm(guide.normal) == pytest.approx(1.0)
    back = plane(vertices[::-1])
    assert back.normal == pytest.approx(-guide.normal)
    point = rng.uniform(-1, 1, 3)
    assert back.signed_height(point) == pytest.approx(-guide.signed_height(point))
    assert back.closest_point(point) == pytest.approx(guide.closest_point(point), abs=EXACT)


@LAWS
@given(seeds, st.floats(0.0, 1.2))
def test_closest_point_is_the_projection_on_a_convex_set(seed, share):
    rng = np.random.default_rng(seed)
    guide = plane(moved(random_placement(rng), tangential(rng, 0.4)))
    inset = share * guide.inradius
    point = rng.uniform(-1.5, 1.5, 3)
    closest = guide.closest_point(point, inset)
    assert guide.contains(closest, inset)
    assert guide.signed_height(closest) == pytest.approx(0.0, abs=EXACT)
    # The projection c of p on a convex set: (p - c) . (x - c) <= 0 for all x of it; it is enough to ask its corners.
    obtuse = (guide.inset_vertices(inset) - closest) @ (point - closest)
    assert obtuse.max() <= 1e-8
    assert guide.distance(point, inset) == pytest.approx(np.linalg.norm(point - closest), abs=1e-12)
    assert guide.distance(point, inset) >= guide.distance(point) - EXACT
    assert guide.distance(point) >= abs(guide.signed_height(point)) - EXACT


@LAWS
@given(seeds, st.floats(0.0, 0.999))
def test_inset_vertices_lie_at_the_inset_from_their_edges(seed, share):
    rng = np.random.default_rng(seed)
    guide = plane(moved(random_placement(rng), tangential(rng, 0.4) * [1.0, rng.uniform(0.2, 1.0)]))
    inset = share * guide.inradius
    start, end = guide.vertices, np.roll(guide.vertices, -1, axis=0)
    along = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    assert len(guide.inset_vertices(inset)) >= 3
    for corner in guide.inset_vertices(inset):
        depths = np.sort((np.cross(guide.normal, along) * (corner - start)).sum(axis=1))
        assert depths[0] == pytest.approx(inset, abs=1e-7)
        assert depths[1] == pytest.approx(inset, abs=1e-7)


@LAWS
@given(seeds)
def test_rigid_motions_move_everything_along(seed):
    rng = np.random.default_rng(seed)
    corners = tangential(rng, 0.4)
    first, placement = plane(moved(pin.SE3.Identity(), corners)), random_placement(rng)
    second = plane(moved(placement, corners))
    point = rng.uniform(-1, 1, 3)
    assert second.closest_point(placement.act(point), 0.1) == pytest.approx(
        placement.act(first.closest_point(point, 0.1)), abs=1e-8
    )
    assert second.centroid == pytest.approx(placement.act(first.centroid), abs=EXACT)
    assert second.signed_height(placement.act(point)) == pytest.approx(first.signed_height(point), abs=EXACT)


@LAWS
@given(seeds)
def test_centroid_is_the_mean_of_the_area(seed):
    rng = np.random.default_rng(seed)
    corners = tangential(rng, 0.5)
    low, high = corners.min(axis=0), corners.max(axis=0)
    guide = plane(moved(pin.SE3.Identity(), corners))
    cells = np.stack(np.meshgrid(*(np.linspace(a, b, 120) for a, b in zip(low, high, strict=True))), axis=-1).reshape(
        -1, 2
    )
    edges = np.roll(corners, -1, axis=0) - corners
    arms = cells[:, None] - corners
    inside = (edges[:, 0] * arms[..., 1] - edges[:, 1] * arms[..., 0] >= 0).all(axis=1)
    assert guide.centroid[:2] == pytest.approx(cells[inside].mean(axis=0), abs=0.02 * np.ptp(corners))


def test_contains_asks_the_foot_only():
    guide = plane([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    assert guide.contains(np.array([0.5, 0.5, 7.0]))
    assert guide.contains(np.array([0.2, 0.5, 0.0]), inset=0.2)
    assert not guide.contains(np.array([0.19, 0.5, 0.0]), inset=0.2)
    assert not guide.contains(np.array([-0.01, 0.5, 0.0]))


SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
FAULTS = {
    "off a plane": [*SQUARE[:3], [0, 1, 0.01]],
    "dents": [*SQUARE[:2], [0.2, 0.2, 0], SQUARE[3]],
    "times around": [[np.cos(a), np.sin(a), 0] for a in np.arange(5) * 4 * np.pi / 5],
    "coincide": [*SQUARE, SQUARE[0]],
    "a line": [[0, 0, 0], [1, 0, 0], [2, 0, 0]],
}


@pytest.mark.parametrize(("words", "vertices"), FAULTS.items())
def test_faulty_planes_are_refused_with_name_and_path(words, vertices):
    message = messages.GuidePlane(name="GP7", vertices=[tuple(map(float, v)) for v in vertices])
    with pytest.raises(SceneInvalid, match="GP7") as caught:
        build(message, 4)
    assert words in caught.value.message
    assert caught.value.details == {"guide_plane": "GP7", "path": "$.guide_planes[4].vertices"}


def flat_polygon(points: np.ndarray) -> FlatPolygon:
    return flat_polygons(points[None]).one(0)


def alone(polygon: FlatPolygon) -> FlatPolygons:
    return flat_polygons(polygon.vertices[None])


def flatness_fault(polygon: FlatPolygon) -> str | None:
    return flats.flatness_faults(alone(polygon)).get(0)


def crossing_edges(polygon: FlatPolygon) -> tuple[int, int] | None:
    return flats.crossing_edges(alone(polygon)).get(0)


def shoelace(corners: np.ndarray) -> float:
    x, y = corners.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


@settings(max_examples=12)
@given(st.integers(0, 10**6))
def test_plane_of_a_moved_star_is_the_moved_plane(seed):
    rng = np.random.default_rng(seed)
    placement = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-1, 1, 3))
    radii = rng.uniform(0.2, 2.0, 12)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 12))
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False) + 0.1 * angles / 7
    corners = np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])
    points = np.column_stack([corners, np.zeros(12)]) @ placement.rotation.T + placement.translation
    flat = flat_polygon(points)
    assert flat.normal == pytest.approx(placement.rotation[:, 2], abs=1e-12)
    assert flat.area == pytest.approx(shoelace(corners))
    assert shoelace(flat.corners) == pytest.approx(flat.area)
    assert flat.from_plane(flat.corners) == pytest.approx(points, abs=1e-12)
    assert np.cross(*flat.axes) == pytest.approx(flat.normal)
    assert flatness_fault(flat) is None
    assert crossing_edges(flat) is None


def test_a_corner_off_the_plane_is_told_with_its_distance():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 1e-4], [0, 1, 0]], float)
    assert "off a plane" in flatness_fault(flat_polygon(square))
    assert flatness_fault(flat_polygon(square * [1, 1, 1e-3])) is None


@pytest.mark.parametrize("corners", [[[0, 0, 0], [1, 0, 0], [1, 0, 0]], [[0, 0, 0]] * 3])
def test_coinciding_corners_are_told(corners):
    assert "coincide" in flatness_fault(flat_polygon(np.array(corners, float)))


def first_crossing(corners: np.ndarray, gap: float) -> tuple[int, int] | None:
    """The oracle: each edge against each that is no neighbour, the segments sampled by their closest points."""
    count, ends = len(corners), np.roll(corners, -1, axis=0)

    def apart(point: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
        share = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        return float(np.linalg.norm(point - (a + share * (b - a))))

    def side(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
        return float((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0])

    for i in range(count):
        for j in range(i + 2, count - (i == 0)):
            a, b, c, d = corners[i], ends[i], corners[j], ends[j]
            if min(apart(c, a, b), apart(d, a, b), apart(a, c, d), apart(b, c, d)) <= gap:
                return i, j
            if side(a, b, c) * side(a, b, d) < 0.0 and side(c, d, a) * side(c, d, b) < 0.0:
                return i, j
    return None


def outlines(rng: np.random.Generator, kind: int) -> np.ndarray:
    count = int(rng.integers(4, 30))
    if kind == 0:
        return rng.uniform(-1.0, 1.0, (count, 2))
    if kind == 1:
        return rng.integers(0, 7, (count, 2)).astype(float)
    angles = 2.0 * np.pi * (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count
    corners = rng.uniform(0.2, 1.0, (count, 1)) * np.column_stack([np.cos(angles), np.sin(angles)])
    one, other = rng.integers(0, count, 2)
    if kind == 2:  # nearly touching itself
        corners[one] = corners[other] + 10.0 ** rng.uniform(-8.0, -3.0) * rng.normal(size=2)
    return corners


@settings(max_examples=60)
@given(st.integers(0, 10**6), st.integers(0, 3))
def test_the_first_edges_that_meet_are_found(seed, kind):
    corners = outlines(np.random.default_rng(seed), kind)
    flat = flat_polygon(np.column_stack([corners, np.zeros(len(corners))]))
    if flatness_fault(flat) is not None:
        return
    found, expected = crossing_edges(flat), first_crossing(flat.corners, PLANARITY * flat.size)
    if found != expected:  # an edge that folds back is told before
        assert (found[1] - found[0]) % len(corners) == 1


def test_an_outline_of_ten_thousand_corners_is_looked_through():
    """Edge by edge and pair by pair it would take a minute."""
    angles = np.linspace(0.0, 2.0 * np.pi, 10_000, endpoint=False)
    spikes = np.where(np.arange(10_000) % 2, 1.0, 0.5)[:, None]
    star = spikes * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    assert crossing_edges(flat_polygon(star)) is None
    star[[2500, 7501]] = star[[7501, 2500]]
    assert crossing_edges(flat_polygon(star)) is not None
