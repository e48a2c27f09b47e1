"""Systems solved joint by joint against the dense metric and numpy."""

import numpy as np
import pytest

from guidefield.kernels.field.energy import forces
from guidefield.kernels.kinematics.articulated_body import empty_factors, factorize, solve, trace
from guidefield.kernels.kinematics.forward_kinematics import motion_subspaces
from guidefield.potential import RobotField
from tests.planner.problems import library_scene
from tests.robots import box_arm, group, grouped


def solved(joints, subspaces, inertias, ridge, right):
    """The parts of kernels, run as Python."""
    n = joints.parents.shape[0]
    factors = empty_factors(n, subspaces.shape[0])
    factors.subspaces[:, :] = subspaces
    factorize(joints, inertias, ridge, factors)
    solution = right.copy()
    solve(joints, factors, solution, np.empty((n, 6)), solution)
    return solution, trace(joints, subspaces, inertias, np.empty((n, 10)))


@pytest.mark.parametrize("kind", ["chain_fixed_6x300_r25", "chain_moving_6x200_r20", "panda", "x slide oblique y"])
def test_solutions_are_those_of_the_dense_metric(kind: str) -> None:
    planned = group(kind) if " " not in kind else grouped(box_arm(kind, 0))
    field = RobotField(planned, library_scene("seed_a_gates"))
    rng = np.random.default_rng(0)
    q = planned.random(rng)
    n, nv = planned.model.njoints, planned.model.nv
    world, wrenches, inertias = np.empty((n, 3, 4)), np.empty((n, 6)), np.empty((n, 10))
    forces(field.joints, field.charged, field.tables, q, world, wrenches, inertias)
    subspaces = np.empty((nv, 6))
    joints = field.joints
    motion_subspaces(joints, world, subspaces)
    dense = field.evaluate(q).metric
    ridge, right = 1e-2 * np.trace(dense) / nv, rng.normal(size=nv)
    found, diagonal = solved(joints, subspaces, inertias, ridge, right)
    np.testing.assert_allclose(found, np.linalg.solve(dense + ridge * np.eye(nv), right), rtol=1e-8, atol=1e-12)
    assert diagonal == pytest.approx(np.trace(dense), rel=1e-10)
