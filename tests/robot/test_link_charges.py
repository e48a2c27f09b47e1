"""Charges of links: points that share the area, capsules that contain them, and which links repel each other."""

import math

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.geometry import surfaces
from guidefield.geometry.surfaces import Surface
from guidefield.kernels.cover.enclosing_ball import enclosing_circle
from guidefield.kernels.distance.distance import DistanceTables, distance_at_points
from guidefield.robot.link_charges import ALWAYS_CLOSE, Capsule, fit_capsule, link_bodies, robot_charges, surface_points
from guidefield.robot.model.model import RobotModel
from tests.geometry.measures import areas
from tests.kernels.evaluation import vectors
from tests.oracles import distance_to_segment, distance_to_triangle
from tests.robots import ARMS, robot


def gap(model: RobotModel, placements: list[pin.SE3], i: int, j: int) -> float:
    """Smallest distance from the points of one shape to the capsule of another one [m]."""
    charged = robot_charges(model).shapes
    points, capsule = charged[i].points, charged[j].capsule
    p0, p1 = (placements[j].act(np.asarray(end)) for end in (capsule.p0, capsule.p1))
    least = np.inf
    for point in points:
        there = placements[i].act(point)
        share = np.clip((there - p0) @ (p1 - p0) / max((p1 - p0) @ (p1 - p0), 1e-30), 0.0, 1.0)
        least = min(least, float(np.linalg.norm(there - p0 - share * (p1 - p0))))
    return least - capsule.radius


@pytest.mark.parametrize("name", ["panda", "ur5", "chain_fixed_12x155_r22"])
def test_links_repel_that_are_apart_at_rest(name: str) -> None:
    model = robot(name)
    data, geometry_data = model.model.createData(), model.geometry.createData()
    pin.updateGeometryPlacements(model.model, data, model.geometry, geometry_data, model.rest)
    charged = robot_charges(model)
    expected = []
    for pair in model.geometry.collisionPairs:
        i, j = pair.first, pair.second
        radius = max(charged.shapes[i].capsule.radius, charged.shapes[j].capsule.radius)
        least = min(gap(model, geometry_data.oMg, i, j), gap(model, geometry_data.oMg, j, i))
        if abs(least - ALWAYS_CLOSE * radius) < 1e-9:
            pytest.skip("a pair at the very bound")
        if least >= ALWAYS_CLOSE * radius:
            expected.append((i, j))
    assert list(charged.repelling) == expected
    assert expected


def alone(tables: DistanceTables, index: int) -> DistanceTables:
    """The tables of one body."""
    picked = {name: np.ascontiguousarray(getattr(tables, name)[[index]]) for name in tables._fields[:7]}
    for array in picked.values():
        array.setflags(write=False)
    return tables._replace(**picked)


@pytest.mark.parametrize("name", ARMS)
def test_distances_to_links_are_those_of_coal(name: str) -> None:
    model, tables = robot(name), link_bodies(robot(name))
    assert link_bodies(robot(name)) is tables
    assert len(tables.kinds) == model.geometry.ngeoms
    rng = np.random.default_rng(0)
    here = coal.Transform3s.Identity()
    for index, shape in enumerate(model.geometry.geometryObjects):
        low, high = tables.bounds[index, :3], tables.bounds[index, 3:]
        points = rng.uniform(low - 0.05, high + 0.05, (25, 3))
        distances, _, _ = distance_at_points(alone(tables, index), points)
        for point, distance in zip(points, distances, strict=True):
            at, result = coal.Transform3s(np.eye(3), point), coal.DistanceResult()
            expected = coal.distance(coal.Sphere(1e-9), at, shape.geometry, here, coal.DistanceRequest(), result) + 1e-9
            # of a mesh Coal knows no inside, and within a hull not always the least depth
            ours = abs(distance) if isinstance(shape.geometry, coal.BVHModelBase) else distance
            assert ours == pytest.approx(expected, abs=1e-6) or (expected < 0.0 and ours < 0.0)


SHAPES = {
    "box": (surfaces.box((0.3, 0.5, 0.4)), 0.1),
    "plate": (surfaces.box((0.5, 0.002, 0.4)), 0.08),
    "cylinder": (surfaces.cylinder(0.1, 0.6), 0.08),
    "sphere": (surfaces.sphere(0.2), 0.1),
    "small for its spacing": (surfaces.box((0.01, 0.01, 0.01)), 0.1),
    "sliver": (surfaces.surface(np.array([[0, 0, 0], [1, 0, 0], [0.5, 1e-6, 0]]), np.array([[0, 1, 2]])), 0.1),
}

shapes = pytest.mark.parametrize(("shape", "spacing"), SHAPES.values(), ids=SHAPES)


@shapes
def test_points_lie_on_the_surface_with_its_normals(shape: Surface, spacing: float) -> None:
    charges = surface_points(*shape, spacing)
    for point, normal in zip(charges.points, charges.normals, strict=True):
        distances = [distance_to_triangle(point, corners) for corners in shape.corners]
        assert min(distances) < 1e-12
        a, b, c = shape.corners[int(np.argmin(distances))]
        across = np.cross(b - a, c - a)
        assert normal == pytest.approx(across / np.linalg.norm(across), abs=1e-9)


