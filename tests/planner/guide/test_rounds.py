"""Rounds in one kernel equal those made step by step; descent on the constraint manifold descends, stays and ends."""

from itertools import pairwise

import numpy as np
import pytest

from guidefield.collision.clearance import clearance_at, contacts_at
from guidefield.errors import Status
from guidefield.kernels.guide.tip_constraint import TipConstraint, TipGuard, constraint_error, constraint_rows
from guidefield.kernels.kinematics.forward_kinematics import joint_placements, motion_subspaces
from guidefield.planner.guide.guide import ATTEMPTS, FIRST_STEP, cross_plane, inset_of, margin_at
from guidefield.planner.guide.guided_path import GuidedPath
from guidefield.planner.guide.rounds import (
    ON_CONSTRAINT,
    Aim,
    Attempt,
    Descent,
    Made,
    Projected,
    Round,
    approach,
    descend,
    on_plane,
    reorienting,
    rounds,
    sliding,
)
from guidefield.planner.task.problem import Problem
from guidefield.potential import Precision, RobotField
from guidefield.read_only import read_only
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import mover_of
from tests.planner.problems import problem, seed_problem
from tests.robots import ARMS, rest

ATTEMPT = Attempt(Projected(), FIRST_STEP)


@pytest.mark.parametrize("title", ["seed_c_blocked", "seed_d_passage_3", "seed_e_L_6"])
def test_the_same_way_to_a_plane(title: str) -> None:
    made = seed_problem(title)
    plane = made.guide_planes[0]
    aim = Aim(plane, inset_of(made, plane))
    walkers = [GuidedPath(made, made.q_start, margin_at(made, made.q_start), 0) for _ in range(2)]
    at_once: list[Made] = []
    while not at_once or at_once[-1].ended is Round.NEARER:
        at_once += rounds(walkers[0], aim, ATTEMPT)
    one_by_one = []
    while not one_by_one or one_by_one[-1].ended is Round.NEARER:
        before = aim.distance(walkers[1].tip)
        one_by_one.append(Made(approach(walkers[1], aim, ATTEMPT), before, aim.distance(walkers[1].tip)))
    assert at_once[-1].ended is Round.ARRIVED
    assert [made.ended for made in at_once] == [made.ended for made in one_by_one]
    for a, b in zip(at_once, one_by_one, strict=True):
        np.testing.assert_allclose((a.before, a.after), (b.before, b.after), atol=1e-9)
    np.testing.assert_allclose(walkers[0].path, walkers[1].path, atol=1e-8)


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
        z = made.group.to_local(p)
        assert np.all((z >= made.group.lower) & (z <= made.group.upper))


def test_run_to_convergence_the_projected_gradient_vanishes() -> None:
    made = problem("panda", "bookshelf")
    q = rest(made.group)
    constraint = constraints(made, q)["reorient"]
    end = descended(made, q, constraint, tolerance=1e-12, most_steps=400).path[-1]
    gradient, rows = made.robot_field.evaluate(end).gradient, evaluated(constraint, made.group, end)[1]
    z = made.group.to_local(end)
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
        zs = made.group.local_path(list(crossing.path))
        for a, b in pairwise(zs):
            for t in np.linspace(0.0, 1.0, 20):
                at = made.group.from_local(a + t * (b - a))
                nearest = min(nearest, clearance_at(made.world, at).obstacle_distance)
    assert nearest > 0.0145  # without: 0.0116


ANYWHERE = TipGuard(
    origin=np.zeros(3),
    axes=np.eye(2, 3),
    inward=np.eye(2),
    offsets=np.zeros(2),
    corners=np.zeros((1, 2)),
    inset=0.0,
    farthest=np.inf,
    depth=-np.inf,
)
read_only(*ANYWHERE[:5])


def evaluated(constraint: TipConstraint, group: PlanningGroup, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A constraint's numbers at q (nq,), and their derivative by the tangent (rows, nv)."""
    mover = mover_of(group)
    world, subspaces = np.empty((len(mover.joints.parents), 3, 4)), np.empty((len(mover.leaders), 6))
    error, rows = np.empty(constraint.kind), np.empty((constraint.kind, group.nv))
    joint_placements(mover.joints, group.expand(q), world)
    motion_subspaces(mover.joints, world, subspaces)
    constraint_error(constraint, mover, world, np.zeros(3), error)
    constraint_rows(constraint, mover, world, subspaces, np.empty((6, group.nv)), rows)
    return error, rows
