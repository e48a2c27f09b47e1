"""Signed distances against Coal, and the laws that every distance keeps."""

from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

from guidefield.geometry import surfaces
from guidefield.kernels.distance.distance import DistanceTables, distance_at_points
from guidefield.messages import scene as messages
from guidefield.scene.distance_tables import distance_tables
from guidefield.scene.scene import Scene, build
from tests.collision.scenery import scattered
from tests.scene.solids import l_prism, mesh_message

TILTED = {"position": (0.1, -0.2, 0.3), "quaternion_xyzw": (0.5, -0.5, 0.1, 0.7)}
BALL = surfaces.sphere(0.4)
CONVEX = {
    "box": messages.Box(name="box", size=(0.3, 0.5, 0.2), **TILTED),
    "cylinder": messages.Cylinder(name="cylinder", radius=0.2, length=0.5, **TILTED),
    "flat cylinder": messages.Cylinder(name="flat", radius=0.4, length=0.1, **TILTED),
    "capsule": messages.Capsule(name="capsule", radius=0.1, length=0.4, **TILTED),
    "sphere": messages.Sphere(name="sphere", radius=0.3, position=(0.1, 0.2, -0.1)),
    "half-space": messages.HalfSpace(name="floor", normal=(0.2, -0.1, 2.0), offset=-0.3),
    "convex mesh": mesh_message(BALL.vertices * [1.0, 0.6, 0.3], BALL.triangles, name="mesh", **TILTED),
}
EXACT = 1e-9  # Coal's own solver is good to about this [m]


def scene_of(*obstacles: Any) -> Scene:
    return build(messages.Scene(name="test", obstacles=list(obstacles)))


def tables_of(*obstacles: Any) -> DistanceTables:
    return distance_tables(scene_of(*obstacles))


def points_about(count: int, seed: int = 0, reach: float = 0.8) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-reach, reach, (count, 3))


def by_coal(scene: Scene, point: np.ndarray) -> float:
    """Signed distance of a point to the nearest obstacle of a scene of convex ones."""
    radius = 1e-9
    at = coal.Transform3s(np.eye(3), point)
    request = coal.DistanceRequest()
    request.enable_signed_distance = True
    distances = []
    for one in scene.obstacles:
        there = coal.Transform3s(one.placement.rotation, one.placement.translation)
        result = coal.DistanceResult()
        distances.append(coal.distance(coal.Sphere(radius), at, one.shape, there, request, result) + radius)
    return min(distances)


def by_differences(tables: DistanceTables, points: np.ndarray, step: float = 1e-6) -> np.ndarray:
    columns = [
        distance_at_points(tables, points + e)[0] - distance_at_points(tables, points - e)[0] for e in step * np.eye(3)
    ]
    return np.array(columns).T / (2.0 * step)


@pytest.mark.parametrize("name", CONVEX)
def test_agrees_with_coal_inside_and_out(name: str) -> None:
    scene = scene_of(CONVEX[name])
    points = np.vstack([points_about(150), 0.2 * points_about(50, 1) + scene.obstacles[0].placement.translation])
    distances, _, obstacles = distance_at_points(distance_tables(scene), points)
    expected = np.array([by_coal(scene, p) for p in points])
    assert (distances < 0.0).any()
    assert (obstacles == 0).all()
    np.testing.assert_array_equal(distances < 0.0, expected < 0.0)
    # within a cylinder Coal's depth is not the least one; see the next test
    comparable = (distances >= 0.0) | ("cylinder" not in name)
    np.testing.assert_allclose(distances[comparable], expected[comparable], atol=EXACT)


@pytest.mark.parametrize("name", CONVEX)
def test_the_vector_is_the_gradient(name: str) -> None:
    tables = tables_of(CONVEX[name])
    points = points_about(200, 2)
    _, normals, _ = distance_at_points(tables, points)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    off = np.abs(by_differences(tables, points) - normals).max(axis=1)
    assert (off < 1e-6).mean() > 0.97, "but next to middle planes, where the gradient jumps"


@pytest.mark.parametrize("name", CONVEX)
def test_it_never_changes_faster_than_the_point_moves(name: str) -> None:
    tables = tables_of(CONVEX[name])
    a, b = points_about(300, 4), points_about(300, 5)
    change = np.abs(distance_at_points(tables, a)[0] - distance_at_points(tables, b)[0])
    assert (change <= np.linalg.norm(a - b, axis=1) + 1e-12).all()


