"""The narrow phase: thin bodies and hulls against Coal, known faults, and depths against the least overlap."""

import dataclasses
import itertools
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from hypothesis import given, strategies as st
from scipy.optimize import lsq_linear

from guidefield.collision.clearance import clearance_at, contacts_at
from guidefield.collision.narrow_phase import NarrowPhase, transform
from guidefield.geometry.convex import bvh
from guidefield.messages import scene as messages
from guidefield.messages.scene import Mesh
from guidefield.planner.guide.guide import find_touched_obstacle
from guidefield.referee import shapes as referee
from guidefield.robot.group.group import Alike
from tests.collision.plain import touching
from tests.collision.scenery import box, panda_in, scattered, world_of
from tests.planner.problems import scene_of
from tests.robots import box_arm, group, grouped, random_configuration, rest

PLATE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float), np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize("axis", range(3))
def test_a_polygon_across_an_axis_is_touched(axis):
    arm = group("panda")
    square = np.array([[0.0, -0.2, -0.2], [0.0, 0.2, -0.2], [0.0, 0.2, 0.2], [0.0, -0.2, 0.2]])
    corners = np.roll(square, axis, axis=1) + np.array([0.307, 0.0, 0.6])
    for order in (corners, corners[::-1]):
        wall = messages.Polygon(name="wall", vertices=[tuple(row) for row in order.tolist()])
        assert world_of(arm, [wall]).in_collision(rest(arm))


@pytest.mark.parametrize("shape", [bvh(*PLATE), coal.Box(0.1, 0.2, 0.0)])
def test_a_flat_shape_of_a_link_is_touched(shape):
    arm = grouped(box_arm("y", 1))
    geometry = arm.geometry.copy()
    for body in geometry.geometryObjects:
        if body.parentJoint == 1:
            body.geometry = shape
            body.placement = pin.SE3.Identity()
    world = world_of(
        dataclasses.replace(arm, geometry=geometry, alike=Alike()),
        [box("crate", (0.05, 0.05, 0.05), (0.02, 0.02, 0.3))],
    )
    assert world.in_collision(np.zeros(1))


def test_a_distance_has_the_same_bits_whatever_was_asked_before():
    world = panda_in("bookshelf")
    qs = [random_configuration(world.group, seed) for seed in range(20)]
    forwards = [clearance_at(world, q) for q in qs]
    backwards = [clearance_at(world, q) for q in qs[::-1]][::-1]
    for a, b in zip(forwards, backwards, strict=True):
        assert a.obstacle_distance == b.obstacle_distance
        assert a.self_distance == b.self_distance
        assert np.array_equal(a.witness, b.witness)


@pytest.mark.parametrize("first", ["mesh", "box"])
@pytest.mark.parametrize("second", ["mesh", "cylinder", "capsule"])
def test_a_distance_up_to_a_bound_is_the_same_and_beyond_it_is_beyond(first, second):
    mesh = trimesh.creation.torus(0.3, 0.1)
    made = {
        "mesh": bvh(mesh.vertices, mesh.faces),
        "box": coal.Box(0.3, 0.2, 0.1),
        "cylinder": coal.Cylinder(0.1, 0.3),
        "capsule": coal.Capsule(0.1, 0.3),
    }
    rng = np.random.default_rng(3)
    for _ in range(20):
        turns = [pin.Quaternion(rng.normal(size=4)).normalized().matrix() for _ in range(2)]
        there = np.array([0.0, 3.0, 0.0]) + rng.normal(size=3)
        stand = [pin.SE3(turn, at) for turn, at in zip(turns, (np.zeros(3), there), strict=True)]
        narrow = NarrowPhase(lambda body: made[(first, second)[body]], lambda body, at=stand: transform(at[body]))
        apart = narrow.distance(0, 1).distance
        assert apart > 0.0
        assert narrow.distance(0, 1, 1.001 * apart).distance == pytest.approx(apart, rel=0.0, abs=1e-9)
        for bound in (0.1 * apart, 0.999 * apart):
            assert narrow.distance(0, 1, bound).distance >= bound


FLAT = {
    "three corners in a line": [(0.0, 0.0, 0.0), (1.0, 0.2, -0.3), (0.5, 0.1, -0.15)],
    "two corners at one place": [(0.0, 0.0, 0.0), (1.0, 0.2, -0.3), (0.0, 0.0, 0.0)],
    "all corners at one place": [(0.5, 0.1, -0.15), (0.5, 0.1, -0.15), (0.5, 0.1, -0.15)],
}
RADIUS = 0.05


