"""The smallest distances along a motion: against many samples by Coal, and attained where they are said to be."""

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.batch import scene_tables
from guidefield.collision.clearance import clearance_at
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.geometry import cache
from guidefield.kernels.jit.cache import cache_folder
from guidefield.kernels.prove.samples import ALL_AT_ONCE, LIST
from guidefield.messages import scene as messages
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.prove import certificate, search
from guidefield.prove.certificate import smallest_along
from guidefield.prove.curve import Curve
from guidefield.prove.search import TOLERANCE, ContradictionError, SearchResult, Smallest
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from tests.collision.plain import are_signed
from tests.collision.scenery import box, scattered, world_of
from tests.collision.test_bodies import ARMS, world
from tests.geometry import solids
from tests.planner.problems import library_scene, scene_of
from tests.planner.test_moving_kinds import KINDS, bare_shapes, moving, placed as frame_at, transform
from tests.robots import box_arm, group, grouped, robot
from tests.scene.solids import mesh_message

COAL_ACCURACY = 1e-6

ACCURACY = 1e-5  # how far a distance by kernels may be from Coal's [m]

SPAN = (0.25, 2.1)
FINER = 10


def motion(planned: PlanningGroup, seed: int, reach: float = 0.8) -> Trajectory:
    """A random cubic motion through a few knots, not at rest in any but the ends; the third waits."""
    rng = np.random.default_rng(seed)
    low = np.where(np.isfinite(planned.lower), planned.lower, -2.0)
    high = np.where(np.isfinite(planned.upper), planned.upper, 2.0)
    middle = rng.uniform(low, high)
    points = np.clip(middle + rng.uniform(-reach, reach, (5, planned.nv)), low, high)
    points[3] = points[2]
    velocities = rng.uniform(-0.5, 0.5, points.shape)
    velocities[[0, 2, 3, -1]] = 0.0
    return Trajectory(np.array([0.0, 0.7, 1.1, 1.5, 2.4]), points, velocities)


def curve_of(trajectory: Trajectory) -> Curve:
    return Curve(trajectory.bezier(), trajectory.piece_times())


def found_along(place: World, trajectory: Trajectory, times: Sequence[float] | None = None) -> SearchResult:
    ends = (0.0, trajectory.duration)
    samples = np.linspace(*ends, 12) if times is None else np.array(times)
    return smallest_along(place, curve_of(trajectory), samples, [ends, SPAN])


def at(planned: PlanningGroup, trajectory: Trajectory, time: float) -> np.ndarray:
    """A configuration of the model, by way of one of the group."""
    return planned.expand(planned.from_local(trajectory.evaluate(np.array([time]))[0][0]))


def plain_distance(place: World, trajectory: Trajectory, answer: Smallest) -> float:
    """The distance of an answer's pair at its time, by Pinocchio and Coal alone."""
    planned, geometry = place.group, place.group.geometry
    data, scratch = planned.model.createData(), geometry.createData()
    q = at(planned, trajectory, answer.time)
    pin.updateGeometryPlacements(planned.model, data, geometry, scratch, q)
    sides = []
    for body in place.pairs.of(answer.pair):
        if body < geometry.ngeoms:
            sides.append([(geometry.geometryObjects[body].geometry, transform(scratch.oMg[body]))])
            continue
        obstacle = place.scene.obstacles[body - geometry.ngeoms]
        if obstacle.motion is None:
            sides.append([(obstacle.shape, transform(obstacle.placement))])
        else:
            message = place.scene.message.obstacles[body - geometry.ngeoms]
            frame = frame_at(message.trajectory, answer.time)
            sides.append([(shape, transform(frame * within)) for shape, within in bare_shapes(message)])
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    distance = min(coal.distance(*one, *other, request, result) for one in sides[0] for other in sides[1])
    distance -= sum(map(place.rounding, place.pairs.of(answer.pair)))
    return max(distance, 0.0) if not are_signed(place)[answer.pair] else distance


