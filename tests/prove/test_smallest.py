"""The smallest distances along a motion: against 4000 samples by Coal, and attained where they are said to be."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.clearance import clearance_at
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.kernels.prove import smallest as kernels
from guidefield.kernels.prove.closing import BENT, TRAVEL, closing_of, find_moves
from guidefield.kernels.prove.places import find_twists, place_at
from guidefield.kernels.prove.tables import MovingRobot
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.prove.curve import Curve
from guidefield.prove.places import Surveyor
from guidefield.prove.smallest import TOLERANCE, Question, Smallest, smallest
from guidefield.prove.tables import bezier_curve, body_pairs, resting_obstacles, robot_bodies
from guidefield.prove.timed_world import TimedWorld
from guidefield.robot.group.group import PlanningGroup
from tests.collision.listed import are_mixed, are_signed
from tests.collision.scenery import scattered, world_of
from tests.collision.test_motion_bound import ARMS, corners, placed, world
from tests.planner.problems import library_scene, scene_of
from tests.planner.test_moving_kinds import KINDS, bare_shapes, moving, placed as frame_at, transform
from tests.robots import group

COAL_ACCURACY = 1e-6
SAMPLES, FINER = 400, 10


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


def surveyor_of(place: World, trajectory: Trajectory) -> Surveyor:
    resting = World.build(place.group, place.scene.resting)
    return Surveyor(TimedWorld.of(resting, place), Curve(trajectory.bezier(), trajectory.piece_times()))


def found_along(place: World, trajectory: Trajectory, span: tuple[float, float] | None = None) -> list[Smallest]:
    """The smallest distance to obstacles, the same in a span of time, and that of the robot to itself."""
    surveyor, (start, end) = surveyor_of(place, trajectory), (0.0, trajectory.duration)
    span = span or (0.3, end - 0.4)
    times = np.unique(np.r_[np.linspace(start, end, 12), span, surveyor.breaks.clip(start, end)])
    mixed = are_mixed(place)
    questions = [Question(mixed, start, end), Question(mixed, *span), Question(~mixed, start, end)]
    return smallest(surveyor, surveyor.places(times), questions)


def at(planned: PlanningGroup, trajectory: Trajectory, time: float) -> np.ndarray:
    """A configuration of the model, by way of one of the group."""
    return planned.expand(planned.from_chart(trajectory.evaluate(np.array([time]))[0][0]))


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


def sampled(place: World, trajectory: Trajectory, times: np.ndarray, span: tuple[float, float]) -> np.ndarray:
    """At times, shape (n, 3): the distance to obstacles, the same within a span, and that of the robot to itself."""
    found = np.full((len(times), 3), np.inf)
    for row, time in zip(found, times, strict=True):
        there = place if not place.scene.moves else World.build(place.group, place.scene.at(time))
        clearance = clearance_at(there, at(place.group, trajectory, time))
        row[[0, 2]] = clearance.obstacle_distance, clearance.self_distance
        if span[0] <= time <= span[1]:
            row[1] = clearance.obstacle_distance
    return found


def check(place: World, trajectory: Trajectory, answers: list[Smallest], span: tuple[float, float], count: int) -> None:
    """No sample is smaller than what is told, and that is attained; they are `FINER` times as dense near the least."""
    times = np.linspace(0.0, trajectory.duration, count)
    even = sampled(place, trajectory, times, span)
    near = {*even.argmin(axis=0)}
    closer = [np.linspace(*times[[max(k - 1, 0), min(k + 1, count - 1)]], 2 * FINER + 1) for k in near]
    least = np.minimum(even.min(axis=0), sampled(place, trajectory, np.concatenate(closer), span).min(axis=0))
    for smallest_of, answer in zip(least, answers, strict=True):
        assert answer.distance - TOLERANCE <= smallest_of + 2 * COAL_ACCURACY
        assert answer.bound == answer.distance - TOLERANCE or answer.pair < 0
        if answer.pair >= 0:
            assert plain_distance(place, trajectory, answer) == pytest.approx(answer.distance, abs=1e-5)


@pytest.mark.parametrize("name", sorted(ARMS.keys() - {"kinova"}))
def test_no_sample_is_closer_for_joints_of_every_kind(name: str) -> None:
    place = world(name)
    for seed in range(2):
        trajectory, span = motion(place.group, seed), (0.3, 2.0)
        check(place, trajectory, found_along(place, trajectory, span), span, 100)


@pytest.mark.parametrize(("name", "scene"), [("panda", "bookshelf"), ("panda", "table"), ("ur5", "wall_with_window")])
def test_no_sample_of_an_arm_of_meshes_is_closer(name: str, scene: str) -> None:
    place = World.build(group(name), library_scene(scene))
    trajectory, span = motion(place.group, 5, 0.5), (0.25, 2.1)
    check(place, trajectory, found_along(place, trajectory, span), span, SAMPLES)


@pytest.mark.parametrize("kind", KINDS)
def test_no_sample_is_closer_to_what_moves(kind: str) -> None:
    for seed in range(2):
        rng = np.random.default_rng(300 + seed)
        scene = scene_of(moving(kind, kind, rng, 0.0, 2.0), *scattered(rng, 2))
        place = World.build(group("panda"), scene)
        trajectory, span = motion(place.group, seed, 0.3), (0.4, 1.9)
        check(place, trajectory, found_along(place, trajectory, span), span, 60)


def test_a_motion_that_goes_nowhere_is_one_place() -> None:
    place = world("planar")
    z = np.zeros(place.group.nv)
    still = Trajectory(np.array([0.0]), z[None], z[None])
    surveyor = surveyor_of(place, still)
    (answer,) = smallest(surveyor, surveyor.places(np.zeros(1)), [Question(are_mixed(place), 0.0, 0.0)])
    assert answer.distance == clearance_at(place, place.group.expand_from_chart(z)).obstacle_distance


def test_nothing_to_measure_is_infinite() -> None:
    place = world_of(group("panda"), [])
    nothing, _, own = found_along(place, motion(place.group, 1))
    assert (nothing.distance, nothing.bound, nothing.pair) == (np.inf, np.inf, -1)
    assert own.pair >= 0


def test_a_search_that_is_stopped_tells_what_is_certain() -> None:
    place = World.build(group("panda"), library_scene("bookshelf"))
    trajectory = motion(place.group, 5, 0.5)
    surveyor, ends = surveyor_of(place, trajectory), (0.0, trajectory.duration)
    (exact,) = smallest(surveyor, surveyor.places(np.array(ends)), [Question(are_mixed(place), *ends)])
    bounds = []
    for patience in (0, 1, 3, 6):
        left = iter(range(patience))
        (answer,) = smallest(
            surveyor,
            surveyor.places(np.array(ends)),
            [Question(are_mixed(place), *ends)],
            deadline=Deadline(is_cancelled=lambda left=left: next(left, None) is None),
        )
        assert answer.bound <= exact.distance <= answer.distance + TOLERANCE
        bounds.append(answer.bound)
    assert bounds == sorted(bounds)
    assert bounds[0] < exact.distance - TOLERANCE


def closing_by_numpy(surveyor: Surveyor, since: float, until: float) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the speed and acceleration of every pair."""
    places = surveyor.places(np.array([since, until]))
    closing, movers = surveyor.worlds.moving.closing, np.unique(surveyor.movers)
    rates = surveyor.curve.most(np.array([since]), np.array([until]))
    reach, speeds = places.reach.max(axis=0)[None], places.speeds.mean(axis=0)[None]
    fastest, changing = (of[0] for of in closing.over(movers, reach, speeds, *rates, np.array([until - since])))
    of = np.searchsorted(movers, surveyor.movers)
    return fastest[of], changing[of]


