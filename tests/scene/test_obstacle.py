"""Obstacles against formulas, trimesh and faults; those that move are posed as declared and never faster than said."""

import coal
import msgspec
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from hypothesis import example, given, settings, strategies as st

from guidefield.errors import SceneInvalid
from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.scene.obstacle import build, build_all
from guidefield.scene.obstacle_message import ObstacleMotion, put_at
from guidefield.scene.scene import build as build_scene
from tests.scene.solids import l_prism, mesh_message

LAWS = settings(deadline=None, max_examples=18)
seeds = st.integers(0, 2**32 - 1)
GJK = 2e-6  # Coal's accuracy for distances of convex bodies
SPECK = 1e-3  # radius of the ball that stands for a point [m]


def pose(rng: np.random.Generator) -> dict[str, tuple[float, ...]]:
    q = rng.normal(size=4)
    return {
        "position": tuple(rng.uniform(-1, 1, 3).tolist()),
        "quaternion_xyzw": tuple((q / np.linalg.norm(q)).tolist()),
    }


def distance(obstacle, point: np.ndarray) -> float:
    """Coal's distance of a point to an obstacle: of a tiny ball."""
    there = coal.Transform3s(obstacle.placement.rotation, obstacle.placement.translation)
    ball, here = coal.Sphere(SPECK), coal.Transform3s(np.eye(3), point)
    return coal.distance(obstacle.shape, there, ball, here, coal.DistanceRequest(), coal.DistanceResult()) + SPECK


def agrees(found: float, expected: float) -> bool:
    """Whether a distance to a thin surface is the one expected; near it, Coal stops at any face that the ball meets."""
    if expected > SPECK:
        return abs(found - expected) <= GJK
    return expected - GJK <= found <= SPECK + GJK


def local(message, point: np.ndarray) -> np.ndarray:
    x, y, z, w = message.quaternion_xyzw
    return pin.SE3(pin.Quaternion(w, x, y, z).matrix(), np.array(message.position)).actInv(point)


def box_distance(message, point):
    gaps = np.abs(local(message, point)) - 0.5 * np.array(message.size)
    return np.linalg.norm(np.maximum(gaps, 0)) + min(gaps.max(), 0)


def sphere_distance(message, point):
    return np.linalg.norm(point - message.position) - message.radius


def cylinder_distance(message, point):
    x, y, z = local(message, point)
    gaps = np.array([np.hypot(x, y) - message.radius, abs(z) - 0.5 * message.length])
    return np.linalg.norm(np.maximum(gaps, 0)) + min(gaps.max(), 0)


def capsule_distance(message, point):
    x, y, z = local(message, point)
    return np.linalg.norm([x, y, z - np.clip(z, -0.5 * message.length, 0.5 * message.length)]) - message.radius


def half_space_distance(message, point):
    return (np.dot(message.normal, point) - message.offset) / np.linalg.norm(message.normal)


def random_primitive(rng: np.random.Generator):
    size = rng.uniform(0.05, 1.0, 3).tolist()
    return [
        (messages.Box(name="o", size=tuple(size), **pose(rng)), box_distance),
        (messages.Sphere(name="o", radius=size[0], position=pose(rng)["position"]), sphere_distance),
        (messages.Cylinder(name="o", radius=size[0], length=size[1], **pose(rng)), cylinder_distance),
        (messages.Capsule(name="o", radius=size[0], length=size[1], **pose(rng)), capsule_distance),
        (messages.HalfSpace(name="o", normal=tuple(rng.normal(size=3).tolist()), offset=size[0]), half_space_distance),
    ][rng.integers(5)]


@settings(max_examples=30)
@given(seeds)
def test_signed_distance_of_primitives_is_the_formulas(seed):
    rng = np.random.default_rng(seed)
    message, formula = random_primitive(rng)
    obstacle = build(message, 0)
    assert obstacle.convex
    assert obstacle.solid
    point = rng.uniform(-1.5, 1.5, 3)
    expected = formula(message, point)
    if isinstance(message, messages.Cylinder) and expected < 0:
        # Coal's polytope expansion stops early on a cylinder: a depth that separates, but not always the least one.
        assert distance(obstacle, point) <= expected + GJK
    else:
        assert distance(obstacle, point) == pytest.approx(expected, abs=GJK)


