"""Optimised motions: faster, clear of obstacles, certified, within limits, from rest to rest, the same every time."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator
from typing import Any

import numba
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import guidefield
from guidefield.collision.clearance import clearance_at
from guidefield.deadline import Deadline
from guidefield.messages import scene as messages
from guidefield.planner.connect.constrained import Keeper
from guidefield.planner.motion.bspline import BSpline
from guidefield.planner.motion.timing import stretch_spline_to_limits
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.optimize import interior_point
from guidefield.planner.optimize.interior_point import Descent, Look
from guidefield.planner.optimize.optimization import Optimized, Outcome, optimize
from guidefield.planner.optimize.passages import REACHED, Passage, PlanePlace
from guidefield.planner.optimize.settings import (
    BALANCED,
    MANY,
    OPTIMIZATION,
    closer,
    constrained,
    free,
    in_few_pieces,
    of_many,
)
from guidefield.planner.path_so_far import limits_of, retime_motion, time_path_ignoring_jerk
from guidefield.planner.task.motion_limits import frame_limit
from guidefield.planner.task.problem import Objective, Problem
from guidefield.planner.task.trace import Note, PathRelaxed
from guidefield.prove.certificate import certify, certify_constraints
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.path_constraints import Cone, PathConstraint, plane
from guidefield.scene.guide_plane import GuidePlane, build
from tests.planner.problems import problem, scene_of
from tests.planner.walls import beside_the_way, over_the_wall, smallest_clearance
from tests.robots import box_arm, group, grouped
from tests.scene.solids import l_prism, mesh_message


def optimized(made: Problem, path: np.ndarray) -> Optimized:
    return optimize(made, time_path_ignoring_jerk(made, path), BALANCED)


def test_a_limit_of_speed_in_space_gives_a_motion_another_shape() -> None:
    """The arm is drawn in on its way round: the tip's way is shorter there."""
    limit, durations = frame_limit(group("panda"), "panda_hand_tcp", 0.25, np.inf), []
    made = problem("panda", scene_of(), cartesian_limits=(limit,))
    path = np.array([[side, 0.6, 0.0, -1.2, 0.0, 1.8, 0.8] for side in (-1.3, 1.3)])
    for asked in (made, problem("panda", scene_of())):
        slower = retime_motion(made, optimized(asked, path).trajectory)
        assert slower is not None
        motion = stretch_spline_to_limits(slower, limits_of(made))
        reached = limit.reached(motion.polynomials)[0]
        assert 0.24 < reached.found <= reached.bound <= 0.25 * (1.0 + 1e-6)
        durations.append(motion.duration)
    assert durations[0] < 0.9 * durations[1]


def check_limits(made: Problem, trajectory: Trajectory) -> None:
    """Limits of velocity, acceleration and jerk by differences of dense samples, those of position by the hull."""
    times = np.linspace(0.0, trajectory.duration, 20 * len(trajectory.times) + 1)
    q, v, a = trajectory.evaluate(times)
    assert (np.abs(v) <= made.group.velocity_limits * (1 + 1e-9)).all()
    assert (np.abs(a) <= made.group.acceleration_limits * (1 + 1e-9)).all()
    step = times[1] - times[0]
    between = np.abs(np.diff(q, axis=0)) / step
    assert (between <= made.group.velocity_limits * (1 + 1e-6)).all(), "positions tell the same velocities"
    if made.jerk_limits is not None:
        assert (np.abs(np.diff(a, axis=0)) / step <= made.jerk_limits * (1 + 1e-6)).all()
    points = trajectory.bezier().reshape(-1, made.group.nv)
    assert (points >= made.group.lower - 1e-9).all()
    assert (points <= made.group.upper + 1e-9).all()
    for k in (0, -1):
        assert (trajectory.velocities[k] == 0.0).all()
        np.testing.assert_allclose(a[k], 0.0, atol=1e-9 * made.group.acceleration_limits.max())


def test_it_is_faster_keeps_away_and_is_certified() -> None:
    made, path = over_the_wall()
    before, after = time_path_ignoring_jerk(made, path), optimized(made, path)
    assert after.outcome is Outcome.OPTIMISED
    assert after.trajectory.duration < 0.9 * before.duration
    assert after.before == before.duration
    assert smallest_clearance(made, after.trajectory.positions, 0.3) > 0.03
    assert certify(made.world, after.trajectory.bezier()).free
    check_limits(made, after.trajectory)