def sampled(place: World, trajectory: Trajectory, times: np.ndarray) -> np.ndarray:
    """At times, shape (n, 3): the distance to obstacles, the same within a span, and that of the robot to itself."""
    found = np.full((len(times), 3), np.inf)
    for row, time in zip(found, times, strict=True):
        there = place if not place.scene.moves else World.build(place.group, place.scene.at(time))
        clearance = clearance_at(there, at(place.group, trajectory, time))
        row[[0, 2]] = clearance.obstacle_distance, clearance.self_distance
        if SPAN[0] <= time <= SPAN[1]:
            row[1] = clearance.obstacle_distance
    return found


def check(place: World, trajectory: Trajectory, found: SearchResult, count: int) -> None:
    """No sample is smaller than what is told, and that is attained; they are `FINER` times as dense near the least."""
    times = np.linspace(0.0, trajectory.duration, count)
    even = sampled(place, trajectory, times)
    near = {*even.argmin(axis=0)}
    closer = [np.linspace(*times[[max(k - 1, 0), min(k + 1, count - 1)]], 2 * FINER + 1) for k in near]
    least = np.minimum(even.min(axis=0), sampled(place, trajectory, np.concatenate(closer)).min(axis=0))
    for smallest_of, answer in zip(least, (*found.obstacle, found.own), strict=True):
        if smallest_of <= 1e-4 or answer.distance <= 1e-4:
            assert answer.distance <= 1e-4 + answer.tolerance
            continue
        assert answer.distance - answer.tolerance <= smallest_of + 2 * COAL_ACCURACY
        assert answer.bound == answer.distance - answer.tolerance or answer.pair < 0
        if answer.pair >= 0:
            assert plain_distance(place, trajectory, answer) == pytest.approx(answer.distance, abs=ACCURACY)
    if least.min() > 1e-4:
        samples = sampled(place, trajectory, np.linspace(0.0, trajectory.duration, 12))
        np.testing.assert_allclose(found.distances, samples[:, 0], atol=ACCURACY)


def clear_motion(place: World, reach: float) -> Trajectory:
    """A random motion along which nothing touches at some samples."""
    for seed in range(200):
        trajectory = motion(place.group, seed, reach)
        if sampled(place, trajectory, np.linspace(0.0, trajectory.duration, 25)).min() > 2e-3:
            return trajectory
    raise AssertionError("no motion is clear")


@settings(max_examples=8)
@given(st.sampled_from(sorted(ARMS)), st.integers(0, 10**6))
def test_no_sample_is_closer_for_joints_of_every_kind(name: str, seed: int) -> None:
    place = world(name)
    trajectory = motion(place.group, seed, 0.3)
    check(place, trajectory, found_along(place, trajectory), 60)


@pytest.mark.parametrize(("name", "scene"), [("panda", "bookshelf"), ("panda", "table"), ("ur5", "wall_with_window")])
def test_no_sample_of_an_arm_of_meshes_is_closer(name: str, scene: str) -> None:
    place = World.build(group(name), library_scene(scene))
    trajectory = clear_motion(place, 0.15)
    check(place, trajectory, found_along(place, trajectory), 300)


@pytest.mark.parametrize("kind", KINDS)
def test_no_sample_is_closer_to_what_moves(kind: str) -> None:
    for seed in range(1):
        rng = np.random.default_rng(300 + seed)
        scene = scene_of(moving(kind, kind, rng, 0.0, 2.0), *scattered(rng, 2))
        place = World.build(group("panda"), scene)
        trajectory = motion(place.group, seed, 0.3)
        check(place, trajectory, found_along(place, trajectory), 60)


