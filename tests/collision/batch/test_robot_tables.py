"""A robot as tables for SIMD batches: joints of every kind, pieces of bodies, and pairs that never touch."""

import dataclasses
import functools

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings, strategies as st

from guidefield.collision.batch.batch_collision import BatchCollision, prune_pairs
from guidefield.collision.batch.robot_tables import batch_robot
from guidefield.collision.clearance import clearance_at
from guidefield.collision.world import World
from guidefield.kernels.collide.layout import BAND, BatchBodies
from guidefield.kernels.kinematics.poses import POSE
from guidefield.kernels.simd.packing import pack
from guidefield.messages import scene as messages
from guidefield.messages.requests import UrdfFile, UrdfText
from guidefield.messages.scene import Scene
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.model import RobotModel
from guidefield.robot.urdf.meshes import CATALOG_PACKAGE, catalog_share
from guidefield.scene.scene import build
from tests.collision.batch.test_batch_collision import draw, narrowest, zoo
from tests.collision.batch.test_cell_grids import distance
from tests.kernels.collide.batch_callers import placements_of_configurations
from tests.robot.random_chains import chains
from tests.robots import box_arm, group, grouped, load, robot

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


MESHES = "panda on wheels"  # its links are meshes


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


def assert_placed_alike(planned: PlanningGroup, batch: BatchCollision, zs: np.ndarray) -> None:
    coordinates = np.ascontiguousarray(zs.T, np.float32).ravel()
    coordinates.setflags(write=False)
    model = planned.model
    poses, data, turns = np.zeros(model.njoints * POSE, np.float32), model.createData(), {}
    placements_of_configurations(batch.tables.joints, coordinates, poses)
    poses = poses.reshape(-1, 3, 4, 16)
    for lane, z in enumerate(zs):
        pin.forwardKinematics(model, data, planned.expand_from_local(z))
        for joint in range(1, model.njoints):
            placement = data.oMi[joint]
            np.testing.assert_allclose(poses[joint, :, 3, lane], placement.translation, atol=1e-5)
            # frames of joints with one axis are turned so that it is z, those of others stay
            turn = placement.rotation.T @ poses[joint, :, :3, lane]
            expected = turns.setdefault(joint, turn if model.joints[joint].nv == 1 else np.eye(3))
            np.testing.assert_allclose(turn, expected, atol=1e-5)


@pytest.mark.parametrize("name", [*CHAINS, *BALLS, "panda", "ur5", "kinova"])
def test_placements_are_pinocchios(name: str) -> None:
    world, batch = world_of(name)
    zs = draw(world.group, 16, 1)
    assert_placed_alike(world.group, batch, zs)
    assert_placed_alike(world.group, batch, np.zeros_like(zs))
    further = long_ones(world.group, zs)
    assert np.abs(further).max() > np.pi
    assert_placed_alike(world.group, batch, further)


@settings(max_examples=5)
@given(chains(most=8), st.integers(0, 2**16))
def test_random_robots_are_where_pinocchio_has_them_and_touch_where_coal_says(urdf: UrdfText, seed: int) -> None:
    model = load(urdf)
    assume(any(joint.mimic is None for joint in model.joints))
    planned = away(model, seed)
    world = World.build(planned, build(Scene(name="nothing")))
    batch, zs = BatchCollision.build(world), draw(planned, 16, seed)
    assert_placed_alike(planned, batch, zs)
    for z, mine in zip(zs, batch.touching(zs), strict=True):
        assert mine == world.in_collision(planned.expand_from_local(z)) or abs(narrowest(world, z)) <= BAND


@pytest.mark.parametrize("name", [*CHAINS[1:], *BALLS, MESHES])
def test_touching_is_what_coal_says(name: str) -> None:
    world, batch = world_of(name)
    zs = draw(world.group, 600, 2)
    mine = batch.touching(zs)
    coal = np.array([world.in_collision(world.group.expand_from_local(z)) for z in zs])
    assert 0 < coal.sum() < len(zs)
    for z in zs[mine != coal]:
        assert abs(narrowest(world, z)) <= BAND


def obstacle(kind: str, centre: np.ndarray, rng: np.random.Generator) -> messages.Box | messages.Cylinder:
    """A thin one through a point."""
    placed = {
        "name": "thin",
        "position": tuple(centre),
        "quaternion_xyzw": tuple(pin.Quaternion(rng.normal(size=4)).normalized().coeffs()),
    }
    if kind == "cylinder":
        return messages.Cylinder(radius=0.004, length=0.3, **placed)
    if kind == "capsule":
        return messages.Capsule(radius=0.003, length=0.2, **placed)
    return messages.Box(size=(0.005, 0.01, 0.25) if kind == "rod" else (0.1, 0.15, 0.004), **placed)