def known_by_kernels(surveyor: Surveyor, since: float, until: float) -> tuple[np.ndarray, float]:
    """What the kernels, run as Python, know of every pair's mover about the middle of a stretch; the share L of it."""
    world = surveyor.worlds.moving
    moving = MovingRobot(robot_bodies(world), resting_obstacles(world), body_pairs(world), bezier_curve(surveyor.curve))
    search = kernels.new_search(moving)
    place_at(moving, 0.5 * (since + until), search.place, search.room)
    share = find_moves(moving, since, until, search.room, search.ways)
    find_twists(moving, search.place, search.room)
    movers = [closing_of(moving, k, 1, share, search.place, search.ways) for k in range(len(world.pairs))]
    return search.ways.known[movers], share


@settings(deadline=None, max_examples=40)
@given(st.sampled_from(sorted(ARMS)), st.integers(0, 10**6))
def test_twists_tell_how_fast_points_of_a_pair_come_closer(name: str, seed: int) -> None:
    """The derivative of |r|^2 by differences, r between points of two bodies, from wherever they are seen."""
    place, rng = world(name), np.random.default_rng(seed)
    trajectory, middle, h = motion(place.group, seed), rng.uniform(0.1, 2.2), 1e-6
    known = known_by_kernels(surveyor_of(place, trajectory), middle - 1e-3, middle + 1e-3)[0] / 2e-3
    steps = [placed(place, trajectory.evaluate(np.array([middle + k * h]))[0][0]) for k in (-1, 0, 1)]
    for pair in rng.permutation(place.pairs.n_self)[:25]:
        points, speeds = [], []
        for body, twist in zip(place.pairs.of(pair), known[pair, :12].reshape(2, 6), strict=True):
            x = rng.choice(corners(place.group.geometry.geometryObjects[body].geometry))
            points.append([there[body].act(x) for there in steps])
            speeds.append(twist[:3] + np.cross(twist[3:], points[-1][1]))
        before, r, after = np.subtract(*points)
        exact = 2.0 * r @ (speeds[0] - speeds[1])
        assert (after @ after - before @ before) / (2.0 * h) == pytest.approx(exact, rel=1e-4, abs=1e-5)


