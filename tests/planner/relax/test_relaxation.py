"""Relaxation: more clearance, no more length, ends and crossings kept, within limits and time, the same every time."""

from __future__ import annotations

import dataclasses
import functools
import time

import numpy as np
import pytest

from guidefield.collision.certify.certificate import certify
from guidefield.collision.clearance import clearance_at
from guidefield.messages import scene as messages
from guidefield.planner.connect.connect import connect
from guidefield.planner.guide.guide import cross
from guidefield.planner.motion.spline import interpolate
from guidefield.planner.relax.relaxation import (
    Outcome,
    relax,
)
from guidefield.planner.relax.settings import BARRIER, CROSSING, RELAXATION
from guidefield.planner.task.conditions import Budget
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.trace import Note, PathRelaxed
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.guide_plane import build
from tests.planner.problems import problem, scene_of
from tests.robots import box_arm, group, grouped, rest
from tests.scene.solids import l_prism, mesh_message


@functools.cache
def over_the_wall() -> tuple[Problem, np.ndarray]:
    """A Panda, a wall between start and goal, and a way over it that was found by the tree: it grazes the wall."""
    wall = messages.Box(name="wall", size=(0.5, 0.04, 0.7), position=(0.55, 0.0, 0.35))
    made = problem("panda", scene_of(wall), planes=())
    start, goal = made.group.chart(rest(made.group)), made.group.chart(rest(made.group))
    start[0], goal[0] = 0.9, -0.9
    start[1] = goal[1] = 0.3
    rng = np.random.default_rng(1)
    path = connect(made, start, goal[None], rng).path
    path.setflags(write=False)
    return made, path


def resampled(path: np.ndarray, step: float = 0.03) -> np.ndarray:
    lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
    places = np.linspace(0.0, lengths[-1], int(np.ceil(lengths[-1] / step)) + 1)
    return np.column_stack([np.interp(places, lengths, column) for column in path.T])


def smallest_clearance(made: Problem, path: np.ndarray, ends: float = 0.0) -> float:
    """Exact smallest distance to obstacles along a polyline, some of it left out at both ends."""
    points = resampled(path)
    step = np.linalg.norm(points[1] - points[0])
    skip = int(np.ceil(ends / step))
    inner = points[skip : len(points) - skip]
    return min(clearance_at(made.world, made.group.expand_from_chart(z)).obstacle_distance for z in inner)