def without_inner_balls(batch: BatchCollision) -> BatchCollision:
    """The same robot, but not kept from itself, and nothing known of its inside."""
    bodies = batch.tables.bodies
    tables = batch.tables._replace(bodies=bodies._replace(inners=np.zeros_like(bodies.inners), n_link_pairs=0))
    return dataclasses.replace(batch, words=pack(tables))


@pytest.mark.parametrize("kind", ["rod", "plate", "cylinder", "capsule"])
def test_thin_obstacles_near_the_middles_of_pieces(kind: str) -> None:
    planned, rng = group("ur5"), np.random.default_rng(5)
    batch = BatchCollision.build(World.build(planned, build(messages.Scene(name="empty", obstacles=[]))))
    bodies, joints = batch.tables.bodies, batch.tables.joints
    verdicts = []
    for _ in range(60):
        z = planned.to_local(planned.random(rng))
        poses = np.zeros(joints.size * POSE, np.float32)
        placements_of_configurations(joints, np.repeat(z.astype(np.float32), 16), poses)
        body = int(rng.integers(2, bodies.size))
        piece = int(rng.integers(bodies.pieces[body], bodies.pieces[body + 1]))
        pose = poses.reshape(-1, 3, 4, 16)[bodies.joints[body], :, :, 0]
        middle = pose[:, :3] @ bodies.piece_bounds[4 * piece : 4 * piece + 3] + pose[:, 3]
        centre = middle + rng.choice([0.0, 0.03, 0.06]) * rng.normal(size=3)
        world = World.build(planned, build(messages.Scene(name="thin", obstacles=[obstacle(kind, centre, rng)])))
        distance = clearance_at(world, planned.expand_from_local(z)).obstacle_distance
        if not 0.0 < distance <= BAND:  # where bodies touch, it is 0 however deep
            verdicts.append(distance <= 0.0)
            kept = without_inner_balls(BatchCollision.build(world))
            assert bool(kept.touching(z[None])[0]) == (distance <= 0.0)
    assert 10 < sum(verdicts) < len(verdicts) - 5


TWO_BALLS = """<robot name="balls"><link name="base"/>
<link name="near"><collision><origin xyz="0.1 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="far"><collision><origin xyz="{x} 0 0"/><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="j1" type="continuous"><parent link="base"/><child link="near"/><axis xyz="0 0 1"/></joint>
<joint name="j2" type="continuous"><parent link="base"/><child link="far"/><axis xyz="0 0 1"/></joint></robot>"""
"""Two balls that turn about one axis, at distances 0.1 and x from it: they meet if x < 0.3."""


def checked_pairs(bodies: BatchBodies) -> set[tuple[int, int]]:
    """Pairs of bodies that are asked whether they touch."""
    pairs = bodies.pairs.reshape(-1, 3)
    rows = [pairs[first:last, :2] for first, last in bodies.link_pairs.reshape(-1, 4)[:, 2:].tolist()]
    return {(a, b) for a, b in np.concatenate([np.empty((0, 2), np.int64), *rows]).tolist()}


def left_out(planned: PlanningGroup) -> tuple[World, set[tuple[int, int]], set[tuple[int, int]]]:
    """The robot among nothing, its pairs, and those of them that are left out."""
    world = World.build(planned, build(messages.Scene(name="nothing")))
    robot = batch_robot(planned, world.pairs.own)
    left = checked_pairs(prune_pairs(robot, planned.nv).bodies)
    every = checked_pairs(robot.bodies)
    assert left <= every
    return world, every, every - left


@pytest.mark.parametrize("robot", ["ur5", "panda", "boxes"])
def test_what_is_left_out_keeps_apart(robot: str) -> None:
    planned = grouped(box_arm("x slide oblique continuous mimic y", 6)) if robot == "boxes" else group(robot)
    world, every, out = left_out(planned)
    rng, nearest = np.random.default_rng(5), dict.fromkeys(every, np.inf)
    for _ in range(100):
        z = planned.to_local(planned.random(rng))
        for pair in every:
            nearest[pair] = min(nearest[pair], distance(world, z, *pair))
    assert all(nearest[pair] > 0.0 for pair in out)
    assert min(nearest.values()) <= 0.0, "some pairs touch, and are kept"


@pytest.mark.parametrize(("x", "touch"), [(0.295, True), (0.3009, True), (0.303, False), (0.5, False)])
def test_what_comes_within_a_millimetre_is_kept(x: float, touch: bool) -> None:
    _, every, out = left_out(grouped(UrdfText(text=TWO_BALLS.format(x=x))))
    assert len(every) == 1
    assert out == (set() if touch else every)