@pytest.mark.parametrize("name", ["panda", "ur5"])
@pytest.mark.parametrize("seed", range(1))
def test_closed_meshes_whose_large_nodes_have_boxes_are_measured(name, seed, monkeypatch, tmp_path):
    rng = np.random.default_rng(seed)
    ring = solids.lying(solids.torus(rng.uniform(0.5, 1.2), rng.uniform(0.02, 0.1), 120, 24), seed)
    thin = solids.lying(solids.torus(0.4, 0.002, 90, 8), seed + 3)
    place = World.build(group(name), scene_of(mesh_message(*ring, name="r"), mesh_message(*thin, name="t")))
    trajectory = clear_motion(place, 0.15)
    without = found_along(place, trajectory)
    check(place, trajectory, without, 60)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache_folder().parents[1]))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(cache, "LARGE", 1)
    monkeypatch.setattr(scene_tables, "MOST_TRIANGLES", 500)
    place = World.build(
        group(name), scene_of(mesh_message(*ring, name=f"{name} r"), mesh_message(*thin, name=f"{name} t"))
    )
    found = found_along(place, trajectory)
    assert list(cache.folder().glob("lanes-*")), "they count as large"
    for one, other in zip(without.obstacle, found.obstacle, strict=True):
        assert one.distance == pytest.approx(other.distance, abs=ACCURACY)


def test_obstacles_of_every_kind_that_rests_are_measured() -> None:
    rng = np.random.default_rng(4)
    ground = messages.HalfSpace(name="ground", normal=(0.0, 0.0, 1.0), offset=-0.4)
    roof = messages.Polygon(
        name="roof", vertices=[(-1.0, -1.0, 1.6), (1.0, -1.0, 1.6), (1.0, 1.0, 1.5), (-1.0, 1.0, 1.5)]
    )
    corners = [(0.9, y, z) for y in (-0.4, 0.4) for z in (0.1, 0.9)] + [(1.2, 0.0, 0.5)]
    faces = [(0, 1, 2), (1, 3, 2), (0, 2, 4), (2, 3, 4), (3, 1, 4), (1, 0, 4)]
    wedge = messages.Mesh(name="wedge", vertices=corners, triangles=faces)
    place = World.build(group("panda"), scene_of(ground, roof, wedge, *scattered(rng, 3)))
    trajectory = clear_motion(place, 0.1)
    check(place, trajectory, found_along(place, trajectory), 200)


@pytest.mark.parametrize("count", [3, 3000])
def test_clouds_are_measured_as_balls_about_their_points(count: int) -> None:
    rng = np.random.default_rng(count)
    points = rng.uniform(-1.0, 1.0, (count, 3)) * [1.0, 1.0, 0.05] + [0.0, 0.0, 1.5]
    points[: count // 2, 2] -= 2.0
    cloud = messages.PointCloud(name="cloud", points=[*map(tuple, points.tolist())], radius=0.013)
    place = World.build(group("panda"), scene_of(cloud, *scattered(rng, 1)))
    trajectory = clear_motion(place, 0.15)
    check(place, trajectory, found_along(place, trajectory), 60)


@pytest.mark.parametrize("count", [100, 400])
def test_among_many_obstacles_the_nearest_are_found(count: int) -> None:
    """More than are listed at once: a tree of boxes finds those near each segment."""
    rng = np.random.default_rng(count)
    far = [
        box(f"b{k}", (0.05, 0.05, 0.05), tuple(rng.uniform(-1.0, 1.0, 3) * 2.0 + np.sign(rng.normal(size=3)) * 1.2))
        for k in range(count)
    ]
    place = World.build(group("panda"), scene_of(*far, *scattered(rng, 2)))
    trajectory = clear_motion(place, 0.3)
    check(place, trajectory, found_along(place, trajectory), 60)


def test_a_hull_that_is_kilometres_away_is_measured_to_the_same_accuracy() -> None:
    """In single precision its corners would be a millimetre off there; found by tools/doubt."""
    panda, stand = robot("panda"), np.array([-6282.3057, 4235.955, -11033.1812])
    arm = select(panda, None, None, panda.rest, pin.SE3(np.eye(3), stand))
    corners = np.array([(x, y, z) for x in (0.7, 1.1) for y in (-0.3, 0.4) for z in (0.1, 0.8)]) + stand
    faces = [(0, 1, 3), (0, 3, 2), (4, 7, 5), (4, 6, 7), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6)]
    faces += [(0, 6, 4), (1, 5, 7), (1, 7, 3)]
    block = messages.Mesh(name="block", vertices=[tuple(corner) for corner in corners.tolist()], triangles=faces)
    plane = messages.HalfSpace(name="plane", normal=(0.0, 0.0, 1.0), offset=float(stand[2]) - 0.6)
    rng = np.random.default_rng(3)
    points = rng.uniform((-0.8, -0.8, 1.3), (0.8, 0.8, 1.6), (40, 3)) + stand
    cloud = messages.PointCloud(name="cloud", points=[tuple(point) for point in points.tolist()], radius=0.02)
    ball = messages.Sphere(name="ball", radius=0.1, position=tuple(np.add(stand, (-0.9, 0.0, 0.4)).tolist()))
    place = World.build(arm, scene_of(block, plane, cloud, ball))
    trajectory = clear_motion(place, 0.1)
    check(place, trajectory, found_along(place, trajectory), 100)


