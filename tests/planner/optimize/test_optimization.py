"""Optimised motions: faster, clear of obstacles, certified, within limits, from rest to rest, the same every time."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.messages import scene as messages
from guidefield.planner.connect import Keeper
from guidefield.planner.motion.timing import stretch_spline_to_limits
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.optimize.optimization import Optimized, Outcome, optimize
from guidefield.planner.optimize.passages import REACHED, Passage, PlanePlace
from guidefield.planner.optimize.settings import BALANCED, OPTIMIZATION, for_path_constraints
from guidefield.planner.path_so_far import limits_of, retime_motion, time_path_ignoring_jerk
from guidefield.planner.task.motion_limits import frame_limit
from guidefield.planner.task.problem import Objective, Problem
from guidefield.prove.certificate import certify, certify_constraints
from guidefield.robot.group.path_constraints import Cone, PathConstraint, plane
from guidefield.scene.guide_plane import GuidePlane, build
from tests.planner.problems import beside_the_path, over_the_wall, problem, scene_of, smallest_clearance
from tests.robots import box_arm, group, grouped
from tests.scene.solids import l_prism, mesh_message


def optimized(made: Problem, path: np.ndarray) -> Optimized:
    return optimize(made, time_path_ignoring_jerk(made, path), BALANCED)


def test_a_limit_of_speed_in_space_gives_a_motion_another_shape() -> None:
    """The arm is drawn in on its way round: the tip's path is shorter there."""
    limit, durations = frame_limit(group("panda"), "panda_hand_tcp", 0.25, np.inf), []
    made = problem("panda", scene_of(), cartesian_limits=(limit,))
    path = np.array([[side, 0.6, 0.0, -1.2, 0.0, 1.8, 0.8] for side in (-1.3, 1.3)])
    for asked in (made, problem("panda", scene_of())):
        slower = retime_motion(made, optimized(asked, path).trajectory)
        assert slower is not None
        motion = stretch_spline_to_limits(slower, limits_of(made))
        reached = limit.measure(motion.polynomials)[0]
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


@settings(max_examples=9)
@given(st.integers(0, 10_000), st.sampled_from([None, 20.0]), st.sampled_from(["y x", "slide y x", "planar y"]))
def test_every_motion_is_within_limits_and_no_slower_than_one_joint_needs(seed, jerk, joints):
    planned = grouped(box_arm(joints, 0, size=0.25))
    rng = np.random.default_rng(seed)
    path = np.array([planned.to_local(planned.random(rng)) for _ in range(3)])
    limits = None if jerk is None else np.full(planned.nv, jerk)
    made = problem(planned, scene_of(), planes=(), jerk_limits=limits)
    trajectory = optimized(made, path).trajectory
    check_limits(made, trajectory)
    offset = np.abs(path[-1] - path[0])
    bound = np.maximum(offset / planned.velocity_limits, 2.0 * np.sqrt(offset / planned.acceleration_limits)).max()
    assert trajectory.duration >= bound * (1.0 - 1e-9)
    np.testing.assert_array_equal(trajectory.positions[[0, -1]], path[[0, -1]])


@pytest.mark.parametrize("size", [1e-5, 1e-3])
def test_a_tiny_motion_stays_within_limits(size: float) -> None:
    made = problem("panda", scene_of(), planes=(), jerk_limits=np.full(7, 100.0))
    z = made.group.to_local(made.q_start)
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


@pytest.mark.parametrize(("asked", "objective"), [(0.05, "balanced"), (0.1, "balanced"), (0.08, "time")])
def test_the_clearance_asked_for_is_kept(asked: float, objective: str) -> None:
    made, path = over_the_wall()
    weights = OPTIMIZATION[Objective(objective)]
    problems = (dataclasses.replace(made, min_clearance=c) for c in (0.0, asked))
    plain, kept = (optimize(one, time_path_ignoring_jerk(one, path), weights).trajectory for one in problems)
    assert not certify(made.world, plain.bezier(), asked).free
    assert certify(made.world, kept.bezier(), asked).free
    assert plain.duration < kept.duration < 1.3 * plain.duration