@pytest.mark.parametrize("count", [5, 31, 33, 200])
def test_a_tree_of_many_obstacles_finds_what_looking_at_each_finds(count: int) -> None:
    obstacles = scattered(np.random.default_rng(count), count)
    obstacles.append(messages.HalfSpace(name="floor", normal=(0, 0, 1), offset=-0.5))
    points = points_about(60, 7, 1.2)
    distances, _, nearest = distance_at_points(tables_of(*obstacles), points)
    singles = np.array([distance_at_points(tables_of(o), points)[0] for o in obstacles])
    np.testing.assert_array_equal(distances, singles.min(axis=0))
    np.testing.assert_array_equal(singles[nearest, np.arange(len(points))], singles.min(axis=0))


@pytest.mark.parametrize("cutoff", [0.02, 0.1, 0.5])
def test_a_cutoff_changes_nothing_below_it_and_leaves_out_what_is_beyond(cutoff: float) -> None:
    obstacles = [*CONVEX.values(), mesh_message(*l_prism(), name="l", position=(-1.0, -1.0, -2.0))]
    tables, points = tables_of(*obstacles), points_about(300, 8, 1.5)
    whole, cut = distance_at_points(tables, points), distance_at_points(tables, points, cutoff)
    near = whole[0] < cutoff
    assert near.any()
    assert not near.all()
    for a, b in zip(whole, cut, strict=True):
        np.testing.assert_array_equal(a[near], b[near])
    assert (cut[0][~near] == np.inf).all()
    assert (cut[1][~near] == 0.0).all()
    assert (cut[2][~near] == -1).all()


def to_triangles(vertices: np.ndarray, triangles: np.ndarray, point: np.ndarray) -> float:
    """Distance to a mesh by the distance to each triangle's corners, edges and interior, one after the other."""
    best = np.inf
    for a, b, c in vertices[triangles]:
        for p, q in ((a, b), (b, c), (c, a)):
            t = np.clip((point - p) @ (q - p) / ((q - p) @ (q - p)), 0.0, 1.0)
            best = min(best, float(np.linalg.norm(point - p - t * (q - p))))
        shares = np.linalg.lstsq(np.array([b - a, c - a]).T, point - a, rcond=None)[0]
        if shares.min() >= 0.0 and shares.sum() <= 1.0:
            best = min(best, float(np.linalg.norm(point - a - shares @ [b - a, c - a])))
    return best


def test_a_mesh_that_is_not_convex_is_signed_by_its_inside() -> None:
    vertices, triangles = l_prism()
    tables = tables_of(mesh_message(vertices, triangles, **TILTED))
    placement = (
        build(messages.Scene(name="t", obstacles=[mesh_message(vertices, triangles, **TILTED)])).obstacles[0].placement
    )
    local = np.random.default_rng(9).uniform(-0.5, 2.5, (300, 3))
    points = np.array([placement.act(p) for p in local])
    distances, normals, _ = distance_at_points(tables, points)
    x, y, z = local.T
    inside = (x > 0) & (y > 0) & (z > 0) & (z < 1) & (x < 2) & (y < 2) & ((x < 1) | (y < 1))
    assert inside.sum() > 20
    expected = np.array([to_triangles(vertices, triangles, p) for p in local]) * np.where(inside, -1.0, 1.0)
    np.testing.assert_allclose(distances, expected, atol=1e-12)
    np.testing.assert_allclose(distance_at_points(tables, points - distances[:, None] * normals)[0], 0.0, atol=1e-9)


def test_moving_the_scene_and_the_points_alike_changes_nothing() -> None:
    motion = pin.SE3(pin.Quaternion(0.3, 0.5, -0.2, 0.7).normalized().matrix(), np.array([1.0, 2.0, -0.5]))
    points = points_about(100, 10)
    for still in (CONVEX["box"], CONVEX["cylinder"], CONVEX["capsule"], CONVEX["convex mesh"]):
        x, y, z, w = still.quaternion_xyzw
        at = motion * pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), np.array(still.position))
        turned = tuple(pin.Quaternion(at.rotation).coeffs().tolist())
        moved = type(still)(
            **{f: getattr(still, f) for f in still.__struct_fields__}
            | {"position": tuple(at.translation.tolist())}
            | {"quaternion_xyzw": turned}
        )
        before, normals, _ = distance_at_points(tables_of(still), points)
        after, turned_normals, _ = distance_at_points(tables_of(moved), points @ motion.rotation.T + motion.translation)
        np.testing.assert_allclose(after, before, atol=1e-9)
        np.testing.assert_allclose(turned_normals, normals @ motion.rotation.T, atol=1e-5)


@pytest.mark.parametrize("points", [np.zeros(3), np.zeros((2, 2)), np.array([[0.0, np.nan, 0.0]])])
def test_points_that_are_none_are_refused(points: np.ndarray) -> None:
    with pytest.raises(ValueError, match="`points`"):
        distance_at_points(tables_of(), points)