def from_segment(point: np.ndarray, corners: np.ndarray) -> float:
    a, b = corners[0], corners[1]
    along = (point - a) @ (b - a) / max((b - a) @ (b - a), 1e-300)
    return float(np.linalg.norm(point - a - np.clip(along, 0.0, 1.0) * (b - a)))


@pytest.mark.parametrize("kind", list(FLAT))
@given(seed=st.integers(0, 2**32 - 1))
def test_a_ball_is_as_far_from_a_flat_triangle_as_it_is(kind, seed):
    corners = np.array(FLAT[kind])
    shapes = [bvh(corners, np.array([[0, 1, 2]])), coal.Sphere(RADIUS)]
    place = np.random.default_rng(seed).normal(size=3)
    stand = [pin.SE3.Identity(), pin.SE3(np.eye(3), place)]
    there = from_segment(place, corners) - RADIUS
    for order in ((0, 1), (1, 0)):
        narrow = NarrowPhase(
            lambda body, order=order: shapes[order[body]], lambda body, order=order: transform(stand[order[body]])
        )
        if there > 0.0:
            assert narrow.distance(0, 1).distance == pytest.approx(there, rel=0.0, abs=1e-6)
            assert narrow.penetration(0, 1) is None
        assert narrow.penetration(0, 1, abs(there) + 1e-5) is not None


def test_a_ball_fits_beside_a_mesh_with_flat_triangles():
    corners = [*FLAT["three corners in a line"], (0.0, 0.0, 1.0)]
    scene = scene_of(Mesh(name="fin", vertices=corners, triangles=[(0, 1, 2), (0, 1, 3)]))
    places = np.random.default_rng(1).normal(size=(50, 3)) + np.array([0.0, 5.0, 0.0])
    assert [find_touched_obstacle(scene, place, RADIUS) for place in places] == [None] * 50


ACCURACY = 2e-6
"""How far off Coal's distances of bodies that nearly touch are, as those of the certificate are taken to be [m]."""

BLADE = coal.Box(2.0, 0.0002, 0.02)
WALL = coal.Box(0.1, 4.0, 4.0)


