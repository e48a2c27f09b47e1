"""The seed's own minimizer: it lowers U, keeps what it has to, crosses planes, and says for which robots it is."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from guidefield.collision.clearance import clearance_at
from guidefield.errors import InvalidGroup
from guidefield.planner.guide.guide import ATTEMPTS, Univariate, cross_plane
from guidefield.planner.guide.guided_path import GuidedPath
from guidefield.planner.guide.rounds import Minimizer, Projected
from guidefield.planner.task.problem import Problem
from guidefield.robot.group.link_chain import link_chain
from tests.planner.guide.guards import ANYWHERE
from tests.planner.problems import densely_free, seed_problem
from tests.robots import ARMS, group

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
    assert densely_free(made, made.group.chart_path(list(guided.path)), step=0.02)


@pytest.mark.parametrize(("title", "least"), [("seed_b_tapered", 0.044), ("seed_c_blocked", 0.015)])
def test_rounds_that_come_near_obstacles_on_the_way_are_made_in_shorter_advances(title: str, least: float) -> None:
    """The issue's clearance, by Coal, at points along the straight motions between the path's configurations."""
    made = seed_problem(title)
    q, group = made.q_start, made.group
    for index, plane in enumerate(made.guide_planes):
        crossing = cross_plane(made, q, plane, index, ATTEMPTS["univariate"](group))
        q = crossing.path[-1]
        for start, end in pairwise(crossing.path):
            a = group.chart(start)
            b = group.unwrapped(group.chart(end), a)
            between = [group.from_chart(a + t * (b - a)) for t in np.linspace(0.0, 1.0, 8)]
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