def test_a_free_motion_takes_fewer_looks_to_as_good_a_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    looks, look = list[float](), Descent.look

    def counted(
        self: Descent, spline: BSpline, passed: tuple = (), stiffness: float = 1.0, *rest: float | Look
    ) -> Look:
        looks.append(stiffness)
        return look(self, spline, passed, stiffness, *rest)

    monkeypatch.setattr(Descent, "look", counted)
    made, path = over_the_wall()
    patient, most = optimized(made, path).trajectory, len(looks)
    assert set(looks) == {1.0}
    looks.clear()
    soon = optimize(made, time_path_ignoring_jerk(made, path), free(BALANCED)).trajectory
    assert len(looks) < most
    assert min(looks) < 1.0
    assert soon.duration < 1.01 * patient.duration
    kept = [smallest_clearance(made, one.positions, 0.3) for one in (patient, soon)]
    assert kept[1] > kept[0] - 2e-3
    check_limits(made, soon)


def test_a_look_leaves_the_one_beside_it_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    beside_others, look = list[int](), Descent.look

    def watched(self: Descent, spline: BSpline, *given: object) -> Look:
        beside = given[-1] if given and isinstance(given[-1], Look) else None
        before = beside and beside.model.hessians.copy()
        found = look(self, spline, *given)  # type: ignore[arg-type]
        if beside is not None:
            kept = slice(beside.model.places)  # beyond, nobody wrote
            assert (beside.model.hessians[kept] == before[kept]).all()
            assert not np.shares_memory(beside.model.hessians, found.model.hessians)
            beside_others.append(id(beside))
        return found

    monkeypatch.setattr(Descent, "look", watched)
    made, path = over_the_wall()
    optimize(made, time_path_ignoring_jerk(made, path), free(BALANCED))
    assert len(beside_others) > len(set(beside_others)) > 5, "some more than once"


def test_it_reaches_a_limit_exactly() -> None:
    made, path = over_the_wall()
    trajectory = optimized(made, path).trajectory
    _, v, a = trajectory.evaluate(np.linspace(0.0, trajectory.duration, 20_001))
    used = (np.abs(v) / made.group.velocity_limits).max(), (np.abs(a) / made.group.acceleration_limits).max()
    assert max(used) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("jerk", [5.0, 50.0])
def test_jerk_limits_are_kept_and_cost_time(jerk: float) -> None:
    made, path = over_the_wall()
    limited = dataclasses.replace(made, jerk_limits=np.full(made.group.nv, jerk))
    trajectory = optimized(limited, path).trajectory
    check_limits(limited, trajectory)
    assert trajectory.duration > optimized(made, path).trajectory.duration
    knots = trajectory.times[1:-1]
    before, after = (trajectory.evaluate(knots + by)[2] for by in (-1e-9, 1e-9))
    np.testing.assert_allclose(after, before, atol=1e-6 * jerk, err_msg="accelerations are continuous")


def test_the_ends_stay_bit_for_bit() -> None:
    made, path = over_the_wall()
    np.testing.assert_array_equal(optimized(made, path).trajectory.positions[[0, -1]], path[[0, -1]])


def test_it_is_the_same_every_time() -> None:
    made, path = over_the_wall()
    first, second = optimized(made, path).trajectory, optimized(made, path).trajectory
    np.testing.assert_array_equal(first.times, second.times)
    np.testing.assert_array_equal(first.positions, second.positions)
    np.testing.assert_array_equal(first.velocities, second.velocities)


