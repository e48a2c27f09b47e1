"""The field on a robot: against point-by-point sums with Pinocchio's Jacobians, finite differences, and its laws."""

import numpy as np
import pinocchio as pin
import pytest

from guidefield.kernels.field.box import capsule_at
from guidefield.kernels.field.field import field_at_points
from guidefield.messages import scene as messages
from guidefield.messages.requests import UrdfText
from guidefield.potential import RobotField
from guidefield.robot.group.reduced_model import select
from guidefield.scene.scene import Scene, build
from guidefield.stores import scenes
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


def test_charged_points_carry_the_area_of_the_collision_shapes() -> None:
    arm = load(box_arm("y", 2, size=0.3))
    field = RobotField(select(arm, None, None, arm.rest, pin.SE3.Identity()), build(scenes.read_packaged("table")))
    side, length = 0.04, 0.27
    assert field.charged.weights.sum() == pytest.approx(3 * (2 * side * side + 4 * side * length), rel=1e-9)