@shapes
def test_weights_share_the_area(shape: Surface, spacing: float) -> None:
    charges = surface_points(*shape, spacing)
    assert charges.weights.sum() == pytest.approx(areas(shape).sum())
    assert (charges.weights > 0.0).all()
    # No share is larger than the disc that its point may have to itself, on both sides of a thin plate.
    assert charges.weights.max() <= 2.0 * math.pi * spacing**2


@shapes
def test_points_keep_their_distance_and_leave_no_gap(shape: Surface, spacing: float) -> None:
    charges = surface_points(*shape, spacing)
    between = np.linalg.norm(charges.points[:, None] - charges.points[None], axis=2)
    assert (between + np.diag(np.full(len(between), np.inf)) >= spacing).all()
    rng = np.random.default_rng(1)
    owners = rng.choice(len(shape.triangles), size=2000, p=areas(shape) / areas(shape).sum())
    shares = rng.dirichlet((1.0, 1.0, 1.0), size=2000)
    samples = np.einsum("ij,ijk->ik", shares, shape.corners[owners])
    nearest = np.linalg.norm(samples[:, None] - charges.points[None], axis=2).min(axis=1)
    # The candidates are an eighth of the spacing apart, and hardly ever more than twice that.
    assert nearest.max() <= 1.25 * spacing


laws = settings(deadline=None, max_examples=15)


def outside(capsule: Capsule, points: np.ndarray) -> float:
    return max(distance_to_segment(point, capsule.p0, capsule.p1) for point in points) - capsule.radius


def test_points_close_together_far_away_are_contained() -> None:
    points = np.array([7.3, -2.9, 8.8]) + 1e-15 * np.random.default_rng(2).normal(size=(20, 3))
    assert outside(fit_capsule(points), points) <= 0.0


@laws
@given(st.lists(vectors(10.0), min_size=1, max_size=40).map(np.array), st.floats(-5.0, 5.0))
def test_capsule_contains_its_points(points: np.ndarray, exponent: float) -> None:
    scaled = 10.0**exponent * points
    capsule = fit_capsule(scaled)
    assert outside(capsule, scaled) <= 0.0
    assert capsule.distance(scaled).max() <= 0.0
    # Not more than the ball about the middle of the box about the points, which is a capsule too.
    middle = 0.5 * (scaled.min(axis=0) + scaled.max(axis=0))
    ball = np.linalg.norm(scaled - middle, axis=1).max()
    # A quarter more, because the search is local.
    assert capsule.volume <= 1.25 * 4.0 / 3.0 * math.pi * (ball + 1e-14 * np.abs(scaled).max()) ** 3


@laws
@given(vectors(1.0), vectors(1.0).filter(lambda v: np.linalg.norm(v) > 0.3), st.floats(0.02, 0.2))
def test_a_capsule_is_found_again(start: np.ndarray, axis: np.ndarray, radius: float) -> None:
    length = float(np.linalg.norm(axis))
    frame = np.linalg.qr(np.column_stack([axis, np.eye(3)[np.abs(axis).argmin()]]), mode="complete")[0]
    along = frame[:, 0] * np.sign(frame[:, 0] @ axis)
    turn = np.column_stack([frame[:, 1], np.cross(along, frame[:, 1]), along])
    points = surfaces.capsule(radius, length).vertices @ turn.T + start
    capsule = fit_capsule(points)
    exact = math.pi * radius**2 * (length + 4.0 / 3.0 * radius)
    assert outside(capsule, points) <= 0.0
    # Where it is short, a slanted one can beat it: its points are few.
    assert capsule.volume <= 1.001 * exact
    assert capsule.volume >= 0.9 * exact


@laws
@given(st.floats(1e-3, 1.0), st.floats(0.0, 10.0))
def test_the_capsule_about_a_round_shape_contains_it(radius: float, ratio: float) -> None:
    """Motions are proved by capsules fitted to triangulated links: whose vertices alone are on a round one."""
    length = ratio * radius
    for shape, half in ((surfaces.sphere(radius), 0.0), (surfaces.capsule(radius, length), 0.5 * length)):
        capsule, end = fit_capsule(shape.vertices), np.array([0.0, 0.0, half])
        ball = radius * surfaces.spread_directions(500)
        ends = np.concatenate([ball + end, ball - end])
        assert capsule.distance(ends).max() <= 0.0


@laws
@given(st.lists(vectors(10.0).map(lambda v: v[:2]), min_size=1, max_size=12).map(np.array))
def test_enclosing_circle_is_the_smallest(points: np.ndarray) -> None:
    circle = np.empty(3)
    enclosing_circle(np.ascontiguousarray(points), circle)
    centre, radius = circle[:2], circle[2]
    assert (np.linalg.norm(points - centre, axis=1) <= radius * (1.0 + 1e-12)).all()
    # The farthest points hold it: no step of the centre gets nearer to all of them.
    for angle in np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False):
        moved = centre + 1e-4 * radius * np.array([np.cos(angle), np.sin(angle)])
        assert np.linalg.norm(points - moved, axis=1).max() >= radius * (1.0 - 1e-9)