@settings(max_examples=9)
@given(st.integers(0, 10_000), st.sampled_from([None, 20.0]), st.sampled_from(["y x", "slide y x", "planar y"]))
def test_every_motion_is_within_limits_and_no_slower_than_one_joint_needs(
    seed: int, jerk: float | None, joints: str
) -> None:
    planned = grouped(box_arm(joints, 0, size=0.25))
    rng = np.random.default_rng(seed)
    path = np.array([planned.chart(planned.random(rng)) for _ in range(3)])
    limits = None if jerk is None else np.full(planned.nv, jerk)
    made = problem(planned, scene_of(), planes=(), jerk_limits=limits)
    trajectory = optimized(made, path).trajectory
    check_limits(made, trajectory)
    way = np.abs(path[-1] - path[0])
    bound = np.maximum(way / planned.velocity_limits, 2.0 * np.sqrt(way / planned.acceleration_limits)).max()
    assert trajectory.duration >= bound * (1.0 - 1e-9)
    np.testing.assert_array_equal(trajectory.positions[[0, -1]], path[[0, -1]])


def test_far_from_everything_it_is_nearly_the_fastest_there_is() -> None:
    made = problem("panda", scene_of(), planes=())
    z = made.group.chart(made.q_start)
    goal = z + np.linspace(0.1, 0.8, made.group.nv)
    trajectory = optimized(made, np.array([z, goal])).trajectory
    way, top, rise = np.abs(goal - z), made.group.velocity_limits, made.group.acceleration_limits
    bound = np.where(way > top**2 / rise, way / top + top / rise, 2.0 * np.sqrt(way / rise)).max()
    assert trajectory.duration < 1.1 * bound


@pytest.mark.parametrize("size", [1e-5, 1e-3])
def test_a_tiny_motion_stays_within_limits(size: float) -> None:
    made = problem("panda", scene_of(), planes=(), jerk_limits=np.full(7, 100.0))
    z = made.group.chart(made.q_start)
    check_limits(made, optimized(made, np.array([z, z + size])).trajectory)


def test_position_limits_are_kept_between_samples_too() -> None:
    made, path = over_the_wall()
    lower = np.maximum(made.group.lower, path.min(axis=0) - 0.02)
    upper = np.minimum(made.group.upper, path.max(axis=0) + 0.02)
    tight = dataclasses.replace(made, group=dataclasses.replace(made.group, lower=lower, upper=upper))
    free, kept = (optimized(one, path).trajectory.positions for one in (made, tight))
    assert (free < lower).any() or (free > upper).any(), "else the limits don't matter"
    check_limits(tight, optimized(tight, path).trajectory)
    assert (kept >= lower).all()


def test_a_coordinate_without_room_stays_where_it_is() -> None:
    made, path = over_the_wall()
    lower, upper = made.group.lower.copy(), made.group.upper.copy()
    held = path.copy()
    held[:, 6] = lower[6] = upper[6] = path[0, 6]
    fixed = dataclasses.replace(made, group=dataclasses.replace(made.group, lower=lower, upper=upper))
    trajectory = optimized(fixed, held).trajectory
    np.testing.assert_allclose(trajectory.positions[:, 6], path[0, 6], atol=1e-15)
    assert trajectory.duration < time_path_ignoring_jerk(fixed, held).duration


def test_iterations_are_counted_and_it_may_stop_at_any() -> None:
    made, path = over_the_wall()
    whole = optimized(made, path)
    durations = []
    for most in (1, 5, 12):
        asked = dataclasses.replace(made, optimization_iterations=most)
        one = optimized(asked, path)
        assert (one.steps, one.outcome) == (most, Outcome.OUT_OF_ITERATIONS)
        check_limits(asked, one.trajectory)
        durations.append(one.trajectory.duration)
    assert whole.trajectory.duration < durations[-1] < durations[0]


def test_without_time_it_is_the_first_motion_within_limits() -> None:
    made, path = over_the_wall()
    for deadline, outcome in (
        (Deadline(time.monotonic() - 1.0), Outcome.OUT_OF_TIME),
        (Deadline(is_cancelled=lambda: True), Outcome.STOPPED),
    ):
        one = optimized(dataclasses.replace(made, deadline=deadline), path)
        assert (one.steps, one.outcome) == (0, outcome)
        check_limits(made, one.trajectory)


@pytest.mark.parametrize("asked", [0.05, 0.1])
def test_the_clearance_asked_for_is_kept(asked: float) -> None:
    made, path = over_the_wall()
    plain, kept = (optimized(dataclasses.replace(made, min_clearance=c), path).trajectory for c in (0.0, asked))
    assert not certify(made.world, plain.bezier(), asked).free
    assert certify(made.world, kept.bezier(), asked).free
    assert plain.duration < kept.duration < 1.3 * plain.duration