@LAWS
@given(seeds)
def test_drawn_surface_lies_on_the_primitive_and_faces_outwards(seed):
    rng = np.random.default_rng(seed)
    message, formula = random_primitive(rng)
    obstacle = build(message, 0)
    for vertex in obstacle.vertices[:: max(1, len(obstacle.vertices) // 8)]:
        # A cylinder is drawn as the prism that contains it.
        slack = message.radius * (1 / np.cos(np.pi / 24) - 1) if isinstance(message, messages.Cylinder) else 0.0
        assert -1e-9 <= formula(message, vertex) + 1e-9 <= slack + 2e-9
    if isinstance(message, messages.HalfSpace):
        a, b, c = obstacle.vertices[obstacle.triangles[0]]
        assert np.dot(np.cross(b - a, c - a), message.normal) > 0
    else:
        drawn = trimesh.Trimesh(obstacle.vertices, obstacle.triangles)
        assert drawn.is_volume
        assert drawn.volume == pytest.approx(obstacle.shape.computeVolume(), rel=0.1)


@LAWS
@given(seeds)
def test_convex_mesh_is_judged_as_a_solid(seed):
    rng = np.random.default_rng(seed)
    hull = trimesh.convex.convex_hull(rng.normal(size=(20, 3)) * 0.4)
    message = mesh_message(hull.vertices, hull.faces, **pose(rng))
    obstacle = build(message, 0)
    assert obstacle.convex
    point = rng.uniform(-1.5, 1.5, 3)
    here = local(message, point)
    heights = np.einsum("ij,ij->i", hull.face_normals, here - hull.vertices[hull.faces[:, 0]])
    _, outside, _ = trimesh.proximity.closest_point_naive(hull, here[None])
    expected = heights.max() if heights.max() < 0 else outside[0]
    assert distance(obstacle, point) == pytest.approx(expected, abs=GJK)


@LAWS
@given(seeds)
def test_other_mesh_is_judged_as_its_surface(seed):
    rng = np.random.default_rng(seed)
    vertices, triangles = l_prism()
    message = mesh_message(vertices, triangles, **pose(rng))
    obstacle = build(message, 0)
    assert obstacle.solid
    assert not obstacle.convex
    point = rng.uniform(-2.5, 2.5, 3)
    _, expected, _ = trimesh.proximity.closest_point_naive(
        trimesh.Trimesh(vertices, triangles), local(message, point)[None]
    )
    assert agrees(distance(obstacle, point), expected[0])


def polygon_distance(corners: np.ndarray, point: np.ndarray) -> float:
    """Of a point to a flat polygon in z = 0, by crossing number and by its edges."""
    x, y, z = point
    inside = False
    gaps = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if (a[1] > y) != (b[1] > y) and x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]):
            inside = not inside
        t = np.clip(np.dot([x, y] - a, b - a) / np.dot(b - a, b - a), 0, 1)
        gaps.append(np.linalg.norm([x, y] - a - t * (b - a)))
    return abs(z) if inside else np.hypot(z, min(gaps))


@settings(max_examples=18)
@given(seeds)
@example(176191)  # half a millimetre off
def test_polygon_that_is_not_convex_is_judged_as_its_area(seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 12))
    angles = (np.arange(count) + rng.uniform(-0.3, 0.3, count)) * 2 * np.pi / count
    corners = (rng.uniform(0.15, 1.0, count) * np.array([np.cos(angles), np.sin(angles)])).T
    placement = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-1, 1, 3))
    world = np.column_stack([corners, np.zeros(count)]) @ placement.rotation.T + placement.translation
    obstacle = build(messages.Polygon(name="p", vertices=[tuple(row) for row in world.tolist()]), 0)
    assert not obstacle.solid
    assert obstacle.warnings == ()
    area = 0.5 * abs(corners[:, 0] @ np.roll(corners[:, 1], -1) - corners[:, 1] @ np.roll(corners[:, 0], -1))
    assert trimesh.Trimesh(obstacle.vertices, obstacle.triangles, process=False).area == pytest.approx(area)
    point = rng.uniform(-1.2, 1.2, 3)
    expected = polygon_distance(corners, point)
    assert agrees(distance(obstacle, placement.act(point)), expected)


def polygon(*vertices):
    return messages.Polygon(name="bad", vertices=[tuple(map(float, v)) for v in vertices])


POINTS = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)]
FAULTS = [
    (polygon((0, 0, 0), (1, 0, 0), (1, 1, 0.01), (0, 1, 0)), ".vertices", "off a plane"),
    (polygon((0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 1.5, 0)), ".vertices", "isn't simple"),
    (polygon((0, 0, 0), (1, 0, 0), (2, 0, 0)), ".vertices", "a line"),
    (polygon((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 0, 0)), ".vertices", "coincide"),
    (
        mesh_message(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.array([[0, 1, 2]]), name="bad"),
        ".triangles",
        "area",
    ),
]


