"""The field on a robot: against point-by-point sums with Pinocchio's Jacobians, finite differences, and its laws."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from guidefield.kernels.field.box import capsule_at
from guidefield.kernels.field.field import field_at_points
from guidefield.messages import scene as messages
from guidefield.messages.requests import UrdfText
from guidefield.potential import Precision, RobotField
from guidefield.robot.group.reduced_model import select
from guidefield.scene import library
from guidefield.scene.scene import Scene, build
from tests.kernels.parts import from_python
from tests.robots import ARMS, box_arm, group, grouped, load, random_configuration, rest, robot

capsule_field = from_python(capsule_at)

GROUPS = {
    **{name: lambda name=name: group(name) for name in ARMS},
    "oblique": lambda: grouped(box_arm("oblique", 4)),
    "sliding": lambda: grouped(box_arm("y slide x slide", 0)),
    "turning": lambda: grouped(box_arm("continuous", 3)),
    "mimic": lambda: grouped(box_arm("y x mimic y", 0)),
    "oblique continuous": lambda: grouped(box_arm("oblique-continuous", 3)),
    "planar": lambda: grouped(box_arm("planar y slide", 0)),
    "floating": lambda: grouped(box_arm("y floating x", 0)),
    "free base": lambda: grouped(UrdfText(text=box_arm("y x", 0).text, root_joint="free")),
    "ball": lambda: group("chain_moving_3x260_r20"),
}


def far_scene() -> Scene:
    """Obstacles of every kind around the robot, none within its reach."""
    return build(
        messages.Scene(
            name="around",
            obstacles=[
                messages.Box(name="box", size=(0.5, 1.0, 0.2), position=(2.5, 0.4, 0.5)),
                messages.Sphere(name="ball", radius=0.3, position=(-2.0, 1.0, 1.0), charge=2.0),
                messages.Capsule(name="pill", radius=0.1, length=0.5, position=(0.5, -2.4, 0.3)),
                messages.Cylinder(name="can", radius=0.2, length=0.6, position=(1.0, 2.4, 0.2)),
                messages.Polygon(name="wall", vertices=[(-2.2, -2, 0), (-2.2, 2, 0), (-2.2, 0, 2)]),
                messages.HalfSpace(name="floor", normal=(0.0, 0.0, 1.0), offset=-2.5),
            ],
        )
    )


def world_points(field: RobotField, q: np.ndarray) -> tuple[np.ndarray, pin.Data]:
    """World positions of the charged points, by Pinocchio."""
    model, data = field.group.model, field.group.model.createData()
    pin.forwardKinematics(model, data, field.group.expand(q))
    placed = [data.oMi[int(j)].act(p) for j, p in zip(field.charged.point_joints, field.charged.points, strict=True)]
    return np.array(placed), data


@pytest.mark.parametrize("name", GROUPS)
def test_the_generalised_force_is_minus_the_finite_difference_of_the_potential(name: str) -> None:
    planned = GROUPS[name]()
    field = RobotField(planned, far_scene())
    h = 1e-6
    for seed in range(3):
        # outwards: links that slide into each other have no smooth potential
        q = planned.integrate(rest(planned), 0.2 * np.abs(np.random.default_rng(seed).normal(size=planned.nv)))
        differences = [
            (field.potential(planned.integrate(q, h * v)) - field.potential(planned.integrate(q, -h * v))) / (2 * h)
            for v in np.eye(planned.nv)
        ]
        energy = field.evaluate(q)
        np.testing.assert_allclose(energy.gradient, differences, atol=1e-7 * (1.0 + np.abs(energy.gradient).max()))
        np.testing.assert_array_equal(field.generalized_force(q), -energy.gradient)


@pytest.mark.parametrize("name", ["panda", "kinova", "sliding", "mimic", "planar", "floating", "free base", "ball"])
def test_the_backward_pass_equals_a_sum_over_points_with_pinocchios_jacobians(name: str) -> None:
    planned = GROUPS[name]()
    field = RobotField(planned, far_scene())
    q = random_configuration(planned, 7)
    positions, _ = world_points(field, q)
    moving = field.charged.point_joints > 0
    potential, gradient, _, _ = field_at_points(field.tables, positions)
    self_potential, self_force = _self_repulsion_by_points(field, q)
    weights = field.charged.weights * moving
    expected = np.zeros(planned.model.nv)
    model, data = planned.model, planned.model.createData()
    pin.computeJointJacobians(model, data, planned.expand(q))
    for i in np.flatnonzero(moving):
        J = pin.getJointJacobian(model, data, int(field.charged.point_joints[i]), pin.ReferenceFrame.WORLD)
        linear = J[:3] - pin.skew(positions[i]) @ J[3:]
        expected += linear.T @ (weights[i] * gradient[i])
    energy = field.evaluate(q)
    assert energy.potential == pytest.approx(float(weights @ potential) + self_potential, rel=1e-12)
    np.testing.assert_allclose(
        energy.gradient, planned.expand_velocity.T @ (expected - self_force), rtol=1e-9, atol=1e-9
    )


def _self_repulsion_by_points(field: RobotField, q: np.ndarray) -> tuple[float, np.ndarray]:
    """Potential and generalised force of links on links, point by point: a force, and its opposite on the other."""
    planned = field.group
    positions, data = world_points(field, q)
    pin.computeJointJacobians(planned.model, data, planned.expand(q))
    total, force = 0.0, np.zeros(planned.model.nv)
    for first, past, capsule in field.charged.pairs:
        shape, joint = field.charged.capsules[capsule], int(field.charged.capsule_joints[capsule])
        ends = np.r_[data.oMi[joint].act(shape[:3]), data.oMi[joint].act(shape[3:6])]
        for i in range(first, past):
            phi, *gradient = capsule_field(*positions[i], *ends, shape[6])
            total += field.charged.weights[i] * phi
            push = -field.charged.weights[i] * np.array(gradient)
            for sign, which in ((1.0, int(field.charged.point_joints[i])), (-1.0, joint)):
                if which:
                    J = pin.getJointJacobian(planned.model, data, which, pin.ReferenceFrame.WORLD)
                    force += sign * (J[:3] - pin.skew(positions[i]) @ J[3:]).T @ push
    return total, force


@pytest.mark.parametrize("name", [*ARMS, "chain_fixed_6x300_r25"])
def test_runs_are_all_pairs_of_points_and_capsules_once(name: str) -> None:
    charged = RobotField(group(name), far_scene()).charged

    def met(rows: np.ndarray) -> list[tuple[int, int]]:
        return [(point, capsule) for first, past, capsule in rows.tolist() for point in range(first, past)]

    assert sorted(met(charged.runs)) == sorted(met(charged.pairs))
    assert len(set(met(charged.runs))) == len(met(charged.runs))
    assert len(charged.runs) <= len(charged.pairs)


@pytest.mark.parametrize("name", ARMS)
def test_the_metric_is_symmetric_and_positive_semidefinite(name: str) -> None:
    planned = group(name)
    metric = RobotField(planned, far_scene()).evaluate(random_configuration(planned, 3)).metric
    np.testing.assert_array_equal(metric, metric.T)
    assert np.linalg.eigvalsh(metric).min() > -1e-9 * np.trace(metric)


def test_the_metric_is_the_curvature_of_nearby_faces_seen_by_the_joints() -> None:
    planned = grouped(box_arm("oblique", 3))
    field = RobotField(planned, far_scene())
    none = np.empty((0, 3), np.int64)
    none.setflags(write=False)
    field.charged = field.charged._replace(pairs=none, runs=none)
    q = random_configuration(planned, 1)
    positions, data = world_points(field, q)
    pin.computeJointJacobians(planned.model, data, q)
    curvature = field_at_points(field.tables, positions).curvature
    expected = np.zeros((planned.nv, planned.nv))
    for i in np.flatnonzero(field.charged.point_joints):
        J = pin.getJointJacobian(planned.model, data, int(field.charged.point_joints[i]), pin.ReferenceFrame.WORLD)
        linear = J[:3] - pin.skew(positions[i]) @ J[3:]
        expected += field.charged.weights[i] * curvature[i] * linear.T @ linear
    np.testing.assert_allclose(field.evaluate(q).metric, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_without_obstacles_only_the_robots_own_repulsion_is_left_and_forces_cancel() -> None:
    planned = group("panda")
    field = RobotField(planned, build(messages.Scene(name="empty")))
    energy = field.evaluate(random_configuration(planned, 2))
    # every push has its opposite; what acts on the fixed base is the rest
    assert energy.potential > 0.0
    np.testing.assert_allclose(energy.wrenches.sum(axis=0), 0.0, atol=1e-9 * np.abs(energy.wrenches).max())


def test_moving_robot_and_scene_together_changes_nothing() -> None:
    model = robot("ur5")
    placement = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.8])), np.array([0.4, -0.2, 0.6]))
    quaternion = pin.Quaternion(placement.rotation)
    box = messages.Box(name="b", size=(0.4, 0.5, 0.6), position=(1.2, 0.3, 0.4))
    moved = messages.Box(
        name="b",
        size=box.size,
        position=tuple(placement.act(np.array(box.position))),
        quaternion_xyzw=tuple(quaternion.coeffs()),
    )
    here = RobotField(
        select(model, None, None, model.rest, pin.SE3.Identity()), build(messages.Scene(name="s", obstacles=[box]))
    )
    there = RobotField(
        select(model, None, None, model.rest, placement), build(messages.Scene(name="s", obstacles=[moved]))
    )
    q = model.rest
    assert there.potential(q) == pytest.approx(here.potential(q), rel=1e-9)
    np.testing.assert_allclose(there.evaluate(q).gradient, here.evaluate(q).gradient, rtol=1e-7, atol=1e-7)


def test_link_wrenches_are_forces_and_torques_about_the_joints() -> None:
    planned = group("panda")
    field = RobotField(planned, far_scene())
    none = np.empty((0, 3), np.int64)
    none.setflags(write=False)
    field.charged = field.charged._replace(pairs=none, runs=none)
    q = random_configuration(planned, 5)
    positions, data = world_points(field, q)
    gradient = field_at_points(field.tables, positions).gradient
    wrenches = field.link_wrenches(q)
    on_link4 = field.charged.point_joints == 4
    forces = -field.charged.weights[on_link4, None] * gradient[on_link4]
    force, torque = wrenches["panda_link4"]
    np.testing.assert_allclose(force, forces.sum(axis=0), rtol=1e-9)
    arms = positions[on_link4] - data.oMi[4].translation
    np.testing.assert_allclose(torque, np.cross(arms, forces).sum(axis=0), rtol=1e-9, atol=1e-12)


def test_more_charge_is_more_potential_in_proportion() -> None:
    planned = group("xarm7")
    fields = []
    for charge in (1.0, 3.0):
        box = messages.Box(name="b", size=(0.2, 0.2, 0.2), position=(0.9, 0.9, 0.5), charge=charge)
        fields.append(RobotField(planned, build(messages.Scene(name="s", obstacles=[box]))))
    alone = RobotField(planned, build(messages.Scene(name="s"))).potential(rest(planned))
    single, triple = (field.potential(rest(planned)) - alone for field in fields)
    assert triple == pytest.approx(3.0 * single, rel=1e-9)


def test_charged_points_carry_the_area_of_the_collision_shapes() -> None:
    arm = load(box_arm("y", 2, size=0.3))
    field = RobotField(select(arm, None, None, arm.rest, pin.SE3.Identity()), build(library.read("table")))
    side, length = 0.04, 0.27
    assert field.charged.weights.sum() == pytest.approx(3 * (2 * side * side + 4 * side * length), rel=1e-9)


@pytest.mark.parametrize("name", ["panda", "mimic"])
@pytest.mark.parametrize(("precision", "rounding"), [(Precision.DOUBLE, 1e-13), (Precision.SINGLE, 1e-5)])
def test_potentials_of_many_configurations_are_those_of_each(name: str, precision: Precision, rounding: float) -> None:
    planned = GROUPS[name]()
    field = RobotField(planned, far_scene(), precision)
    qs = np.array([random_configuration(planned, seed) for seed in range(5)])
    values = field.potentials(qs)
    assert field.evaluations == len(qs)
    np.testing.assert_array_equal(values, [field.potential(q) for q in qs])
    np.testing.assert_allclose(values, [field.evaluate(q).potential for q in qs], rtol=rounding)


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_single_precision_agrees(name: str) -> None:
    planned = group(name)
    double, single = (RobotField(planned, far_scene(), precision) for precision in (Precision.DOUBLE, Precision.SINGLE))
    q = planned.integrate(rest(planned), 0.2 * np.ones(planned.nv))
    exact, rough = double.evaluate(q), single.evaluate(q)
    assert rough.potential == pytest.approx(exact.potential, rel=1e-4)
    assert single.potential(q) == pytest.approx(rough.potential, rel=1e-5)
    for ours, theirs in (
        (rough.gradient, exact.gradient),
        (rough.metric, exact.metric),
        (rough.wrenches, exact.wrenches),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-3 * np.abs(theirs).max())
    np.testing.assert_array_equal(single.evaluate(q).gradient, rough.gradient)