@settings(deadline=None, max_examples=40)
@given(st.sampled_from(sorted(ARMS)), st.integers(0, 10**6), st.sampled_from([0.02, 0.19, 1.0, 2.4]))
def test_points_of_a_pair_are_where_a_share_of_its_twists_brings_them(name: str, seed: int, span: float) -> None:
    """But for what the kernels say that they are beside, at many times of a stretch, and no farther than they say."""
    place, rng = world(name), np.random.default_rng(seed)
    trajectory, since = motion(place.group, seed), rng.uniform(0.0, 2.4 - span) if span < 2.4 else 0.0
    known, share = known_by_kernels(surveyor_of(place, trajectory), since, since + span)
    times = since + np.linspace(0.0, span, 41)
    steps = [placed(place, z) for z in trajectory.evaluate(times)[0]]
    rest, middle, shares = rng.normal(size=3), len(times) // 2, np.linspace(-share, share, 400)[:, None]
    for pair in rng.permutation(len(place.pairs))[:20]:
        points, moves = [], []
        for body, twist in zip(place.pairs.of(pair), known[pair, :12].reshape(2, 6), strict=True):
            if body >= place.pairs.links:
                points.append([rest] * len(times))
                assert not twist.any()
            else:
                x = rng.choice(corners(place.group.geometry.geometryObjects[body].geometry))
                points.append([there[body].act(x) for there in steps])
            moves.append(twist[:3] + np.cross(twist[3:], points[-1][middle]))
        r = np.subtract(*points)
        apart, there = np.linalg.norm(r, axis=1), np.linalg.norm(r[middle] + shares * (moves[0] - moves[1]), axis=1)
        step = share / 200.0 * float(np.linalg.norm(moves[0] - moves[1]))
        assert apart.min() >= there.min() - step - known[pair, BENT] - 1e-9
        assert apart.max() <= there.max() + step + known[pair, BENT] + 1e-9
        assert np.abs(apart - apart[middle]).max() <= known[pair, TRAVEL] + 1e-9


@settings(deadline=None, max_examples=60)
@given(st.sampled_from(sorted(ARMS)), st.integers(0, 10**6))
def test_no_points_close_in_faster_or_change_it_faster_than_is_said(name: str, seed: int) -> None:
    """The derivatives of |r|^2 by differences, r between points of two bodies, or of one and a point that rests."""
    place, rng = world(name), np.random.default_rng(seed)
    trajectory = motion(place.group, seed)
    surveyor, since = surveyor_of(place, trajectory), rng.uniform(0.0, 2.2)
    until = since + rng.choice([1e-3, 0.02, 0.19])
    inside = Curve(trajectory.bezier(), trajectory.piece_times()).breaks
    assert not len(inside), "the motion has no jumps of speed"
    fastest, changing = closing_by_numpy(surveyor, since, until)
    h = 1e-4
    middle = rng.uniform(since + h, until - h) if until - since > 2 * h else 0.5 * (since + until)
    steps = [placed(place, trajectory.evaluate(np.array([middle + k * h]))[0][0]) for k in (-1, 0, 1)]
    rest = rng.normal(size=3)
    for pair in rng.permutation(len(place.pairs))[:25]:
        first, second = place.pairs.of(pair)
        x = rng.choice(corners(place.group.geometry.geometryObjects[first].geometry))
        y = rest
        if pair < place.pairs.n_self:
            y = rng.choice(corners(place.group.geometry.geometryObjects[second].geometry))
        r = [at[first].act(x) - (at[second].act(y) if pair < place.pairs.n_self else y) for at in steps]
        squares = [v @ v for v in r]
        speed = abs(squares[2] - squares[0]) / (2 * h)
        bend = (squares[2] - 2 * squares[1] + squares[0]) / h**2
        apart = max(np.linalg.norm(v) for v in r)
        slack = 1e-5 * (1.0 + apart) + 1e-3 * fastest[pair] * apart
        assert speed <= 2.0 * fastest[pair] * apart + slack
        most = 2.0 * (fastest[pair] ** 2 + apart * changing[pair])
        assert bend <= most * (1.0 + 1e-3) + 1e-5


