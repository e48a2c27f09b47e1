"""Forward kinematics and motion subspaces against Pinocchio, for every kind of joint."""

import numpy as np
import pinocchio as pin
import pytest

from guidefield.kernels.kinematics.forward_kinematics import joint_placements, motion_subspaces
from guidefield.robot.model.model import joint_table
from tests import robots


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
