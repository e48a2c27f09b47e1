"""Lanes for joints of every kind: where Pinocchio has their frames, touching where Coal finds it, from any start."""

from __future__ import annotations

import functools

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings, strategies as st

from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.collision.world import World
from guidefield.kernels.collide.layout import BAND
from guidefield.kernels.kinematics.poses import POSE
from guidefield.messages.requests import UrdfFile, UrdfText
from guidefield.messages.scene import Scene
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.model import RobotModel
from guidefield.robot.urdf.meshes import CATALOG_PACKAGE, catalog_share
from guidefield.scene.scene import build
from tests.collision.lanes.test_lanes import draw, narrowest, zoo
from tests.kernels.collide.lane_callers import placements_of_configurations
from tests.robot.random_chains import chains
from tests.robots import box_arm, load, robot

PLACED = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.9])), np.array([0.1, -0.2, 0.15]))
CHAINS = (
    "slide oblique continuous mimic y",
    "planar y continuous",
    "floating x",
    "x planar floating oblique",
    "continuous floating planar mimic",
    "continuous screw gear half-gear x",
)
"""Every kind of joint that URDF has; ball joints, which it has no word for, are in robots of the catalog."""
BALLS = ("chain_fixed_6x300_r25", "chain_moving_3x260_r20", "chain_planar_3x260_r25")


MESHES = "panda on wheels"
"""Its links are meshes."""


def of(name: str) -> RobotModel:
    if name == MESHES:
        package = catalog_share() / CATALOG_PACKAGE / "robots" / "panda_description"
        urdf, srdf = str(package / "urdf" / "panda.urdf"), str(package / "srdf" / "panda.srdf")
        return load(UrdfFile(urdf, srdf, [str(catalog_share())], "planar"))
    return load(box_arm(name, len(name.split()))) if " " in name else robot(name)


def away(model: RobotModel, seed: int = 3) -> PlanningGroup:
    """All joints of a robot that is placed obliquely, their rotation vectors from a start that is nowhere special."""
    names = [joint.name for joint in model.joints if joint.mimic is None]
    bent = select(model, names, None, model.rest, pin.SE3.Identity()).random(np.random.default_rng(seed))
    q = model.rest.copy()
    for joint in select(model, names, None, q, PLACED).joints:
        whole = model.joint(joint.name)
        q[whole.idx_q : whole.idx_q + whole.nq] = bent[joint.idx_q : joint.idx_q + joint.nq]
    return select(model, names, None, q, PLACED)


@functools.cache
def world_of(name: str) -> tuple[World, BatchCollision]:
    world = World.build(away(of(name)), zoo())
    return world, BatchCollision.build(world)


def long_ones(planned: PlanningGroup, zs: np.ndarray) -> np.ndarray:
    """The same configurations where some rotation vectors go the long way round, and angles are a turn further."""
    long = np.array([planned.unwrapped(z, np.roll(zs, 1, axis=0)[k] * 2.0) for k, z in enumerate(zs)])
    return np.where(planned.winds, 3.0 * long, long)  # whatever is asked of an angle whose turns count


def assert_placed_alike(planned: PlanningGroup, lanes: BatchCollision, zs: np.ndarray) -> None:
    coordinates = np.ascontiguousarray(zs.T, np.float32).ravel()
    coordinates.setflags(write=False)
    model = planned.model
    poses, data, turns = np.zeros(model.njoints * POSE, np.float32), model.createData(), {}
    placements_of_configurations(lanes.tables.joints, coordinates, poses)
    poses = poses.reshape(-1, 3, 4, 16)
    for lane, z in enumerate(zs):
        pin.forwardKinematics(model, data, planned.expand_from_chart(z))
        for joint in range(1, model.njoints):
            placement = data.oMi[joint]
            np.testing.assert_allclose(poses[joint, :, 3, lane], placement.translation, atol=1e-5)
            # frames of joints with one axis are turned so that it is z, those of others stay
            turn = placement.rotation.T @ poses[joint, :, :3, lane]
            expected = turns.setdefault(joint, turn if model.joints[joint].nv == 1 else np.eye(3))
            np.testing.assert_allclose(turn, expected, atol=1e-5)


@pytest.mark.parametrize("name", [*CHAINS, *BALLS, "panda", "ur5", "kinova"])
def test_placements_are_pinocchios(name: str) -> None:
    world, lanes = world_of(name)
    zs = draw(world.group, 16, 1)
    assert_placed_alike(world.group, lanes, zs)
    assert_placed_alike(world.group, lanes, np.zeros_like(zs))
    further = long_ones(world.group, zs)
    assert np.abs(further).max() > np.pi
    assert_placed_alike(world.group, lanes, further)


@settings(deadline=None, max_examples=5)
@given(chains(most=8), st.integers(0, 2**16))
def test_random_robots_are_where_pinocchio_has_them_and_touch_where_coal_says(urdf: UrdfText, seed: int) -> None:
    model = load(urdf)
    assume(any(joint.mimic is None for joint in model.joints))
    planned = away(model, seed)
    world = World.build(planned, build(Scene(name="nothing")))
    lanes, zs = BatchCollision.build(world), draw(planned, 16, seed)
    assert_placed_alike(planned, lanes, zs)
    for z, mine in zip(zs, lanes.touching(zs), strict=True):
        assert mine == world.in_collision(planned.expand_from_chart(z)) or abs(narrowest(world, z)) <= BAND


@pytest.mark.parametrize("name", [*CHAINS[1:], *BALLS, MESHES])
def test_touching_is_what_coal_says(name: str) -> None:
    world, lanes = world_of(name)
    zs = draw(world.group, 600, 2)
    mine = lanes.touching(zs)
    coal = np.array([world.in_collision(world.group.expand_from_chart(z)) for z in zs])
    assert 0 < coal.sum() < len(zs)
    for z in zs[mine != coal]:
        assert abs(narrowest(world, z)) <= BAND