def test_looking_closer_keeps_further_away() -> None:
    made, path = over_the_wall()
    closely = optimize(made, time_path_ignoring_jerk(made, path), closer(BALANCED)).trajectory
    usual = optimized(made, path).trajectory
    assert smallest_clearance(made, closely.positions, 0.3) > smallest_clearance(made, usual.positions, 0.3)


def test_each_objective_is_better_at_what_it_is_for() -> None:
    made, path = over_the_wall()
    by = {one: optimize(made, time_path_ignoring_jerk(made, path), OPTIMIZATION[one]).trajectory for one in Objective}
    kept = {one: smallest_clearance(made, trajectory.positions, 0.3) for one, trajectory in by.items()}
    for trajectory in by.values():
        assert certify(made.world, trajectory.bezier()).free
        check_limits(made, trajectory)
    assert by[Objective.TIME].duration < by[Objective.BALANCED].duration < by[Objective.CLEARANCE].duration
    assert kept[Objective.TIME] < kept[Objective.BALANCED] < kept[Objective.CLEARANCE]


def test_for_time_too_the_clearance_asked_for_is_kept() -> None:
    made, path = over_the_wall()
    asked = dataclasses.replace(made, min_clearance=0.08)
    assert certify(
        made.world,
        optimize(asked, time_path_ignoring_jerk(asked, path), OPTIMIZATION[Objective.TIME]).trajectory.bezier(),
        0.08,
    ).free


