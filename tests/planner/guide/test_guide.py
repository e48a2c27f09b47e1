"""Planes are crossed, every step is free, a "no" is honest; the thesis' own minimizer lowers U and keeps its guard."""

from itertools import pairwise

import numpy as np
import pytest

from guidefield.collision.clearance import clearance_at
from guidefield.errors import InvalidGroup, Status
from guidefield.messages import scene as messages
from guidefield.planner.guide.guide import ATTEMPTS, Univariate, cross_plane, explain_unreachable, inset_of
from guidefield.planner.guide.guided_path import GuidedPath, reach_point
from guidefield.planner.guide.rounds import ON_PLANE, Minimizer, Projected
from guidefield.planner.task.problem import Problem
from guidefield.robot.group.link_chain import link_chain
from guidefield.scene.guide_plane import build
from tests.planner.guide.test_rounds import ANYWHERE
from tests.planner.problems import densely_free, problem, scene_of, seed_problem
from tests.robots import ARMS, group


def plane_at(x: float, half: float = 0.1, y: float = 0.0, z: float = 0.5) -> messages.GuidePlane:
    corners = [(x, y - half, z - half), (x, y + half, z - half), (x, y + half, z + half), (x, y - half, z + half)]
    return messages.GuidePlane(name="GP", vertices=corners)


@pytest.mark.parametrize(
    ("scene", "minimizer"),
    [
        *((scene, None) for scene in ("bookshelf", "wall_with_window", "seed_e_L_3_planar", "seed_e_L_6_planar")),
        *((scene, "univariate") for scene in ("seed_a_gates", "seed_d_passage_3", "seed_a_gates_universal")),
    ],
)
def test_every_plane_is_crossed_in_order_and_every_step_is_free(scene: str, minimizer: str | None) -> None:
    seed = scene.startswith("seed")
    made = seed_problem(scene) if seed else problem("panda", scene)
    q = made.q_start
    assert made.guide_planes
    for index, plane in enumerate(made.guide_planes):
        crossing = cross_plane(made, q, plane, index, *((ATTEMPTS[minimizer](made.group),) if minimizer else ()))
        assert crossing.status is Status.SUCCESS, crossing.message
        np.testing.assert_array_equal(crossing.path[0], q)
        assert densely_free(made, made.group.local_path(list(crossing.path)), step=0.02 if seed else 0.01)
        q = crossing.path[-1]
        tip = made.kinematics.tip_position(q)
        assert abs(plane.signed_height(tip)) <= ON_PLANE
        assert plane.contains(tip)
        assert tip[2] == 0.0 or "planar" not in scene


@pytest.mark.parametrize("name", ["ur5", "xarm7", "kinova"])
def test_other_arms_cross_a_plane_in_front_of_them(name: str) -> None:
    made = problem(name, scene_of(planes=[]))
    tip = made.kinematics.tip_position(made.q_start)
    toward = tip + np.array([0.0, 0.12, 0.05])
    corners = [toward + np.array([dx, 0.0, dz]) for dx, dz in ((-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2))]
    plane = build(messages.GuidePlane(name="GP", vertices=[tuple(c) for c in corners]), 0)
    crossing = cross_plane(made, made.q_start, plane, 0)
    assert crossing.status is Status.SUCCESS, crossing.message
    assert abs(plane.signed_height(made.kinematics.tip_position(crossing.path[-1]))) <= ON_PLANE


def test_a_plane_inside_an_obstacle_is_refused_at_once() -> None:
    made = problem("panda", scene_of(messages.Box(name="block", size=(0.2, 0.4, 0.4), position=(0.6, 0.0, 0.5))))
    crossing = cross_plane(made, made.q_start, build(plane_at(0.6), 0), 0)
    assert crossing.status is Status.GUIDE_PLANE_UNREACHABLE
    assert crossing.details["obstacle"] == "block"
    assert "that the tip heads for" in crossing.message


def test_a_plane_with_free_places_between_small_obstacles_is_not_called_blocked() -> None:
    plane = build(plane_at(0.6, half=0.3), 0)
    corners = plane.inset_vertices(inset_of(problem("panda", scene_of()), plane))
    places = [plane.centroid, *(plane.centroid + t * (corners - plane.centroid) for t in (0.5, 1.0))]
    spheres = [
        messages.Sphere(name=f"s{i}", radius=0.01, position=tuple(map(float, place)))
        for i, place in enumerate(np.vstack(places))
    ]
    assert explain_unreachable(problem("panda", scene_of(*spheres)), plane) is None