def length(path: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def test_a_grazing_path_comes_free_and_gets_no_longer() -> None:
    made, path = over_the_wall()
    relaxed = relax(made, path, {})
    assert relaxed.outcome is Outcome.CONVERGED
    assert relaxed.energy_after < 0.5 * relaxed.energy_before
    before, after = smallest_clearance(made, path, 0.3), smallest_clearance(made, relaxed.path, 0.3)
    ends = min(clearance_at(made.world, made.group.expand_from_chart(z)).obstacle_distance for z in path[[0, -1]])
    assert after > before + 0.01
    assert after > 0.03
    assert smallest_clearance(made, relaxed.path) >= min(ends, 0.03) - 1e-3
    assert length(relaxed.path) < 1.05 * length(path)


def test_what_comes_out_is_certified() -> None:
    made, path = over_the_wall()
    relaxed = relax(made, path, {})
    assert certify(made.world, interpolate(relaxed.path).bezier()).free


def test_the_ends_stay_bit_for_bit_and_the_input_is_left_alone() -> None:
    made, path = over_the_wall()
    before = path.copy()
    relaxed = relax(made, path, {})
    np.testing.assert_array_equal(relaxed.path[[0, -1]], path[[0, -1]])
    np.testing.assert_array_equal(path, before)
    assert len(relaxed.path) > len(path)


def test_fixed_waypoints_stay_bit_for_bit() -> None:
    made, path = over_the_wall()
    fixed = np.zeros(len(path), bool)
    fixed[len(path) // 2] = True
    relaxed = relax(made, path, {}, fixed=fixed)
    assert (relaxed.path == path[len(path) // 2]).all(axis=1).sum() == 1


def test_it_is_the_same_every_time() -> None:
    made, path = over_the_wall()
    first, second = relax(made, path, {}), relax(made, path, {})
    np.testing.assert_array_equal(first.path, second.path)
    assert first.iterations == second.iterations


def test_a_path_in_slight_contact_is_repaired() -> None:
    made, path = over_the_wall()
    bad = relax(made, path, {}).path.copy()
    middle = len(bad) // 2
    while smallest_clearance(made, bad) > -0.005:
        bad[middle - 3 : middle + 4, 3] -= 0.01
    assert smallest_clearance(made, relax(made, bad, {}).path, 0.3) > 0.03


@pytest.mark.parametrize("name", ["mesh", "sheet"])
def test_it_gets_clear_of_surfaces(name: str) -> None:
    over, path = over_the_wall()
    vertices, triangles = l_prism()
    standing = [(0.3, 0.0, 0.0), (0.8, 0.0, 0.0), (0.8, 0.0, 0.7), (0.3, 0.0, 0.7)]
    obstacle = {
        # an L that lies on its back, its corner cut out of the wall's upper front
        "mesh": mesh_message(
            vertices[:, [0, 2, 1]] * [0.25, 0.04, 0.35], triangles[:, ::-1], position=(0.3, -0.02, 0.0)
        ),
        "sheet": messages.Polygon(name="sheet", vertices=standing),
    }[name]
    made = problem(over.group, scene_of(obstacle), planes=())
    before, after = (smallest_clearance(made, p, 0.3) for p in (path, relax(made, path, {}).path))
    assert 0.0 < before < 0.04
    assert after > before + 0.01


def test_it_gets_clear_of_a_half_space() -> None:
    planned = group("panda")
    start, goal = planned.chart(rest(planned)), planned.chart(rest(planned))
    start[0], goal[0] = 1.2, -1.2
    path = np.array([start, goal])
    beyond = messages.HalfSpace(name="beyond", normal=(-1, 0, 0), offset=-2.0)
    gap = smallest_clearance(problem(planned, scene_of(beyond), planes=()), path)
    near = messages.HalfSpace(name="beyond", normal=(-1, 0, 0), offset=-2.0 + gap - 0.005)
    made = problem(planned, scene_of(near), planes=())
    assert smallest_clearance(made, path) == pytest.approx(0.005, abs=1e-6)
    assert smallest_clearance(made, relax(made, path, {}).path) > 0.03


def test_the_segments_at_the_ends_are_short() -> None:
    made, path = over_the_wall()
    spacing = np.linalg.norm(np.diff(relax(made, path, {}).path, axis=0), axis=1)
    assert max(spacing[0], spacing[-1]) <= RELAXATION.end_segment + 1e-12
    assert spacing.max() > RELAXATION.end_segment


def test_where_the_ends_are_far_from_everything_the_middle_stays_as_far() -> None:
    planned = group("panda")
    start, goal = planned.chart(rest(planned)), planned.chart(rest(planned))
    start[0], goal[0] = 1.2, -1.2
    tip = problem(planned, scene_of(), planes=()).kinematics.tip_position(
        planned.expand_from_chart(0.5 * (start + goal))
    )
    post = messages.Sphere(name="post", radius=0.03, position=(tip[0] + 0.11, tip[1], tip[2]))
    made = problem(planned, scene_of(post), planes=())
    path = np.array([start, goal])
    ends = min(clearance_at(made.world, planned.expand_from_chart(z)).obstacle_distance for z in path)
    assert ends > 2.0 * BARRIER.range
    assert smallest_clearance(made, path) < BARRIER.range
    assert smallest_clearance(made, relax(made, path, {}).path) > 1.5 * BARRIER.range


def test_limits_are_kept() -> None:
    made, path = over_the_wall()
    z = path.mean(axis=0)
    lower, upper = (
        np.maximum(made.group.lower, path.min(axis=0) - 0.02),
        np.minimum(made.group.upper, path.max(axis=0) + 0.02),
    )
    assert (lower < z).all()
    tight = dataclasses.replace(made, group=dataclasses.replace(made.group, lower=lower, upper=upper))
    free, kept = relax(made, path, {}).path, relax(tight, path, {}).path
    assert (free < lower).any() or (free > upper).any(), "else the limits don't matter"
    assert (kept >= lower).all()
    assert (kept <= upper).all()


def test_no_time_leaves_the_path_as_it_is() -> None:
    made, path = over_the_wall()
    for budget, outcome in (
        (Budget(deadline=time.monotonic() - 1.0), Outcome.OUT_OF_TIME),
        (Budget(cancelled=lambda: True), Outcome.STOPPED),
    ):
        relaxed = relax(dataclasses.replace(made, budget=budget), path, {})
        assert relaxed.outcome is outcome
        assert relaxed.iterations == 0
        np.testing.assert_array_equal(relaxed.path, path)
        assert relaxed.energy_after == relaxed.energy_before


def test_whenever_it_is_stopped_it_has_gained() -> None:
    made, path = over_the_wall()
    energies = [
        relax(dataclasses.replace(made, optimization_iterations=n), path, {}).energy_after for n in (0, 1, 3, 8, 60)
    ]
    assert energies == sorted(energies, reverse=True)
    assert energies[0] > energies[-1]
    polls = iter([False] * 3 + [True] * 100)
    stopped = relax(dataclasses.replace(made, budget=Budget(cancelled=lambda: next(polls))), path, {})
    assert stopped.outcome is Outcome.STOPPED
    assert stopped.iterations == 3
    three = relax(dataclasses.replace(made, optimization_iterations=3), path, {})
    np.testing.assert_array_equal(stopped.path, three.path)


def test_a_path_that_goes_nowhere_is_left_as_it_is() -> None:
    made, path = over_the_wall()
    for still in (path[:1], np.repeat(path[:1], 3, axis=0)):
        relaxed = relax(made, still, {0: len(still) - 1})
        assert relaxed.outcome is Outcome.NOTHING_TO_MOVE
        np.testing.assert_array_equal(relaxed.path, still)
        assert relaxed.crossings == {0: len(still) - 1}


def test_a_detour_is_cut_short_and_spread_anew() -> None:
    made, path = over_the_wall()
    relaxed = relax(made, path, {}).path
    detour = np.vstack([path[0], relaxed[len(relaxed) // 2] + 0.8, path[0] + 0.4, relaxed[len(relaxed) // 2], path[-1]])
    shortened = relax(made, detour, {})
    assert length(shortened.path) < 0.6 * length(detour)
    expected = np.clip(
        np.ceil(length(shortened.path) / RELAXATION.segment), RELAXATION.least_segments, RELAXATION.most_segments
    )
    spacing = np.linalg.norm(np.diff(shortened.path, axis=0), axis=1)
    assert len(shortened.path) - 1 <= expected / RELAXATION.shrunk + 1 + (spacing <= RELAXATION.end_segment).sum()
    assert shortened.energy_after < shortened.energy_before
    np.testing.assert_array_equal(shortened.path[[0, -1]], path[[0, -1]])


def test_a_straight_motion_far_from_everything_stays_straight() -> None:
    made = problem("panda", scene_of(), planes=())
    z = made.group.chart(made.q_start)
    relaxed = relax(made, np.array([z, z + 0.3]), {})
    straight = np.linspace(z, z + 0.3, len(relaxed.path))
    np.testing.assert_allclose(relaxed.path, straight, atol=1e-9)


def test_the_clearance_asked_for_is_the_wall() -> None:
    made, path = over_the_wall()
    plain = smallest_clearance(made, relax(made, path, {}).path, 0.5)
    asked = smallest_clearance(made, relax(dataclasses.replace(made, min_clearance=0.15), path, {}).path, 0.5)
    assert asked > plain + 0.01


@functools.cache
def through_the_window() -> tuple[Problem, np.ndarray, dict[int, int]]:
    """A guided motion through two planes of a packaged scene."""
    made = problem("panda", "wall_with_window")
    path, crossings = made.group.chart(made.q_start)[None], {}
    for index, plane in enumerate(made.guide_planes[:2]):
        crossing = cross(made, made.group.from_chart(path[-1]), plane, index)
        path = np.concatenate([path, made.group.chart_path(list(crossing.path), path[-1])[1:]])
        crossings[index] = len(path) - 1
    return made, path, crossings


def test_crossings_stay_on_their_planes() -> None:
    made, path, crossings = through_the_window()
    relaxed = relax(made, path, crossings)
    assert relaxed.energy_after < relaxed.energy_before
    assert set(relaxed.crossings) == {0, 1}
    for index, at in relaxed.crossings.items():
        tip = made.kinematics.tip_position(made.group.expand_from_chart(relaxed.path[at]))
        plane = made.guide_planes[index]
        assert abs(plane.signed_height(tip)) <= (1e-4 if at == len(relaxed.path) - 1 else CROSSING.on_plane)
        assert plane.contains(tip)
    inside = relaxed.crossings[0]
    assert (relaxed.path[inside] != path[crossings[0]]).any(), "it moves within its plane"
    np.testing.assert_array_equal(relaxed.path[-1], path[-1])


def test_a_crossing_is_kept_inside_its_polygon_though_the_shorter_way_leads_past_it() -> None:
    made = problem("panda", scene_of(), planes=())
    z = made.group.chart(made.q_start)
    start, goal, detour = z.copy(), z.copy(), z.copy()
    start[0], goal[0] = -0.5, 0.5
    detour[1] -= 0.5
    tip = made.kinematics.tip_position(made.group.expand_from_chart(detour))
    corners = [tip + 0.03 * np.array([a, 0.0, b]) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    plane = build(messages.GuidePlane(name="GP", vertices=[tuple(c.tolist()) for c in corners]), 0)
    made = dataclasses.replace(made, guide_planes=(plane,))
    path = np.array([start, detour, goal])
    free = relax(made, path, {}).path
    kept = relax(made, path, {0: 1})
    tips = [made.kinematics.tip_position(made.group.expand_from_chart(q)) for q in free]
    assert min(plane.distance(t) for t in tips) > 0.05
    crossing = made.kinematics.tip_position(made.group.expand_from_chart(kept.path[kept.crossings[0]]))
    assert plane.distance(crossing) <= CROSSING.on_plane
    assert np.linalg.norm(crossing - tip) > 0.005, "it went as far as the polygon lets it"
    assert length(kept.path) < length(path)


def test_two_planes_at_one_waypoint_hold_it() -> None:
    made, path = over_the_wall()
    middle = len(path) // 2
    tip = made.kinematics.tip_position(made.group.expand_from_chart(path[middle]))
    planes = tuple(
        build(messages.GuidePlane(name="GP", vertices=[tuple((tip + 0.1 * c).tolist()) for c in corners]), 0)
        for corners in (
            np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]),
            np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]]),
        )
    )
    relaxed = relax(dataclasses.replace(made, guide_planes=planes), path, {0: middle, 1: middle})
    np.testing.assert_array_equal(relaxed.path[relaxed.crossings[0]], path[middle])
    assert relaxed.crossings[0] == relaxed.crossings[1]


def beside_the_way(planned: PlanningGroup, path: np.ndarray) -> Problem:
    """A post that the straight motion just misses, and that both ends are far from."""
    middle = problem(planned, scene_of(), planes=()).kinematics.tip_position(
        planned.expand_from_chart(path.mean(axis=0))
    )
    rng = np.random.default_rng(0)
    for _ in range(1000):
        place = middle + 0.15 * rng.normal(size=3)
        post = messages.Sphere(name="post", radius=0.03, position=tuple(place.tolist()))
        made = problem(planned, scene_of(post), planes=())
        ends = [clearance_at(made.world, planned.expand_from_chart(z)).obstacle_distance for z in path]
        if min(ends) > 0.06 and 0.003 < smallest_clearance(made, path) < 0.02:
            return made
    raise AssertionError("no place for a post")


@pytest.mark.parametrize(
    "joints", ["slide y x", "continuous y x", "y x mimic y", "continuous x screw y", "planar y x", "floating y"]
)
def test_every_joint_kind_moves_away_from_a_post(joints: str) -> None:
    planned = grouped(box_arm(joints, 0, size=0.25))
    path = np.array([np.full(planned.nv, -0.35), np.full(planned.nv, 0.35)])
    if joints.startswith("slide"):
        path[0, 0] = 0.05  # further in, links would overlap
    made = beside_the_way(planned, path)
    relaxed = relax(made, path, {})
    assert smallest_clearance(made, relaxed.path) > smallest_clearance(made, path) + 0.015
    assert length(relaxed.path) < 2.0 * length(path)


def test_links_are_not_driven_together() -> None:
    planned = group("panda")
    made = problem(planned, scene_of(), planes=())
    rng = np.random.default_rng(2)
    ends = []
    while len(ends) < 2:
        q = planned.random(rng)
        if not made.world.in_collision(q):
            ends.append(planned.chart(q))
    relaxed = relax(made, np.array(ends), {})
    straight, after = (
        min(clearance_at(made.world, planned.expand_from_chart(z)).self_distance for z in resampled(path, 0.05))
        for path in (np.array(ends), relaxed.path)
    )
    assert after >= min(straight, 0.02) - 1e-3


def test_the_observer_hears_of_each_step_that_was_taken() -> None:
    made, path = over_the_wall()
    made.observer.events.clear()
    relaxed = relax(made, path, {})
    notes = [event for event in made.observer.events if isinstance(event, Note)]
    taken = [event for event in made.observer.events if isinstance(event, PathRelaxed)]
    assert len(notes) == 1
    assert str(relaxed.iterations) in notes[0].text
    assert 0 < len(taken) <= relaxed.iterations
    of_result = {z.tobytes() for z in relaxed.path}  # whose segments at the ends were cut besides
    assert all(z.tobytes() in of_result for z in taken[-1].path)
    assert length(taken[-1].path) == pytest.approx(length(relaxed.path))
    assert all((event.path[[0, -1]] == path[[0, -1]]).all() for event in taken)
    assert len(made.observer.events) == len(notes) + len(taken)