def test_of_several_first_motions_the_best_goes_on() -> None:
    made, path = over_the_wall()
    aside = path[len(path) // 2] + 1.2 * np.eye(made.group.nv)[6]
    detour = np.concatenate([path[: len(path) // 2], aside[None], path[len(path) // 2 :]])
    thorough = dataclasses.replace(BALANCED, enough=1.0)
    alone = optimize(made, time_path_ignoring_jerk(made, path), thorough)
    for first, second in ((path, detour), (detour, path)):
        both = optimize(
            made, time_path_ignoring_jerk(made, first), thorough, iter([time_path_ignoring_jerk(made, second)])
        )
        assert both.trajectory.duration < 1.02 * alone.trajectory.duration
        assert both.steps > alone.steps


def test_where_the_first_is_as_fast_as_can_be_no_other_is_looked_at() -> None:
    made = problem("panda", scene_of(), planes=())
    z = made.group.chart(made.q_start)
    way = np.array([z, z + np.linspace(0.5, 1.0, made.group.nv)])

    def others() -> Iterator[Trajectory]:
        raise AssertionError("asked for another")
        yield time_path_ignoring_jerk(made, way)

    lenient = dataclasses.replace(BALANCED, enough=1.5)
    assert optimize(made, time_path_ignoring_jerk(made, way), lenient, others()).outcome is Outcome.OPTIMISED


def square(middle: np.ndarray, half: float) -> GuidePlane:
    """A square across the world's y axis."""
    corners = [middle + half * np.array([a, 0.0, b]) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return build(messages.GuidePlane(name="GP", vertices=[tuple(c.tolist()) for c in corners]), 0)


def by_way_of(turn: float) -> tuple[Problem, np.ndarray, PlanePlace]:
    """A Panda in the open that turns by so much about its base, the long way through a small square at its start."""
    made = problem("panda", scene_of(), planes=())
    z = made.group.chart(made.q_start)
    start, goal, detour = z.copy(), z.copy(), z.copy()
    start[0], goal[0] = -0.5, -0.5 + turn
    detour[1] -= 0.5
    plane = square(made.kinematics.tip_positions(detour[None])[0], 0.03)
    return made, np.array([start, detour, goal]), PlanePlace.through(made, plane, detour)


@pytest.mark.parametrize("turn", [1.0, 0.2], ids=["through it", "there and back"])
def test_a_guided_motion_crosses_its_plane_though_a_shorter_way_leads_past_it(turn: float) -> None:
    made, path, place = by_way_of(turn)
    motion = time_path_ignoring_jerk(made, path)
    past = optimize(made, motion, BALANCED)
    through = optimize(made, motion, BALANCED, passages=(Passage(place, path[1]),))
    assert through.outcome is Outcome.OPTIMISED
    check_limits(made, through.trajectory)
    assert past.trajectory.duration < through.trajectory.duration < 1.2 * motion.duration
    tips = [
        made.kinematics.tip_positions(one.trajectory.evaluate(np.linspace(0.0, one.trajectory.duration, 20_001))[0])
        for one in (past, through)
    ]
    missed, nearly = (min(place.plane.distance(tip) for tip in way[::20]) for way in tips)
    assert missed > 0.05
    assert nearly < 0.01
    q = through.trajectory.positions[through.passed[0]]
    tip = made.kinematics.tip_position(made.group.expand_from_chart(q))
    assert place.plane.distance(tip, place.inset) <= REACHED
    assert place.plane.contains(tip)


def test_a_long_chain_passes_its_plane_in_few_pieces() -> None:
    made = problem("chain_fixed_10x168_r22", scene_of(), planes=())
    rng, nv = np.random.default_rng(6), made.group.nv
    start = made.group.chart(made.q_start)
    path = start + np.array([0.0, 0.1, 0.1])[:, None] * rng.normal(size=(3, nv))
    place = PlanePlace.through(made, square(made.kinematics.tip_positions(path[1:2])[0], 0.05), path[1])
    motion = time_path_ignoring_jerk(made, path)
    found = optimize(made, motion, of_many(BALANCED), passages=(Passage(place, path[1]),))
    assert nv > MANY
    assert found.outcome is Outcome.OPTIMISED
    assert found.trajectory.duration < motion.duration
    assert len(found.trajectory.times) - 1 <= 2 * BALANCED.least_pieces + 1
    check_limits(made, found.trajectory)
    tip = made.kinematics.tip_positions(found.trajectory.positions[[found.passed[0]]])[0]
    assert place.plane.distance(tip, place.inset) <= REACHED


def test_a_plane_crossed_twice_is_crossed_twice_and_out_of_iterations_too() -> None:
    made, path, place = by_way_of(1.0)
    twice = (Passage(place, path[1]), Passage(place, path[1]))
    for most in (None, 1, 4):
        asked = dataclasses.replace(made, optimization_iterations=most)
        found = optimize(asked, time_path_ignoring_jerk(made, path), BALANCED, passages=twice)
        assert len(found.passed) == 2
        for knot in found.passed:
            tip = made.kinematics.tip_positions(found.trajectory.positions[[knot]])[0]
            assert place.plane.distance(tip, place.inset) <= REACHED
        check_limits(made, found.trajectory)


def test_a_plane_that_can_not_be_reached_is_told() -> None:
    made, path, place = by_way_of(1.0)
    far = PlanePlace(made, square(place.plane.centroid + 3.0 * np.eye(3)[0], 0.03), 0.0)
    found = optimize(made, time_path_ignoring_jerk(made, path), BALANCED, passages=(Passage(far, path[1]),))
    assert found.outcome is Outcome.NOT_PASSING


def test_a_path_in_slight_contact_comes_free() -> None:
    made, path = over_the_wall()
    bad = optimized(made, path).trajectory.positions.copy()
    middle = len(bad) // 2
    while smallest_clearance(made, bad) > -0.005:
        bad[middle - 3 : middle + 4, 3] -= 0.01
    assert smallest_clearance(made, optimized(made, bad).trajectory.positions, 0.3) > 0.02


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
    before = smallest_clearance(made, path, 0.3)
    assert 0.0 < before < 0.04
    assert smallest_clearance(made, optimized(made, path).trajectory.positions, 0.3) > before + 0.01


@pytest.mark.parametrize(
    "joints", ["slide y x", "continuous y x", "y x mimic y", "continuous x screw y", "planar y x", "floating y"]
)
def test_every_joint_kind_moves_away_from_a_post(joints: str) -> None:
    planned = grouped(box_arm(joints, 0, size=0.25))
    path = np.array([np.full(planned.nv, -0.35), np.full(planned.nv, 0.35)])
    if joints.startswith("slide"):
        path[0, 0] = 0.05  # further in, links would overlap
    made = beside_the_way(planned, path)
    after = optimized(made, path).trajectory
    check_limits(made, after)
    assert smallest_clearance(made, after.positions) > smallest_clearance(made, path) + 0.01


def test_links_are_not_driven_together() -> None:
    planned = group("panda")
    made = problem(planned, scene_of(), planes=())
    rng = np.random.default_rng(2)
    free = [q for q in (planned.random(rng) for _ in range(50)) if not made.world.in_collision(q)][:2]
    path = np.array([planned.chart(q) for q in free])
    after = optimized(made, path).trajectory.positions
    straight, own = (_own_distance(made.group, made, points) for points in (np.linspace(*path, 60), after))
    assert own >= min(straight, 0.02) - 1e-3


def _own_distance(planned: PlanningGroup, made: Problem, points: np.ndarray) -> float:
    return min(clearance_at(made.world, planned.expand_from_chart(z)).self_distance for z in points)


def test_the_observer_hears_of_each_step() -> None:
    made, path = over_the_wall()
    made.observer.events.clear()
    after = optimized(made, path)
    steps = [event for event in made.observer.events if isinstance(event, PathRelaxed)]
    notes = [event.text for event in made.observer.events if isinstance(event, Note)]
    assert len(steps) == after.steps > 0
    assert len(notes) == 1
    assert f"{after.trajectory.duration:.3f} s" in notes[0]
    assert all((event.path[[0, -1]] == path[[0, -1]]).all() for event in steps)


def test_a_free_motion_begins_with_few_pieces_and_is_as_good() -> None:
    made, path = over_the_wall()
    motion, settings = time_path_ignoring_jerk(made, path), free(BALANCED)
    of_all = optimize(made, motion, settings).trajectory
    made.observer.events.clear()
    begun_with_few = optimize(made, motion, in_few_pieces(settings)).trajectory
    counts = [len(event.path) - 1 for event in made.observer.events if isinstance(event, PathRelaxed)]
    least = counts[0]
    assert sorted(set(counts)) == list(dict.fromkeys(counts)) == [least, 2 * least, 4 * least]
    assert len(begun_with_few.times) == len(of_all.times)
    check_limits(made, begun_with_few)
    assert begun_with_few.duration == pytest.approx(of_all.duration, rel=0.02)
    assert smallest_clearance(made, begun_with_few.positions) > smallest_clearance(made, of_all.positions) - 2e-3


def test_steps_are_counted_at_every_number_of_pieces() -> None:
    made, path = over_the_wall()
    motion, settings = time_path_ignoring_jerk(made, path), in_few_pieces(free(BALANCED))
    whole = optimize(made, motion, settings)
    for steps in (1, whole.steps - 1):
        after = optimize(dataclasses.replace(made, optimization_iterations=steps), motion, settings)
        assert after.steps == steps
        assert after.outcome is Outcome.OUT_OF_ITERATIONS
        check_limits(made, after.trajectory)


def test_a_look_is_given_up_where_the_clearance_is_more_than_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    made, path = over_the_wall()
    motion, settings, looks = time_path_ignoring_jerk(made, path), in_few_pieces(free(BALANCED)), []
    look = Descent.look

    def wholly(
        descent: Descent,
        spline: BSpline,
        passed: tuple = (),
        stiffness: float = 1.0,
        most: float = np.inf,
        beside: Look | None = None,
    ) -> Look:
        found = look(descent, spline, passed, stiffness, most, beside)
        whole = look(descent, spline, passed, stiffness, np.inf, beside)  # the last one, as it is the one that is used
        looks.append((whole.model.value, found.model.value, most))
        return whole

    one = optimize(made, motion, settings)
    monkeypatch.setattr(Descent, "look", wholly)
    other = optimize(made, motion, settings)
    assert np.array_equal(one.trajectory.positions, other.trajectory.positions)
    assert all(found == (whole if whole <= most else np.inf) for whole, found, most in looks)
    assert any(found == np.inf for _, found, _ in looks)


def kept_way(of: str, tolerance: float) -> tuple[Problem, np.ndarray]:
    """A Panda beside a post whose tip stays near a level plane, or upright, and a way through random places there."""
    post = messages.Box(name="post", size=(0.1, 0.1, 1.2), position=(0.6, 0.6, 0.6))
    made, rng = problem("panda", scene_of(post), planes=()), np.random.default_rng(4)
    first = made.z_start
    placed = made.kinematics.frame_placement(made.group.expand_from_chart(first), made.group.tip_id)
    axis = np.array([0.0, 0.0, 1.0])
    one: PathConstraint = plane(made.group.tip, placed.translation, axis, tolerance)
    if of == "cone":
        one = Cone(made.group.tip, axis, placed.rotation @ axis, tolerance)
    made = dataclasses.replace(made, path_constraints=(one,))
    keeper, path = Keeper(made, made.constrained_frames), [first]
    target = first + np.array([-1.2, 0.5, 0.3, 0.2, 0.4, 0.3, 0.0])
    for share in np.linspace(0.0, 1.0, 30)[1:]:
        back = keeper.bring_back(first + share * (target - first) + 0.05 * rng.normal(size=7))
        assert back is not None
        path.append(back)
    return made, np.array(path)


@pytest.mark.parametrize(("of", "tolerance"), [("plane", 0.002), ("plane", 0.03), ("cone", 0.3)])
def test_path_constraints_are_kept_between_samples_too(of: str, tolerance: float) -> None:
    made, path = kept_way(of, tolerance)
    motion = time_path_ignoring_jerk(made, path)
    trajectory = optimize(made, motion, constrained(BALANCED)).trajectory
    assert trajectory.duration < 0.8 * motion.duration
    check_limits(made, trajectory)
    assert certify(made.world, trajectory.bezier()).free
    assert certify_constraints(made.constrained_frames, made.world.bodies.turns, trajectory.bezier()).free
    zs = trajectory.evaluate(np.linspace(0.0, trajectory.duration, 1000))[0]
    assert max(float(made.constrained_frames.values(z)[0]) for z in zs) <= tolerance
    np.testing.assert_array_equal(trajectory.positions[[0, -1]], path[[0, -1]])


UPRIGHT = {
    "type": "orientation_cone",
    "frame": "panda_hand_tcp",
    "axis": [0, 0, 1],
    "target_axis": [0, 0, -1],
    "half_angle": 0.9,
}
POST = {"type": "box", "name": "post", "size": [0.06, 0.06, 1.0], "position": [0.55, 0.0, 0.5]}
PASSING = {
    **POST,
    "trajectory": {
        "times": [0.0, 4.0],
        "placements": [{"position": [0.55, -0.6, 0.5]}, {"position": [0.55, 0.6, 0.5]}],
    },
}


@pytest.mark.parametrize(
    "more",
    [
        {"scene": {"name": "post", "obstacles": [POST]}},
        {"scene": {"name": "post", "obstacles": [POST]}, "path_constraints": [UPRIGHT]},
        {"scene": {"name": "passing", "obstacles": [PASSING]}},
        {
            "scene": {"name": "post", "obstacles": [POST]},
            "cartesian_limits": [{"frame": "panda_hand_tcp", "speed": 0.5}],
            "limits": {"panda_joint1": {"effort": 20.0}},
        },
    ],
    ids=["still", "constrained", "moving", "limited"],
)
def test_a_kernel_that_checks_its_arguments_once_gets_them_of_the_same_types_each_time(
    more: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: dict[str, set[tuple]] = {}
    call = interior_point._CheckedOnce.__call__

    def noted(kernel: Any, *arguments: Any) -> Any:
        types = tuple(numba.typeof(argument) for argument in arguments)
        taken.setdefault(kernel._kernel.__name__, set()).add(types)
        return call(kernel, *arguments)

    monkeypatch.setattr(interior_point._CheckedOnce, "__call__", noted)
    start = {f"panda_joint{i + 1}": q for i, q in enumerate([-0.7, 0.3, 0.0, -2.0, 0.0, 2.3, 0.8])}
    goal = {"type": "joints", "positions": {**start, "panda_joint1": 0.7}}
    reply = guidefield.answer({"robot": "panda", "start": start, "goal": goal, "allowed_planning_time": 60.0, **more})
    assert reply.status.name == "SUCCESS"
    assert {name: len(types) for name, types in taken.items()} == {"clearance_along": 1, "newton_descent": 1}