@pytest.mark.parametrize(("message", "field", "words"), FAULTS)
def test_bad_obstacles_are_refused_with_name_and_path(message, field, words):
    with pytest.raises(SceneInvalid, match="'bad'") as caught:
        build(message, 3)
    assert words in caught.value.message
    assert caught.value.details == {"obstacle": "bad", "path": f"$.obstacles[3]{field}"}


def test_the_first_fault_of_a_scene_is_told_whatever_is_judged_together():
    good, bad = polygon((0, 0, 0), (1, 0, 0), (0, 1, 0)), polygon((0, 0, 0), (1, 0, 0), (2, 0, 0))
    flat_mesh = messages.Mesh(name="flat", vertices=[*POINTS, (2.0, 0.0, 0.0)], triangles=[(0, 1, 2)])
    for declared, index in (([good, flat_mesh, bad], 1), ([good, bad, flat_mesh], 1), ([flat_mesh, bad], 0)):
        named = [msgspec.structs.replace(one, name=f"o{k}") for k, one in enumerate(declared)]
        with pytest.raises(SceneInvalid) as told:
            build_all(named, {})
        assert told.value.details["obstacle"] == f"o{index}"
        assert told.value.details["path"].startswith(f"$.obstacles[{index}].")


def test_polygons_that_are_built_together_are_covered_once_each():
    rng, outlines = np.random.default_rng(12), []
    for k in range(120):
        count, radii = int(rng.integers(3, 8)), rng.uniform(0.3, 1.0, 8)
        angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, count)) if k % 2 else 2.0 * np.pi * np.arange(count) / count
        flat = (1.0 if k % 2 else radii[:count, None]) * np.column_stack([np.cos(angles), np.sin(angles)])
        x, y = flat.T
        area = 0.5 * (x @ np.roll(y, -1) - y @ np.roll(x, -1))
        outlines.append((flat @ np.linalg.qr(rng.normal(size=(3, 3)))[0][:2], area))
    declared = [polygon(*corners) for corners, _ in outlines]
    built = build_all([msgspec.structs.replace(one, name=f"p{k}") for k, one in enumerate(declared)], {})
    for one, (corners, area) in zip(built, outlines, strict=True):
        np.testing.assert_array_equal(one.vertices, corners)
        a, b, c = one.vertices[one.triangles].swapaxes(0, 1)
        assert 0.5 * np.linalg.norm(np.cross(b - a, c - a).sum(axis=0)) == pytest.approx(abs(area), rel=1e-9)
        assert 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() == pytest.approx(abs(area), rel=1e-9)
        quads, rest = one.charges.quads, one.charges.triangles
        halves = np.concatenate([rest, quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
        charged = np.linalg.norm(np.cross(halves[:, 1] - halves[:, 0], halves[:, 2] - halves[:, 0]), axis=1)
        assert 0.5 * charged.sum() == pytest.approx(abs(area), rel=1e-9)


HALF = float(np.sqrt(0.5))
SWING = messages.ObstacleTrajectory(
    times=[1.0, 2.0, 4.0],
    placements=[
        Placement(position=(1.0, 0.0, 0.0)),
        Placement(position=(0.0, 1.0, 0.0), quaternion_xyzw=(0.0, 0.0, HALF, HALF)),
        Placement(position=(0.0, 1.0, 2.0), quaternion_xyzw=(0.0, 0.0, HALF, HALF)),
    ],
)
KINDS = [
    messages.Box(name="o", size=(0.2, 0.3, 0.4), trajectory=SWING),
    messages.Cylinder(name="o", radius=0.1, length=0.4, trajectory=SWING),
    messages.Capsule(name="o", radius=0.1, length=0.4, trajectory=SWING),
    messages.Sphere(name="o", radius=0.1, trajectory=SWING),
    messages.Polygon(name="o", vertices=[(0.1, 0, 0), (0.3, 0, 0), (0.2, 0.4, 0)], trajectory=SWING),
    messages.Mesh(
        name="o",
        vertices=[(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)],
        triangles=[(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)],
        trajectory=SWING,
    ),
    messages.HalfSpace(name="o", normal=(0.2, -0.4, 2.0), offset=-0.3, trajectory=SWING),
    messages.PointCloud(name="o", points=[(0.1, 0, 0), (0.3, 0, 0.2), (0.2, 0.4, 0)], radius=0.05, trajectory=SWING),
]


@given(st.floats(0.0, 5.0), st.floats(1e-4, 0.5), st.integers(0, 2**31))
@settings(max_examples=15)
def test_no_point_is_faster_than_the_speed_that_is_said(start: float, span: float, seed: int) -> None:
    motion, rng = ObstacleMotion.of(SWING), np.random.default_rng(seed)
    centre, radius = rng.normal(size=3), 0.3
    offset = rng.normal(size=3)
    point = centre + radius * offset / np.linalg.norm(offset)
    moved = np.linalg.norm(motion.at(start + span).act(point) - motion.at(start).act(point))
    assert moved <= motion.speed(start, start + span, centre, radius) * span + 1e-9


@given(st.floats(0.0, 5.0), st.floats(1e-4, 0.5), st.integers(0, 2**31))
@settings(max_examples=15)
def test_no_plane_comes_closer_to_a_point_at_rest_than_it_is_said_to_pass_it(start, span, seed):
    motion, rng = ObstacleMotion.of(SWING), np.random.default_rng(seed)
    centre, radius = 3.0 * rng.normal(size=3), 0.3
    offset, normal = rng.normal(size=(2, 3))
    point = centre + radius * offset / np.linalg.norm(offset)
    plane = messages.HalfSpace(name="o", normal=tuple((normal / np.linalg.norm(normal)).tolist()), offset=0.4)
    posed_then, posed_later = (put_at(plane, motion.at(time)) for time in (start, start + span))
    lost = (point @ posed_then.normal - posed_then.offset) - (point @ posed_later.normal - posed_later.offset)
    during = slice(np.searchsorted(motion.times, start, side="right"), np.searchsorted(motion.times, start + span) + 1)
    assert abs(lost) <= motion.passing(centre, radius)[during].max() * span + 1e-9


@pytest.mark.parametrize("message", KINDS, ids=lambda m: type(m).__name__)
def test_a_scene_at_a_time_has_its_obstacles_there(message: messages.Obstacle) -> None:
    scene = build_scene(messages.Scene(name="s", obstacles=[message]))
    (first,) = scene.obstacles
    assert scene.moves
    assert scene.end == 4.0
    assert scene.resting.obstacles == ()
    for time in (0.0, 1.7, 3.0, 8.0):
        (there_then,) = scene.at(time).obstacles
        carried = first.placement_at(time) * first.placement.inverse()
        if isinstance(message, messages.HalfSpace):  # its patch lies elsewhere on the same plane
            plane = there_then.message
            np.testing.assert_allclose([carried.act(v) @ plane.normal for v in first.vertices], plane.offset, atol=1e-9)
            inward = carried.rotation @ np.array(message.normal)
            assert inward @ plane.normal > 0.999 * np.linalg.norm(message.normal) ** 2
            continue
        if isinstance(message, messages.PointCloud):
            there = [carried.act(point) for point in first.cloud.points]
            np.testing.assert_allclose(
                sorted(map(tuple, there_then.cloud.points)), sorted(map(tuple, there)), atol=1e-9
            )
            continue
        if not isinstance(message, messages.Sphere):  # a ball doesn't turn
            np.testing.assert_allclose(there_then.vertices, [carried.act(v) for v in first.vertices], atol=1e-9)
        centre = first.vertices.mean(axis=0)
        np.testing.assert_allclose(there_then.vertices.mean(axis=0), carried.act(centre), atol=1e-9)


@pytest.mark.parametrize("message", [KINDS[0], KINDS[-2]], ids=lambda m: type(m).__name__)
def test_a_scene_since_a_time_has_its_obstacles_where_they_are_then(message: messages.Obstacle) -> None:
    scene = build_scene(messages.Scene(name="s", obstacles=[message]))
    assert scene.since(0.0) is scene
    for begin in (0.6, 1.4, 3.0):
        seen = scene.since(begin)
        assert seen.end == pytest.approx(4.0 - begin)
        for time in (0.0, 0.3, 2.0, 5.0):
            (here,), (there,) = seen.at(time).obstacles, scene.at(begin + time).obstacles
            np.testing.assert_allclose(here.vertices, there.vertices, atol=1e-9)
    for last in (4.0, np.inf):
        resting = scene.since(last)
        assert not resting.moves
        np.testing.assert_allclose(resting.obstacles[0].vertices, scene.at(9.0).obstacles[0].vertices)
