"""Descent on the constraint manifold: it descends, stays, and ends where the projected gradient vanishes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from guidefield.collision.clearance import clearance_at, contacts_at
from guidefield.errors import Status
from guidefield.kernels.guide.tip_constraint import TipConstraint
from guidefield.planner.guide.guide import ATTEMPTS, cross_plane
from guidefield.planner.guide.guided_path import GuidedPath
from guidefield.planner.guide.rounds import (
    ON_CONSTRAINT,
    Descent,
    descend,
    on_plane,
    reorienting,
    sliding,
)
from guidefield.planner.task.problem import Problem
from guidefield.potential import Precision, RobotField
from tests.planner.guide.guards import ANYWHERE
from tests.planner.guide.tip_constraints import evaluated
from tests.planner.problems import problem, seed_problem
from tests.robots import ARMS, rest

NORMAL = np.array([1.0, 0.0, 0.0])


def constraints(made: Problem, q: np.ndarray) -> dict[str, TipConstraint]:
    tip = made.kinematics.frame_placement(q, made.group.tip_id)
    return {
        "plane": on_plane(tip.translation, NORMAL),
        "slide": sliding(tip.translation, NORMAL, tip.rotation),
        "reorient": reorienting(tip.translation),
    }


def descended(made: Problem, q: np.ndarray, constraint: TipConstraint, **options) -> Descent:
    return descend(GuidedPath(made, q, 2e-3, 0), constraint, ANYWHERE, **options)


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("kind", ["plane", "slide", "reorient"])
def test_the_rows_are_the_derivative_of_the_error(name: str, kind: str) -> None:
    made = problem(name, "table")
    q = rest(made.group)
    constraint = constraints(made, q)[kind]
    away = made.group.integrate(q, 1e-3 * np.ones(made.group.nv))
    h = 1e-6
    rows = evaluated(constraint, made.group, away)[1]
    for column, v in enumerate(np.eye(made.group.nv)):
        ahead, behind = (evaluated(constraint, made.group, made.group.integrate(away, s * h * v))[0] for s in (1, -1))
        # the rotation's rows are exact where the rotation held is the present one; here it is a milliradian off
        np.testing.assert_allclose(rows[:, column], (ahead - behind) / (2 * h), atol=5e-3)


@pytest.mark.parametrize("kind", ["plane", "slide", "reorient"])
def test_a_descent_lowers_the_potential_and_keeps_the_constraint(kind: str) -> None:
    made = problem("panda", "bookshelf")
    q = made.group.integrate(rest(made.group), 0.2 * np.array([1, 1, -1, 1, 1, 1, 1]))
    constraint = constraints(made, q)[kind]
    descent = descended(made, q, constraint)
    double = RobotField(made.group, made.scene, Precision.DOUBLE)
    potentials = [double.potential(p) for p in (q, *descent.path)]
    assert len(descent.path) >= 1
    assert all(after < before for before, after in pairwise(potentials))
    assert descent.potential == pytest.approx(potentials[-1], rel=1e-6)
    for p in descent.path:
        assert np.abs(evaluated(constraint, made.group, p)[0]).max() <= ON_CONSTRAINT
        z = made.group.chart(p)
        assert np.all((z >= made.group.lower) & (z <= made.group.upper))


def test_run_to_convergence_the_projected_gradient_vanishes() -> None:
    made = problem("panda", "bookshelf")
    q = rest(made.group)
    constraint = constraints(made, q)["reorient"]
    end = descended(made, q, constraint, tolerance=1e-12, most_steps=400).path[-1]
    gradient, rows = made.robot_field.evaluate(end).gradient, evaluated(constraint, made.group, end)[1]
    z = made.group.chart(end)
    free = (z > made.group.lower + 1e-6) & (z < made.group.upper - 1e-6)
    g, C = gradient[free], rows[:, free]
    projected = g - C.T @ np.linalg.lstsq(C.T, g, rcond=None)[0]
    start = made.robot_field.evaluate(q).gradient
    assert np.linalg.norm(projected) < 1e-3 * np.linalg.norm(start)


def test_motions_that_capsules_cannot_tell_are_judged_by_the_certificate() -> None:
    """Where nearly all of the distance at the start is to be kept, capsules about a Panda are too thick."""
    made = problem("panda", "bookshelf")
    q = rest(made.group)
    guided = GuidedPath(made, q, clearance_at(made.world, q).obstacle_distance - 0.005, 0)
    asked: list[bool] = []
    judged = guided.judge
    guided.judge = lambda q0, q1: asked.append(judged(q0, q1)) or asked[-1]
    descent = descend(guided, constraints(made, guided.q)["plane"], ANYWHERE)
    assert asked
    assert sum(asked) <= len(descent.path)
    q = guided.q
    for p in descent.path:
        assert contacts_at(made.world, p) == []
        assert judged(q, p)
        q = p


def test_close_to_obstacles_it_goes_on_for_clearance() -> None:
    """The blocked passage: between its walls a thousandth of U is millimetres."""
    made = seed_problem("seed_c_blocked")
    q, nearest = made.q_start, np.inf
    for index, plane in enumerate(made.guide_planes):
        crossing = cross_plane(made, q, plane, index, ATTEMPTS["projected"](made.group))
        assert crossing.status is Status.SUCCESS, crossing.message
        q = crossing.path[-1]
        zs = made.group.chart_path(list(crossing.path))
        for a, b in pairwise(zs):
            for t in np.linspace(0.0, 1.0, 20):
                at = made.group.from_chart(a + t * (b - a))
                nearest = min(nearest, clearance_at(made.world, at).obstacle_distance)
    assert nearest > 0.0145  # without: 0.0116