def test_in_contact_the_depth_is_that_of_the_worst_of_some_samples() -> None:
    arm = grouped(box_arm("slide", 1))
    place = world_of(arm, [box("wall", (1.0, 1.0, 0.2), (0.0, 0.0, 3.0))])
    far = clearance_at(place, np.zeros(1)).obstacle_distance
    pieces = np.array([[[0.0], [far + 0.05]], [[far + 0.05], [0.0]]])
    samples = np.linspace(0.0, 2.0, 9)
    found = smallest_along(place, Curve(pieces, np.arange(3.0)), samples, [(0.0, 2.0), (0.0, 0.5)])
    assert found.obstacle[0].distance == pytest.approx(-0.05, abs=1e-6)
    assert found.obstacle[0].time == 1.0
    assert found.obstacle[1].distance == pytest.approx(far - 0.5 * (far + 0.05), abs=1e-5)
    assert found.distances[4] == pytest.approx(-0.05, abs=1e-6)


@pytest.mark.parametrize("off", [-1e-3, 1e-3])
def test_a_smallest_distance_that_coal_does_not_confirm_is_no_answer(monkeypatch, off):
    place = World.build(group("panda"), library_scene("bookshelf"))
    trajectory = clear_motion(place, 0.15)
    measure = World.distance
    monkeypatch.setattr(World, "distance", lambda self, *asked: (measure(self, *asked)[0] + off, None))
    with pytest.raises(ContradictionError, match="Coal has"):
        found_along(place, trajectory)


def test_a_motion_that_goes_nowhere_is_one_place() -> None:
    place = world("planar")
    z = np.zeros(place.group.nv)
    still = Curve(np.tile(z, (1, 4, 1)), np.zeros(2))
    found = smallest_along(place, still, np.zeros(1), [(0.0, 0.0)])
    exact = clearance_at(place, place.group.expand_from_local(z)).obstacle_distance
    assert found.obstacle[0].distance == pytest.approx(exact, abs=ACCURACY)


def test_nothing_to_measure_is_infinite() -> None:
    place = world_of(group("panda"), [])
    found = found_along(place, motion(place.group, 1))
    assert (found.obstacle[0].distance, found.obstacle[0].bound, found.obstacle[0].pair) == (np.inf, np.inf, -1)
    assert found.own.pair >= 0


