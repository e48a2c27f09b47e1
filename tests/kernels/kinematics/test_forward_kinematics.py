"""Forward kinematics, steps, the chain to the tip and the metric against Pinocchio, for every kind of joint."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings, strategies as st

from guidefield.kernels.field.energy import forces
from guidefield.kernels.kinematics.articulated_body import empty_factors, factorize, solve, trace
from guidefield.kernels.kinematics.forward_kinematics import joint_placements, motion_subspaces
from guidefield.kernels.kinematics.integrate import clamp, integrate, reach
from guidefield.kernels.kinematics.link_chain import chain_configuration, close_chain, end_force, turn_from
from guidefield.planner.guide.rounds import Aim
from guidefield.potential import RobotField
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import Kinematics, find_planned_values, mover_of
from guidefield.robot.group.link_chain import SerialChain, link_chain
from guidefield.robot.model.model import joint_table
from guidefield.scene.guide_plane import build
from tests import robots
from tests.planner.guide.test_guide import plane_at
from tests.planner.problems import library_scene
from tests.robots import box_arm, group, grouped, rest


def tree_of_every_kind() -> pin.Model:
    """A branching tree with each joint kind, some axes oblique."""
    rng = np.random.default_rng(4)
    kinds = [
        pin.JointModelFreeFlyer(),
        pin.JointModelRX(),
        pin.JointModelRY(),
        pin.JointModelRZ(),
        pin.JointModelRevoluteUnaligned(1.0, 2.0, -0.5),
        pin.JointModelRUBX(),
        pin.JointModelPX(),
        pin.JointModelPrismaticUnaligned(0.5, 0.5, -1.0),
        pin.JointModelPlanar(),
        pin.JointModelSpherical(),
    ]
    model = pin.Model()
    for index, kind in enumerate(kinds):
        parent = int(rng.integers(0, index + 1))
        model.addJoint(parent, kind, pin.SE3.Random(), f"j{index}")
    return model


def oblique_continuous() -> pin.Model:
    """A chain of continuous joints about oblique axes, which only a URDF can make."""
    return robots.load(robots.box_arm("oblique-continuous", 3)).model


MODELS = {"every kind": tree_of_every_kind, "oblique continuous": oblique_continuous}


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("seed", range(5))
def test_placements_agree_with_pinocchio(name: str, seed: int) -> None:
    model = MODELS[name]()
    data = model.createData()
    q = pin.integrate(model, pin.neutral(model), np.random.default_rng(seed).normal(size=model.nv))
    table = joint_table(model)
    placements = np.empty((model.njoints, 3, 4))
    joint_placements(table, q, placements)
    pin.forwardKinematics(model, data, q)
    for index in range(model.njoints):
        expected = data.oMi[index]
        np.testing.assert_allclose(placements[index], np.c_[expected.rotation, expected.translation], atol=1e-12)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("seed", range(5))
def test_subspaces_agree_with_pinocchios_jacobian(name: str, seed: int) -> None:
    model = MODELS[name]()
    q = pin.integrate(model, pin.neutral(model), np.random.default_rng(seed).normal(size=model.nv))
    table = joint_table(model)
    placements, subspaces = np.empty((model.njoints, 3, 4)), np.empty((model.nv, 6))
    joint_placements(table, q, placements)
    motion_subspaces(table, placements, subspaces)
    world_jacobian = pin.computeJointJacobians(model, model.createData(), q)  # world frame: velocities at its origin
    np.testing.assert_allclose(subspaces.T, world_jacobian, atol=1e-12)


KINDS = ["x slide oblique", "continuous oblique-continuous y", "x mimic slide y", "planar x y", "continuous screw y"]


def planned_groups():
    return [group(name) for name in ("chain_moving_3x260_r25", "chain_fixed_6x300_r25", "panda")] + [
        grouped(box_arm(kinds, 0)) for kinds in KINDS
    ]


@pytest.mark.parametrize("index", range(7))
def test_a_step_is_pinocchios(index: int) -> None:
    planned = planned_groups()[index]
    rng = np.random.default_rng(index)
    for scale in (1e-6, 0.3, 2.0):
        q, v = planned.random(rng), scale * rng.normal(size=planned.nv)
        reached = np.empty(planned.model.nq)
        integrate(mover_of(planned), planned.expand(q), v, reached)
        expected = planned.integrate(q, v)
        apart = pin.difference(planned.model, planned.expand(expected), reached)  # a quaternion has two signs
        np.testing.assert_allclose(apart, 0.0, atol=1e-9)
        np.testing.assert_allclose(planned.difference(expected, reached[find_planned_values(planned)]), 0.0, atol=1e-9)


def test_limits_stop_a_value_and_its_mimic_joints() -> None:
    planned = grouped(box_arm("x mimic slide y", 0))
    z = planned.upper + 0.2
    q = planned.expand_from_local(z)
    assert clamp(mover_of(planned), q, np.empty(planned.nv))
    np.testing.assert_allclose(q, planned.expand_from_local(planned.upper), atol=1e-12)


@pytest.mark.parametrize("name", ["panda", "chain_fixed_6x300_r25", "chain_moving_3x260_r25"])
def test_an_advance_reaches_its_point_within_the_limits(name: str) -> None:
    planned = group(name)
    q, kinematics = rest(planned), Kinematics(planned)
    q = planned.integrate(q, 0.1 * np.random.default_rng(0).normal(size=planned.nv))
    point = kinematics.tip_position(q) + np.array([-0.06, -0.05, -0.04])
    reached = np.empty(planned.nq)
    assert reach(mover_of(planned), q, point, reached)
    np.testing.assert_allclose(kinematics.tip_position(reached), point, atol=2e-6)
    z = planned.to_local(reached)
    assert np.all((z >= planned.lower - 1e-12) & (z <= planned.upper + 1e-12))
    assert not reach(mover_of(planned), q, point + 50.0, reached) or name.startswith("chain_moving")


@pytest.mark.parametrize("inset", [0.0, 0.03, 0.2])
def test_the_closest_point_of_an_inset_polygon_is_the_guide_planes(inset: float) -> None:
    plane = build(plane_at(0.45), 0)
    aim, rng = Aim(plane, inset), np.random.default_rng(3)
    for point in plane.centroid + 0.2 * rng.normal(size=(50, 3)):
        np.testing.assert_allclose(aim.closest_point(point), plane.closest_point(point, inset), atol=1e-9)
        assert aim.distance(point) == pytest.approx(plane.distance(point, inset), abs=1e-9)


def test_pinocchio_is_the_judge_of_floating_steps() -> None:
    """Small turns, where series stand for sines, join on to the others."""
    planned = group("chain_moving_3x260_r25")
    q, reached = rest(planned), np.empty(planned.nq)
    for angle in (9e-5, 1.1e-4):
        v = np.zeros(planned.nv)
        v[:6] = [0.1, 0.2, -0.3, angle, -angle, angle]
        integrate(mover_of(planned), q, v, reached)
        np.testing.assert_allclose(reached, pin.integrate(planned.model, q, v), atol=1e-13)


CHAINS = (
    "chain_fixed_6x300_r25",
    "chain_moving_3x260_r20",
    "chain_universal_fixed_6x300_r25",
    "chain_universal_moving_6x200_r20",
)


def random_places(seed: int, links: int = 5) -> np.ndarray:
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(links, 3))
    directions *= rng.uniform(0.1, 0.4, (links, 1)) / np.linalg.norm(directions, axis=1, keepdims=True)
    return np.vstack([rng.normal(size=3), np.zeros((links, 3))]) + np.vstack(
        [np.zeros(3), np.cumsum(directions, axis=0)]
    )


def lengths(places: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(places, axis=0), axis=1)


@settings(max_examples=12)
@given(seed=st.integers(0, 10**6), m=st.integers(2, 5), size=st.floats(0.0, 0.08))
@example(seed=82, m=3, size=0.078125)  # nearer to the first joint than the links can be folded
def test_a_closed_chain_ends_where_it_has_to_and_keeps_its_links(seed: int, m: int, size: float) -> None:
    places = random_places(seed)
    shift = np.random.default_rng(seed + 1).normal(size=3)
    target = places[m] + size * shift / np.linalg.norm(shift)
    whole, longest = lengths(places)[:m].sum(), lengths(places)[:m].max()
    # within what the links span, and not nearer to the first joint than the longest keeps all others away
    reachable = 2.0 * longest - whole < np.linalg.norm(target - places[0]) < 0.95 * whole
    closed = places.copy()
    if not close_chain(closed, m, target):
        assert not reachable or m == 2
        return
    np.testing.assert_allclose(closed[m], target, atol=2e-7)
    np.testing.assert_array_equal(closed[0], places[0])
    np.testing.assert_array_equal(closed[m + 1 :], places[m + 1 :])
    np.testing.assert_allclose(lengths(closed)[:m], lengths(places)[:m], rtol=1e-9)


@pytest.mark.parametrize("m", [1, 3, 5])
def test_the_end_force_does_the_virtual_work_of_closing(m: int) -> None:
    places = random_places(7)
    rng = np.random.default_rng(8)
    forces, torques = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    force = np.empty(3)
    end_force(places, forces, torques, m, force)
    for axis in np.eye(3):
        e = 1e-5 * (np.cross(axis, places[1] - places[0]) if m == 1 else axis)
        closed = places.copy()
        assert close_chain(closed, m, places[m] + e)
        before, after = np.diff(places, axis=0)[:m], np.diff(closed, axis=0)[:m]
        turns = np.cross(before, after) / np.einsum("ij,ij->i", before, before)[:, None]
        moved = closed[:m] - places[:m]  # the force on a link moves with its joint; the rest is its torque about it
        work = (forces[:m] * moved).sum() + (torques[:m] * turns).sum()
        np.testing.assert_allclose(force @ e, work, rtol=2e-3, atol=1e-9)


def at_random(chain: SerialChain, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q = chain.group.random(np.random.default_rng(seed))
    return q, *chain.places(q)


def places_by_pinocchio(planned: PlanningGroup, chain: SerialChain, q: np.ndarray) -> np.ndarray:
    data = planned.model.createData()
    pin.forwardKinematics(planned.model, data, q)
    joints = [data.oMi[int(joint)] for joint in chain.parent_joints]
    return np.array([*(joint.translation for joint in joints), joints[-1].act(np.array(chain.table.links[-1]))])


@pytest.mark.parametrize("name", CHAINS)
def test_the_configuration_of_places_has_its_joints_there(name: str) -> None:
    planned = group(name)
    chain = link_chain(planned)
    for seed in range(10):
        q, places, rotations = at_random(chain, seed)
        np.testing.assert_allclose(places, places_by_pinocchio(planned, chain, q), atol=1e-12)
        moved = places.copy()
        for k in range(1, chain.n + 1):
            axis = np.random.default_rng([seed, k]).normal(size=3)
            turned = np.empty_like(moved)
            turn_from(moved, k, axis / np.linalg.norm(axis), 0.1, turned)
            moved = turned
        if chain.leads:
            moved += 0.05
        there, turned_rotations = np.empty_like(q), np.empty_like(rotations)
        assert chain_configuration(chain.table, moved, q, rotations, there, turned_rotations)
        np.testing.assert_allclose(places_by_pinocchio(planned, chain, there), moved, atol=1e-9)
        np.testing.assert_allclose(chain.places(there)[1], turned_rotations, atol=1e-9)
        assert np.linalg.norm(pin.difference(planned.model, q, there)) < 12.0


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