def at(x: float, y: float = 0.0, z: float = 0.0, rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Any:
    return coal.Transform3s(pin.rpy.rpyToMatrix(*rpy), np.array([x, y, z]))


def measured(first: Any, here: Any, second: Any, there: Any) -> tuple[float, np.ndarray, np.ndarray]:
    return NarrowPhase((first, second).__getitem__, (here, there).__getitem__).distance(0, 1)


def reach(shape: Any, place: Any, directions: np.ndarray) -> np.ndarray:
    """How far a placed shape reaches along directions of the world, shape (n, 3): written out for each kind."""
    local = directions @ place.getRotation()
    if isinstance(shape, coal.Box):
        own = np.abs(local) @ shape.halfSide
    elif isinstance(shape, coal.Cylinder):
        own = shape.halfLength * np.abs(local[:, 2]) + shape.radius * np.linalg.norm(local[:, :2], axis=1)
    elif isinstance(shape, coal.Capsule):
        own = shape.halfLength * np.abs(local[:, 2]) + shape.radius
    elif isinstance(shape, coal.Sphere):
        own = np.full(len(local), shape.radius)
    else:
        own = (local @ np.array(shape.points()).T).max(axis=1)
    return own + directions @ place.getTranslation()


def overlaps(first: Any, here: Any, second: Any, there: Any, directions: np.ndarray) -> np.ndarray:
    """How far the second has to be moved along each unit direction until they are apart [m]."""
    return reach(first, here, directions) + reach(second, there, -directions)


def by_axes(first: Any, here: Any, second: Any, there: Any) -> float:
    """Depth of two boxes: the separating axes of boxes are their faces' and the edges' cross products."""
    axes = [place.getRotation().T for place in (here, there)]
    crossed = np.cross(axes[0][:, None], axes[1][None]).reshape(-1, 3)
    found = np.concatenate([*axes, crossed[np.linalg.norm(crossed, axis=1) > 1e-9]])
    units = found / np.linalg.norm(found, axis=1)[:, None]
    return float(overlaps(first, here, second, there, np.concatenate([units, -units])).min())


def least_overlap(first: Any, here: Any, second: Any, there: Any, *more: np.ndarray) -> float:
    """The least overlap over directions, and some more, that grow denser about the best ones."""
    rng = np.random.default_rng(0)
    best = np.concatenate([rng.normal(size=(20_000, 3)), *([one] for one in more if one.any())])
    for width in 0.3 * 0.5 ** np.arange(25):
        best /= np.linalg.norm(best, axis=1)[:, None]
        best = best[np.argsort(overlaps(first, here, second, there, best))[:20]]
        near = (best[:, None] + width * rng.normal(size=(len(best), 200, 3))).reshape(-1, 3)
        best = np.concatenate([best, near])
    return float(overlaps(first, here, second, there, best[:20]).min())


@pytest.mark.parametrize("gap", [1e-6, 0.0, -1e-6, -1e-5, -1e-3])
def test_a_blade_that_touches_a_wall_is_as_deep_as_it_is(gap: float) -> None:
    others = [
        (WALL, at(2.05 + gap)),
        (coal.Cylinder(0.5, 4.0), at(2.5 + gap)),
        (coal.Box(0.1, 0.3, 0.02), at(2.05 + gap, 0.1)),
        (coal.Capsule(0.05, 0.3), at(2.05 + gap)),
        (coal.Sphere(0.05), at(2.05 + gap)),
    ]
    for (other, there), blade in itertools.product(others, (BLADE, coal.Cylinder(0.0001, 2.0))):
        here = at(1.0) if blade is BLADE else at(1.0, rpy=(0.0, np.pi / 2, 0.0))
        for angle in (0.0, 5e-5, 5e-5 + 1e-9, -0.0025, 0.002498):
            turned = coal.Transform3s(pin.rpy.rpyToMatrix(0.0, 0.0, angle), np.zeros(3))
            place = turned * here
            found = measured(blade, place, other, there)
            swapped = measured(other, there, blade, place)
            if found[0] > 0.0:
                continue
            expected = -by_axes(blade, place, other, there) if blade is BLADE and isinstance(other, coal.Box) else None
            for one in (found, swapped):
                assert -2.1e-3 <= one[0] <= max(gap, 0.0) + ACCURACY, "it is no deeper than it was pushed"
                if expected is not None:
                    assert one[0] == pytest.approx(expected, abs=2e-6)


@pytest.mark.parametrize("seed", range(3))
def test_a_point_inside_a_round_body_is_as_deep_as_it_is(seed: int) -> None:
    """Coal's depth is up to a hundredth too little there."""
    rng, thin = np.random.default_rng(seed), 2e-6
    for point in (coal.Box(thin, thin, thin), coal.Cylinder(thin, thin), coal.Capsule(thin, thin), coal.Sphere(thin)):
        radius, half, share = rng.uniform(0.02, 0.3), rng.uniform(0.1, 0.5), rng.choice([0.0, 0.1, 0.8])
        place = at(*rng.normal(size=3), tuple(rng.uniform(-3.0, 3.0, 3)))
        angle = rng.uniform(-np.pi, np.pi)
        offset = share * radius * np.array([np.cos(angle), np.sin(angle), 0.0])
        inside = coal.Transform3s(pin.rpy.rpyToMatrix(*rng.uniform(-3.0, 3.0, 3)), place.transform(offset))
        for round_body in (coal.Cylinder(radius, 2.0 * half), coal.Capsule(radius, 2.0 * half)):
            end = half + (radius if isinstance(round_body, coal.Capsule) else 0.0)
            depth = min(radius * (1.0 - share), end)
            for found in (measured(point, inside, round_body, place), measured(round_body, place, point, inside)):
                assert -found[0] == pytest.approx(depth, abs=1e-5)


def test_a_blades_tip_in_a_wall_is_where_the_witnesses_are() -> None:
    for distance, on_blade, on_wall in (
        measured(BLADE, at(1.0), WALL, at(2.05 - 1e-6)),
        measured(BLADE, at(1.0), WALL, at(2.04)),
    ):
        assert on_blade[0] == pytest.approx(2.0, abs=1e-6)
        assert on_blade[0] - on_wall[0] == pytest.approx(-distance, abs=1e-6)
        assert on_blade[1:] == pytest.approx(on_wall[1:], abs=1e-6)


def shapes(rng: np.random.Generator) -> Any:
    size = 10.0 ** rng.uniform(-4.0, 0.3, 3)
    hull = coal.StdVec_Vec3s()
    for point in rng.normal(size=(8, 3)) * size:
        hull.append(point)
    kinds = [
        coal.Box(*size),
        coal.Cylinder(size[0], size[1]),
        coal.Capsule(size[0], size[1]),
        coal.Sphere(size[0]),
        coal.Convex.convexHull(hull, True, "Qt"),
    ]
    return kinds[rng.integers(len(kinds))]


@pytest.mark.parametrize("seed", range(60))
def test_no_direction_leads_out_sooner_than_the_depth(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = shapes(rng), shapes(rng)
    turns = [
        rng.integers(-2, 3, 3) * np.pi / 2.0 if rng.random() < 0.5 else rng.uniform(-3.0, 3.0, 3) for _ in range(2)
    ]
    here, there = (at(*(0.02 * rng.normal(size=3)), rpy=tuple(turn)) for turn in turns)
    found, on_first, on_second = measured(first, here, second, there)
    if found > 0.0:
        return
    least = least_overlap(first, here, second, there, on_first - on_second)
    assert -found <= least + 1e-5 * (1.0 + least)
    assert -found >= least - 1e-5 * (1.0 + least)


def axes_apart(here: Any, p: float, there: Any, q: float) -> float:
    """Least distance of two capsules' axes, as least squares with bounds."""
    axes = np.column_stack([here.getRotation()[:, 2], -there.getRotation()[:, 2]])
    between = there.getTranslation() - here.getTranslation()
    bounds = np.array([p, q]) + 1e-300
    found = lsq_linear(axes, between, (-bounds, bounds), "bvls", tol=1e-15)
    return float(np.linalg.norm(found.fun))


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-6, 3e-4, 0.01, 0.3, 1.5])
@pytest.mark.parametrize("lengths", [(0.3, 0.3), (0.01, 0.02), (0.001, 0.001), (0.1, 0.0)])
def test_capsules_are_as_far_apart_as_their_axes_also_where_these_are_nearly_parallel(lengths, angle):
    rng = np.random.default_rng(3)
    for _ in range(6):
        first, second = (coal.Capsule(0.01, length) for length in lengths)
        here = at(*rng.normal(size=3), tuple(rng.uniform(-3, 3, 3)))
        off = np.array([0.0, 0.02 + rng.choice([1e-7, -1e-5, 0.01]), 0.01 * rng.normal()])
        there = here * at(*off, tuple(angle * rng.choice([[1, 0, 0], [0, 1, 0]])))
        expected = axes_apart(here, first.halfLength, there, second.halfLength) - 0.02
        told = measured(first, here, second, there)
        assert told.distance == pytest.approx(expected, abs=2e-9)
        assert np.linalg.norm(told.second - told.first) == pytest.approx(abs(expected), abs=2e-9)
        assert referee.distance(first, here, second, there) == pytest.approx(expected, abs=2e-9)
        apart = NarrowPhase((first, second).__getitem__, (here, there).__getitem__).penetration(0, 1)
        assert (apart is not None) == (told.distance <= 0.0)