def test_a_plane_behind_a_wall_gets_it_stuck_with_the_pair_named() -> None:
    wall = messages.Box(name="wall", size=(0.02, 3.0, 3.0), position=(0.55, 0.0, 0.5))
    made = problem("panda", scene_of(wall))
    crossing = cross_plane(made, made.q_start, build(plane_at(0.7), 0), 0)
    assert crossing.status is Status.STUCK_IN_MINIMUM
    assert crossing.details["distance"] > 0.05
    assert "wall" in crossing.details["pair"]
    assert densely_free(made, made.group.local_path(list(crossing.path)), step=0.01)


def test_a_plane_that_joint_limits_keep_out_of_reach_is_unreachable() -> None:
    made = problem("panda", scene_of())
    # within the sum of the link lengths, but under the base's own column and beyond the elbow's limits
    crossing = cross_plane(made, made.q_start, build(plane_at(0.0, half=0.05, z=-0.75), 0), 0)
    assert crossing.status in (Status.GUIDE_PLANE_UNREACHABLE, Status.STUCK_IN_MINIMUM)
    assert crossing.details["distance"] > 0.01


def test_reach_point_moves_the_tip_exactly_and_within_limits() -> None:
    made = problem("panda", scene_of())
    for offset in np.eye(3) * 0.1:
        target = made.kinematics.tip_position(made.q_start) + offset
        q = reach_point(made, made.q_start, target)
        np.testing.assert_allclose(made.kinematics.tip_position(q), target, atol=1e-6)
        assert np.all((q >= made.group.lower) & (q <= made.group.upper))
    assert reach_point(made, made.q_start, np.array([5.0, 0.0, 0.0])) is None


SCENES = ("seed_a_gates", "seed_d_passage_3", "seed_a_gates_universal", "seed_d_passage_6_universal")
NORMAL = np.array([0.6, 0.0, 0.8])


def settled(made: Problem, minimizer: Minimizer, normal: np.ndarray = NORMAL) -> GuidedPath:
    guided = GuidedPath(made, made.q_start, 2e-3, 0)
    minimizer.minimize(guided, guided.tip, normal, ANYWHERE)
    return guided


@pytest.mark.parametrize("title", SCENES)
def test_settling_lowers_the_potential_on_the_plane_and_every_step_is_free(title: str) -> None:
    made = seed_problem(title)
    guided = settled(made, Univariate(link_chain(made.group)))
    tip = made.kinematics.tip_position(made.q_start)
    assert made.robot_field.potential(guided.q) < 0.99 * made.robot_field.potential(made.q_start)
    assert abs(NORMAL @ (guided.tip - tip)) < 1e-6
    assert densely_free(made, made.group.local_path(list(guided.path)), step=0.02)


@pytest.mark.parametrize(("title", "least"), [("seed_b_tapered", 0.044), ("seed_c_blocked", 0.015)])
def test_rounds_that_come_near_obstacles_on_the_way_are_made_in_shorter_advances(title: str, least: float) -> None:
    """The issue's clearance, by Coal, at points along the straight motions between the path's configurations."""
    made = seed_problem(title)
    q, group = made.q_start, made.group
    for index, plane in enumerate(made.guide_planes):
        crossing = cross_plane(made, q, plane, index, ATTEMPTS["univariate"](group))
        q = crossing.path[-1]
        for start, end in pairwise(crossing.path):
            a = group.to_local(start)
            b = group.unwrapped(group.to_local(end), a)
            between = [group.from_local(a + t * (b - a)) for t in np.linspace(0.0, 1.0, 8)]
            assert min(clearance_at(made.world, p).obstacle_distance for p in between) >= least


@pytest.mark.parametrize("title", ["seed_a_gates", "seed_e_L_3"])
def test_run_to_convergence_projected_ends_at_its_potential_or_below(title: str) -> None:
    made = seed_problem(title)
    projected = settled(made, Projected(tolerance=1e-9, most_steps=400)).q
    univariate = settled(made, Univariate(link_chain(made.group), negligible=1e-6, most_rounds=40)).q
    lowest, other = made.robot_field.potential(projected), made.robot_field.potential(univariate)
    assert lowest <= other * (1.0 + 5e-4)


@pytest.mark.parametrize("name", ARMS)
def test_arms_are_refused_by_name(name: str) -> None:
    with pytest.raises(InvalidGroup, match=r"univariate.*ball joints.*projected"):
        ATTEMPTS["univariate"](group(name))
    assert len(ATTEMPTS["projected"](group(name))) == 3