def test_a_search_that_is_stopped_tells_what_is_certain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "SEGMENTS_AT_ONCE", 4)
    place = World.build(group("panda"), library_scene("bookshelf"))
    trajectory = clear_motion(place, 0.15)
    ends = (0.0, trajectory.duration)
    exact = found_along(place, trajectory).obstacle[0]
    bounds = []
    for patience in (0, 2, 5, 1000):
        left = iter(range(patience))
        deadline = Deadline(is_cancelled=lambda left=left: next(left, None) is None)
        found = smallest_along(place, curve_of(trajectory), np.array(ends), [ends], deadline=deadline)
        assert found.obstacle[0].bound <= exact.distance <= found.obstacle[0].distance + TOLERANCE
        bounds.append(found.obstacle[0].bound)
    assert bounds == sorted(bounds)
    assert bounds[0] < exact.distance - TOLERANCE
    assert bounds[-1] == pytest.approx(exact.distance - TOLERANCE, abs=TOLERANCE)


def test_one_search_tells_the_verdict_and_the_smallest_distances() -> None:
    place = World.build(group("panda"), library_scene("bookshelf"))
    trajectory = clear_motion(place, 0.15)
    curve, samples = curve_of(trajectory), np.linspace(0.0, trajectory.duration, 12)
    spans = [(0.0, trajectory.duration)]
    apart = smallest_along(place, curve, samples, spans)
    least = apart.obstacle[0].distance
    for min_clearance, free in ((0.0, True), (least - 2e-4, True), (least + 1e-4, False)):
        both = smallest_along(place, curve, samples, spans, min_clearance)
        assert both.verdict.free == free
        assert both.obstacle[0].distance == pytest.approx(least, abs=TOLERANCE)


def test_the_curve_is_the_trajectory() -> None:
    trajectory = motion(group("panda"), 4)
    curve, times = curve_of(trajectory), np.linspace(0.0, trajectory.duration, 50)
    np.testing.assert_allclose(curve.at(times), trajectory.evaluate(times)[0], atol=1e-12)
    for at in range(3):
        np.testing.assert_allclose(
            curve.point(at, 0.5), curve.at(trajectory.times[at : at + 2].mean(keepdims=True))[0], atol=1e-12
        )


def test_no_more_samples_than_a_few_are_measured_in_contact(monkeypatch: pytest.MonkeyPatch) -> None:
    place, asked, clearances = (
        World.build(group("ur5"), library_scene("wall_with_window")),
        [],
        certificate.ClosestPairs,
    )
    real = clearances.clearances

    def counted(self, configurations, times=None, **told):
        asked.append(len(configurations))
        return real(self, configurations, times, **told)

    monkeypatch.setattr(clearances, "clearances", counted)
    for seed in range(5):
        found_along(place, motion(place.group, seed, 1.6))
    assert asked
    assert max(asked) <= certificate.DEPTHS + 3


def test_obstacles_thousands_of_kilometres_away_are_found_by_samples() -> None:
    away = 5e6
    place = world_of(group("ur5"), [box(f"{k}", (0.1, 0.1, 0.1), (away, 0.3 * k, 0.5)) for k in range(ALL_AT_ONCE + 1)])
    found = found_along(place, motion(place.group, 4, 0.2))
    np.testing.assert_allclose(found.distances, away, atol=2.0)


def test_a_search_ends_when_time_is_up_though_too_many_pairs_are_as_near() -> None:
    """More pairs than a search lists are as near as the nearest in segments however short."""

    class Late:
        """A deadline that has passed."""

        def expired(self) -> bool:
            return True

    away, side = 5e5, 150
    grid = [box(f"{k}", (0.1, 0.1, 0.1), (away, 0.2 * (k % side), 0.2 * (k // side))) for k in range(side**2)]
    place = world_of(group("ur5"), grid)
    assert len(grid) > LIST
    ends = 0.0, 2.4
    goal = search.SearchQuery(None, spans=[ends], samples=np.linspace(*ends, 5))
    found = search.search(place, curve_of(motion(place.group, 4, 0.2)), goal, Late())
    assert found.obstacle[0].distance == pytest.approx(away, abs=2.0)
    assert found.obstacle[0].bound == -np.inf
