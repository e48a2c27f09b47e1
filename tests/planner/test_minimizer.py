"""Descent on the constraint manifold: it descends, stays, and ends where the projected gradient vanishes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from guidefield.planner.constraints import OnPlane, Reorienting, Sliding
from guidefield.planner.minimizer import ON_CONSTRAINT, descend
from guidefield.planner.problem import Problem
from tests.planner.problems import library_scene, problem
from tests.robots import ARMS, group, rest

NORMAL = np.array([1.0, 0.0, 0.0])


def constraints(made: Problem, q: np.ndarray) -> dict[str, object]:
    kinematics = made.kinematics
    tip = kinematics.frame_placement(q, made.group.tip_id)
    return {
        "plane": OnPlane(kinematics, tip.translation, NORMAL),
        "slide": Sliding(kinematics, tip.translation, NORMAL, tip.rotation),
        "reorient": Reorienting(kinematics, tip.translation),
    }


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("kind", ["plane", "slide", "reorient"])
def test_the_rows_are_the_derivative_of_the_error(name: str, kind: str) -> None:
    made = problem(name, "table")
    q = rest(made.group)
    constraint = constraints(made, q)[kind]
    away = made.group.integrate(q, 1e-3 * np.ones(made.group.nv))
    h = 1e-6
    rows = constraint.rows(away)
    for column, v in enumerate(np.eye(made.group.nv)):
        ahead, behind = (constraint.error(made.group.integrate(away, s * h * v)) for s in (1, -1))
        # the rotation's rows are exact where the rotation held is the present one; here it is a milliradian off
        np.testing.assert_allclose(rows[:, column], (ahead - behind) / (2 * h), atol=5e-3)


@pytest.mark.parametrize("kind", ["plane", "slide", "reorient"])
def test_a_descent_lowers_the_potential_and_keeps_the_constraint(kind: str) -> None:
    made = problem("panda", "bookshelf")
    q = made.group.integrate(rest(made.group), 0.2 * np.array([1, 1, -1, 1, 1, 1, 1]))
    constraint = constraints(made, q)[kind]
    descent = descend(made, q, constraint, lambda a, b: True)
    potentials = [made.robot_field.potential(p) for p in (q, *descent.path)]
    assert len(descent.path) >= 1
    assert all(after < before for before, after in pairwise(potentials))
    assert descent.potential == pytest.approx(potentials[-1], rel=1e-12)
    for p in descent.path:
        assert np.abs(constraint.error(p)).max() <= ON_CONSTRAINT
        z = made.group.chart(p)
        assert np.all((z >= made.group.lower) & (z <= made.group.upper))


def test_run_to_convergence_the_projected_gradient_vanishes() -> None:
    made = problem("panda", "bookshelf")
    q = rest(made.group)
    constraint = constraints(made, q)["reorient"]
    end = descend(made, q, constraint, lambda a, b: True, tolerance=1e-12, most_steps=400).path[-1]
    gradient, rows = made.robot_field.evaluate(end).gradient, constraint.rows(end)
    z = made.group.chart(end)
    free = (z > made.group.lower + 1e-6) & (z < made.group.upper - 1e-6)
    g, C = gradient[free], rows[:, free]
    projected = g - C.T @ np.linalg.lstsq(C.T, g, rcond=None)[0]
    start = made.robot_field.evaluate(q).gradient
    assert np.linalg.norm(projected) < 1e-3 * np.linalg.norm(start)


def test_no_step_that_is_not_accepted_is_taken() -> None:
    made = problem("ur5", "table")
    q = rest(made.group)
    refused = descend(made, q, constraints(made, q)["plane"], lambda a, b: False)
    assert refused.path == ()
    assert refused.potential == pytest.approx(made.robot_field.potential(q), rel=1e-12)


def test_it_is_deterministic() -> None:
    ends = []
    for _ in range(2):
        made = problem(group("panda"), library_scene("bookshelf"))
        ends.append(descend(made, made.q_start, constraints(made, made.q_start)["plane"], lambda a, b: True).path[-1])
    np.testing.assert_array_equal(*ends)