@pytest.mark.parametrize(
    ("first", "second", "turned"),
    [
        (coal.Sphere(0.02), coal.Cylinder(0.05, 0.4), (0.0, 0.0, 0.0)),
        (coal.Cylinder(0.05, 0.4), coal.Sphere(0.02), (0.0, 0.3, 0.0)),
        (coal.Capsule(0.02, 0.3), coal.Capsule(0.04, 0.2), (0.0, np.pi / 2, 0.0)),
        (coal.Capsule(0.02, 0.3), coal.Capsule(0.04, 0.2), (np.pi / 2, 0.0, 0.0)),
        (coal.Capsule(0.02, 0.3), coal.Capsule(0.04, 0.2), (0.0, 0.2, 0.0)),
        (coal.Capsule(0.02, 0.3), coal.Capsule(0.04, 0.2), (0.0, 0.0, 0.0)),
        (coal.Box(0.1, 0.2, 0.3), coal.Box(0.1, 0.2, 0.3), (0.0, 0.0, 0.0)),
    ],
)
def test_bodies_about_one_middle_part_along_their_deepest_points(first, second, turned):
    here, there = at(0.3, -0.2, 0.5), at(0.3, -0.2, 0.5, turned)
    depth, on_first, on_second = measured(first, here, second, there)
    between = on_first - on_second
    assert np.linalg.norm(between) == pytest.approx(-depth, rel=1e-3, abs=ACCURACY)
    along = between / np.linalg.norm(between)
    assert overlaps(first, here, second, there, along[None])[0] == pytest.approx(-depth, rel=2e-3)
    assert -depth <= least_overlap(first, here, second, there) + ACCURACY


@pytest.mark.parametrize("seed", range(3))
def test_contacts_are_those_of_the_meshes(seed):
    arm, rng = group("ur5"), np.random.default_rng(seed)
    world = world_of(arm, scattered(rng, 12))
    seen = 0
    for _ in range(15):
        q = arm.random(rng)
        expected = [world.pair_names(k) for k in touching(world, arm.expand(q))]
        assert [contact.pair for contact in contacts_at(world, q)] == expected
        seen += len(expected)
    assert seen
