"""Local coordinates of all joint kinds: inverse, unwrapped, rates as Pinocchio's; and mypy tells the spaces apart."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
from hypothesis import given, settings, strategies as st

from guidefield.messages.requests import UrdfText
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.joints import JointKind, from_local, to_local
from tests.robots import box_arm, load


def planned(seed: int = 0) -> PlanningGroup:
    """A free-flying robot with planar, floating, continuous, prismatic and revolute joints, somewhere."""
    arm = load(UrdfText(text=box_arm("planar continuous floating slide y", 0).text, root_joint="free"))
    q = pin.integrate(arm.model, arm.rest, np.random.default_rng(seed).normal(size=arm.model.nv))
    return select(arm, None, "l5", q, pin.SE3.Identity())


def random_local(seed: int, nv: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=nv)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=18)
def test_local_coordinates_and_configuration_are_inverse(seed: int) -> None:
    group = planned()
    z = random_local(seed, group.nv)
    np.testing.assert_allclose(group.unwrapped(group.to_local(group.from_local(z)), z), z, atol=1e-9)
    q = group.random(np.random.default_rng(seed))
    back = group.from_local(group.to_local(q))
    assert pin.isSameConfiguration(group.space, back, q, 1e-9)


@given(seed=st.integers(0, 10_000), angle=st.sampled_from([0.0, 1e-9, 1e-5, 1e-3, 1.0, np.pi, 4.0, 2.0 * np.pi]))
@settings(max_examples=18)
def test_a_rotation_is_the_one_of_pinocchios_matrices(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    joint = next(j for j in planned().joints if j.kind is JointKind.FLOATING)
    reference, vector = rng.normal(size=7), rng.normal(size=3)
    vector *= angle / np.linalg.norm(vector)
    got = from_local(joint, np.concatenate([reference[:3], vector]), reference)
    begin = pin.Quaternion(reference[-4:]).normalized()
    expected = pin.Quaternion(begin.matrix() @ pin.exp3(vector)).coeffs()
    np.testing.assert_array_equal(got[:3], reference[:3])
    np.testing.assert_allclose(got[3:], expected * np.sign(got[3:] @ expected), atol=1e-12)
    leading = got[6] if abs(got[6]) > 0.5 else max(got[3:6], key=abs)
    assert leading > 0.0
    back = to_local(joint, got, reference)[3:]
    np.testing.assert_allclose(back, pin.log3(pin.exp3(vector)), atol=1e-7 if abs(angle - np.pi) > 1e-3 else 7.0)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=18)
def test_the_tangent_map_is_the_local_velocity_seen_by_pinocchio(seed: int) -> None:
    group = planned()
    z, dz = random_local(seed, group.nv), random_local(seed + 1, group.nv)
    h = 1e-4  # of shorter turns Pinocchio makes none
    tangent = pin.difference(group.space, group.from_local(z - h * dz), group.from_local(z + h * dz)) / (2 * h)
    np.testing.assert_allclose(group.tangent_map(z) @ dz, tangent, atol=1e-6)


@given(seed=st.integers(0, 10_000), short=st.floats(-3.0, -0.5))
@settings(max_examples=18)
def test_a_rotation_vector_is_as_certain_near_half_a_turn_as_elsewhere(seed: int, short: float) -> None:
    """By a matrix's logarithm it was off by up to 6e-11 there, and shares of limits by 8e-8; found by tools/doubt."""
    body, rng = planned(), np.random.default_rng(seed)
    at = next(joint.idx_v for joint in body.joints if joint.kind is JointKind.FLOATING) + 3
    z = random_local(seed, body.nv)
    axis = rng.normal(size=3) * 10.0 ** rng.uniform(-6.0, 0.0, 3)
    z[at : at + 3] = (np.pi - 10.0**short) * axis / np.linalg.norm(axis)
    np.testing.assert_allclose(body.to_local(body.from_local(z))[at : at + 3], z[at : at + 3], rtol=0.0, atol=1e-14)


HOUSE = Path(__file__).resolve().parents[3]

MIXED = """
import numpy as np

from guidefield.prove.certificate import certify, motion_free
from guidefield.collision.clearance import clearance_at
from guidefield.collision.batch.batch_collision import BatchCollision
from guidefield.collision.world import World
from guidefield.planner.motion.timing import PathCurve
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.prove.curve import polyline
from guidefield.planner.path_so_far import PathSoFar
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import Kinematics
from guidefield.robot.model.configuration import configuration_from_wire
from guidefield.robot.model.joints import LocalPoint, LocalPoints, Configuration, ModelConfiguration


def doors(group: PlanningGroup, q: Configuration, z: LocalPoint, zs: LocalPoints, m: ModelConfiguration) -> None:
    group.from_local(group.unwrapped(group.to_local(q), z))
    group.from_local(z + 0.5 * (zs[0] - z))
    group.expand(group.part_of(group.q_reference))
    group.wire_positions(group.local_path([q], z)[0])
    group.to_local(z)  # refused
    group.to_local(z.copy())  # refused
    group.to_local(m)  # refused
    group.to_local(configuration_from_wire(group.robot, {}))  # refused
    group.from_local(q)  # refused
    group.from_local(zs)  # refused
    group.from_local(group.expand_local(z))  # refused
    group.expand(group.expand(q))  # refused
    group.unwrapped(z, q)  # refused
    group.part_of(q)  # refused
    group.wire_positions(q)  # refused


def judges(world: World, many: BatchCollision, group: PlanningGroup, q: Configuration, z: LocalPoint) -> None:
    clearance_at(world, group.expand_from_local(z))
    clearance_at(world, group.expand(q))
    many.touching(np.array([z]))
    clearance_at(world, z)  # refused
    clearance_at(world, group.from_local(z))  # refused
    clearance_at(world, group.expand_local(z))  # refused
    world.in_collision(q)  # refused
    many.touching(z)  # refused
    Kinematics(group).tip_position(z)  # refused
    Kinematics(group).tip_position(q)  # refused


def planned(world: World, q: Configuration, z: LocalPoint, zs: LocalPoints) -> None:
    certify(world, polyline(zs))
    motion_free(world, zs[0], z)
    PathCurve.along(zs).at(np.zeros(1))
    Trajectory(np.zeros(1), zs, Trajectory(np.zeros(1), zs, zs).velocities)  # refused
    PathSoFar(zs).extend(z)  # refused
    PathSoFar(q)  # refused
    certify(world, zs)  # refused
    motion_free(world, q, z)  # refused


def plain(group: PlanningGroup, array: np.ndarray) -> None:
    group.to_local(array)
    group.from_local(array)
"""


def test_a_point_of_another_space_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "mixed_spaces.py"
    file.write_text(MIXED)
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "guidefield" / "mypy"  # as in tools/test
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    command = [sys.executable, "-m", "mypy", "--no-error-summary", "--python-version", version]
    command += ["--cache-dir", str(cache), str(file)]
    told = subprocess.run(command, cwd=HOUSE, capture_output=True, text=True, check=False).stdout
    refused = [int(number) for number in re.findall(rf"{file.name}:(\d+): error: .*\[arg-type\]$", told, re.M)]
    expected = [number for number, line in enumerate(MIXED.splitlines(), 1) if line.endswith("# refused")]
    assert refused == expected, told
