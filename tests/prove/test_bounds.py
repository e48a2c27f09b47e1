"""The bounds of a pair's motion in a segment, as the kernels have them: against Pinocchio at many times of it."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.world import World
from guidefield.kernels.prove.kept_distance import LOG_ROWS
from guidefield.kernels.prove.motion_bounds import BENT, TRAVEL, bound_pair, find_moves
from guidefield.kernels.prove.placement import find_twists, place_at
from guidefield.kernels.prove.samples import new_search
from guidefield.kernels.prove.tables import MovingRobot
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.prove.tables import bezier_curve, with_passing_speeds, world_tables
from tests.collision.test_bodies import ARMS, corners, placed, world
from tests.planner.problems import scene_of
from tests.planner.test_moving_kinds import moving
from tests.prove.test_minima import curve_of, motion
from tests.robots import group


def moving_robot(place: World, trajectory: Trajectory) -> MovingRobot:
    robot, obstacles, movers, pairs, _ = world_tables(place, in_time=True)
    curve = curve_of(trajectory)
    return MovingRobot(robot, obstacles, with_passing_speeds(place, curve, movers), pairs, bezier_curve(curve))


def bounds_by_kernels(
    place: World, trajectory: Trajectory, since: float, until: float, pairs: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return the rows of some pairs about the middle of a segment, the kernels run as Python, and the share L of it."""
    moving_one = moving_robot(place, trajectory)
    search = new_search(moving_one, np.zeros(LOG_ROWS))
    place_at(moving_one, 0.5 * (since + until), search.place, search.scratch)
    share = find_moves(moving_one, since, until, search.place, search.scratch, search.bounds)
    find_twists(moving_one, search.place, search.scratch)
    rows = [
        search.bounds.known[bound_pair(moving_one, int(pair), 1, share, search.place, search.bounds)].copy()
        for pair in pairs
    ]
    return np.array(rows), share


@settings(max_examples=12)
@given(st.sampled_from(sorted(ARMS)), st.integers(0, 10**6), st.sampled_from([0.02, 0.19, 1.0, 2.4]))
def test_points_of_a_pair_are_where_a_share_of_its_twists_brings_them(name: str, seed: int, span: float) -> None:
    """But for what the kernels say that they are beside, at many times of a segment, and no farther than they say."""
    place, rng = world(name), np.random.default_rng(seed)
    trajectory, since = motion(place.group, seed), rng.uniform(0.0, 2.4 - span) if span < 2.4 else 0.0
    pairs = rng.permutation(len(place.pairs))[:20]
    known, share = bounds_by_kernels(place, trajectory, since, since + span, pairs)
    times = since + np.linspace(0.0, span, 41)
    steps = [placed(place, z) for z in trajectory.evaluate(times)[0]]
    rest, middle, shares = rng.normal(size=3), len(times) // 2, np.linspace(-share, share, 400)[:, None]
    for row, pair in zip(known, pairs, strict=True):
        points, moves = [], []
        for body, twist in zip(place.pairs.of(pair), row[:12].reshape(2, 6), strict=True):
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
        assert apart.min() >= there.min() - step - row[BENT] - 1e-9
        assert apart.max() <= there.max() + step + row[BENT] + 1e-9
        assert np.abs(apart - apart[middle]).max() <= row[TRAVEL] + 1e-9


@pytest.mark.parametrize("span", [0.03, 0.4, 2.4])
@pytest.mark.parametrize("seed", range(6))
def test_points_of_a_moving_obstacle_are_where_their_bounds_have_them(seed: int, span: float) -> None:
    """Robot and obstacle go on together: each point is where its twist brings it at the share of the time."""
    rng = np.random.default_rng(seed)
    scene = scene_of(moving("box", "box", rng, 0.2, 2.0))
    place = World.build(group("panda"), scene)
    trajectory, since = motion(place.group, seed, 0.3), rng.uniform(0.0, 2.4 - span) if span < 2.4 else 0.0
    pairs, middle = np.arange(place.pairs.n_self, len(place.pairs)), since + 0.5 * span
    known, share = bounds_by_kernels(place, trajectory, since, since + span, pairs)
    assert share == pytest.approx(0.5)
    times = since + np.linspace(0.0, span, 41)
    steps = [placed(place, z) for z in trajectory.evaluate(times)[0]]
    obstacle = scene.obstacles[0]
    for row, pair in zip(known, pairs, strict=True):
        body, _ = place.pairs.of(pair)
        x = rng.choice(corners(place.group.geometry.geometryObjects[body].geometry))
        y = obstacle.placement_at(0.0).actInv(rng.choice(obstacle.vertices))
        a = np.array([there[body].act(x) for there in steps])
        b = np.array([obstacle.placement_at(time).act(y) for time in times])
        first, second = row[:12].reshape(2, 6)
        moves = first[:3] + np.cross(first[3:], a[20]) - second[:3] - np.cross(second[3:], b[20])
        along = (times - middle) / span
        off = np.linalg.norm(a - b - (a[20] - b[20]) - along[:, None] * moves, axis=1)
        assert off.max() <= row[BENT] + 1e-9
        assert np.abs(np.linalg.norm(a - b, axis=1) - np.linalg.norm(a[20] - b[20])).max() <= row[TRAVEL] + 1e-9