def test_each_objective_is_better_at_what_it_is_for() -> None:
    made, path = over_the_wall()
    by = {one: optimize(made, time_path_ignoring_jerk(made, path), OPTIMIZATION[one]).trajectory for one in Objective}
    kept = {one: smallest_clearance(made, trajectory.positions, 0.3) for one, trajectory in by.items()}
    for trajectory in by.values():
        assert certify(made.world, trajectory.bezier()).free
        check_limits(made, trajectory)
    assert by[Objective.TIME].duration < by[Objective.BALANCED].duration < by[Objective.CLEARANCE].duration
    assert kept[Objective.TIME] < kept[Objective.BALANCED] < kept[Objective.CLEARANCE]


def square(middle: np.ndarray, half: float) -> GuidePlane:
    """A square across the world's y axis."""
    corners = [middle + half * np.array([a, 0.0, b]) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return build(messages.GuidePlane(name="GP", vertices=[tuple(c.tolist()) for c in corners]), 0)


def by_way_of(turn: float) -> tuple[Problem, np.ndarray, PlanePlace]:
    """A Panda in the open that turns by so much about its base, the long way through a small square at its start."""
    made = problem("panda", scene_of(), planes=())
    z = made.group.to_local(made.q_start)
    start, goal, detour = z.copy(), z.copy(), z.copy()
    start[0], goal[0] = -0.5, -0.5 + turn
    detour[1] -= 0.5
    plane = square(made.kinematics.tip_positions(detour[None])[0], 0.03)
    return made, np.array([start, detour, goal]), PlanePlace.through(made, plane, detour)


@pytest.mark.parametrize("turn", [1.0, 0.2], ids=["through it", "there and back"])
def test_a_guided_motion_crosses_its_plane_though_a_shorter_path_leads_past_it(turn: float) -> None:
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
    missed, nearly = (min(place.plane.distance(tip) for tip in tip_path[::20]) for tip_path in tips)
    assert missed > 0.05
    assert nearly < 0.01
    q = through.trajectory.positions[through.passed[0]]
    tip = made.kinematics.tip_position(made.group.expand_from_local(q))
    assert place.plane.distance(tip, place.inset) <= REACHED
    assert place.plane.contains(tip)


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
    made = beside_the_path(planned, path)
    after = optimized(made, path).trajectory
    check_limits(made, after)
    assert smallest_clearance(made, after.positions) > smallest_clearance(made, path) + 0.01


def constrained_path(of: str, tolerance: float) -> tuple[Problem, np.ndarray]:
    """A Panda beside a post whose tip stays near a level plane, or upright, and a path through random places there."""
    post = messages.Box(name="post", size=(0.1, 0.1, 1.2), position=(0.6, 0.6, 0.6))
    made, rng = problem("panda", scene_of(post), planes=()), np.random.default_rng(4)
    first = made.z_start
    placed = made.kinematics.frame_placement(made.group.expand_from_local(first), made.group.tip_id)
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
    made, path = constrained_path(of, tolerance)
    motion = time_path_ignoring_jerk(made, path)
    trajectory = optimize(made, motion, for_path_constraints(BALANCED)).trajectory
    assert trajectory.duration < 0.8 * motion.duration
    check_limits(made, trajectory)
    assert certify(made.world, trajectory.bezier()).free
    assert certify_constraints(made.constrained_frames, made.world.bodies.turns, trajectory.bezier()).free
    zs = trajectory.evaluate(np.linspace(0.0, trajectory.duration, 1000))[0]
    assert max(float(made.constrained_frames.values(z)[0]) for z in zs) <= tolerance
    np.testing.assert_array_equal(trajectory.positions[[0, -1]], path[[0, -1]])