def polyline_world() -> tuple[World, np.ndarray]:
    place = world("sliding")
    rng = np.random.default_rng(8)
    return place, rng.uniform(-0.8, 0.8, (6, place.group.nv))


def test_a_polyline_turns_at_its_points() -> None:
    place, points = polyline_world()
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    curve = Curve(pieces, np.arange(6.0))
    np.testing.assert_allclose(curve.breaks, [1.0, 2.0, 3.0, 4.0])
    surveyor = Surveyor(TimedWorld.of(place, place), curve)
    (answer,) = smallest(surveyor, surveyor.places(np.arange(6.0)), [Question(are_mixed(place), 0.0, 5.0)])
    least = np.inf
    for times in (np.linspace(0.0, 5.0, SAMPLES), answer.time + np.linspace(-1.0, 1.0, 2 * FINER) * 5.0 / SAMPLES):
        zs = curve.at(times.clip(0.0, 5.0))[0]
        least = min(least, *(clearance_at(place, place.group.expand_from_chart(z)).obstacle_distance for z in zs))
    assert least - TOLERANCE - COAL_ACCURACY <= answer.distance <= least + TOLERANCE


def test_the_curve_is_the_trajectory_and_its_rates_are_never_exceeded() -> None:
    trajectory: Any = motion(group("panda"), 4)
    curve = Curve(trajectory.bezier(), trajectory.piece_times())
    times = np.linspace(0.0, trajectory.duration, 500)
    z, dz, ddz = trajectory.evaluate(times)
    found, rates = curve.at(times)
    np.testing.assert_allclose(found, z, atol=1e-12)
    np.testing.assert_allclose(rates, dz, atol=1e-9)
    since, until = times[:-20:7], times[20::7]
    fastest, changing = curve.most(since, until)
    for row, (a, b) in enumerate(zip(since, until, strict=True)):
        inside = (times >= a) & (times <= b)
        assert (np.abs(dz[inside]).max(axis=0) <= fastest[row] + 1e-9).all()
        assert (np.abs(ddz[inside]).max(axis=0) <= changing[row] + 1e-6).all()


def test_surfaces_in_contact_are_not_asked_about_again(monkeypatch: pytest.MonkeyPatch) -> None:
    place, asked, distance = World.build(group("ur5"), library_scene("wall_with_window")), [], World.distance

    def counted(self: World, pair: int) -> tuple[float, Any]:
        asked.append(pair)
        return distance(self, pair)

    monkeypatch.setattr(World, "distance", counted)
    obstacle, _, _ = found_along(place, motion(place.group, 1, 1.6))
    assert (obstacle.distance, obstacle.bound) == (0.0, -TOLERANCE)
    assert not are_signed(place)[obstacle.pair]
    assert len(asked) < 100, "nothing is less than nothing: the first contact of a surface is the answer"


@pytest.mark.parametrize("seed", [0, 1, 3, 4])
def test_surfaces_that_come_close_are_looked_at_until_they_touch(seed: int) -> None:
    """Less than the tolerance away isn't contact: a search that ended there told a positive distance of a contact."""
    place = World.build(group("ur5"), library_scene("wall_with_window"))
    surveyor, mixed = surveyor_of(place, trajectory := motion(place.group, seed, 1.6)), are_mixed(place)
    places = surveyor.places(np.unique(np.r_[0.0, surveyor.breaks.clip(0.0, trajectory.duration), trajectory.duration]))
    question = Question(mixed & ~are_signed(place), 0.0, trajectory.duration)
    close = Smallest(0.5 * TOLERANCE, -0.5 * TOLERANCE, 0.0, int(np.flatnonzero(mixed)[0]))
    (found,) = smallest(surveyor, places, [question], [close])
    assert found.distance == 0.0
