"""Torques and speeds along a motion against Pinocchio at dense samples; limits of both are kept."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.errors import MalformedRequest, UnknownFrame
from guidefield.kernels.timing.carried_rates import MotionPolynomials
from guidefield.messages.requests import UrdfText
from guidefield.planner.motion.timing import Limits, PathCurve, parameterize, stretch_spline_to_limits
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.task.effort import (
    EffortLimit,
    holding_torques,
    largest_efforts,
    measure_efforts,
    stated_efforts,
    torques_of,
    tree_of,
)
from guidefield.planner.task.motion_limits import ACCURACY, CartesianLimit, frame_limit, link_limit, polynomials_of
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.kinematics import tangent_accelerations, tangents
from tests.robots import box_arm, group, grouped

SAMPLES = 200  # on each piece
BODIES = (("panda", "panda_hand_tcp", False), ("panda", "panda_hand", True), ("ur5", "forearm_link", True))
KINDS = st.lists(st.sampled_from(["x", "oblique", "continuous", "slide", "mimic", "tilted"]), min_size=1, max_size=4)


def random_motion(planned: PlanningGroup, seed: int, pieces: int = 5, degree: int = 3) -> MotionPolynomials:
    """Pieces of uneven lengths, whose rates jump at knots."""
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.2, 1.0, pieces))])
    places = np.cumsum(rng.normal(0.0, 0.3, (pieces + 1, planned.nv)), axis=0)
    shares = np.linspace(0.0, 1.0, degree + 1)[:, None]
    curves = places[:-1, None] + shares * np.diff(places, axis=0)[:, None]
    curves[:, 1:-1] += rng.normal(0.0, 0.2, (pieces, degree - 1, planned.nv))
    return polynomials_of(curves, times)


def states(motion: MotionPolynomials) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions and their first two derivatives at samples of all pieces, each of shape (n, nv)."""
    times, degree = np.diff(motion.times)[:, None] * np.linspace(1e-9, 1.0 - 1e-9, SAMPLES), motion.powers.shape[1]
    found = []
    for order in range(3):
        factors = np.array([math.perm(power, order) for power in range(degree)])
        exponents = np.maximum(np.arange(degree) - order, 0)
        by_power = factors * times[..., None] ** exponents
        found.append(np.einsum("mtp,mpj->mtj", by_power, motion.powers).reshape(-1, motion.powers.shape[2]))
    return found[0], found[1], found[2]


def dense_rates(planned: PlanningGroup, limit: CartesianLimit, motion: MotionPolynomials) -> np.ndarray:
    """The largest speed and acceleration of the points at samples of all pieces, by Pinocchio."""
    model, data, body = planned.model, planned.model.createData(), limit.body
    joint = model.frames[planned.robot.frame_id(limit.name)].parentJoint
    most = np.zeros(2)
    zs, rates, rises = states(motion)
    velocities, accelerations = tangents(planned, zs, rates), tangent_accelerations(planned, zs, rates, rises)
    for z, dz, ddz in zip(zs, velocities, accelerations, strict=True):
        expand = planned.expand_velocity
        pin.forwardKinematics(model, data, planned.expand_from_local(z), expand @ dz, expand @ ddz)
        v, a = pin.getVelocity(model, data, joint, pin.LOCAL), pin.getAcceleration(model, data, joint, pin.LOCAL)
        w, turn = v.angular, np.linalg.norm(v.angular)
        there = v.linear + np.cross(w, body.points)
        changes = a.linear + np.cross(a.angular, body.points) + np.cross(w, there)
        speeds = np.linalg.norm(there, axis=1) + body.radii * turn
        most = np.maximum(most, [speeds.max(), np.linalg.norm(changes, axis=1).max()])
    return most


@pytest.mark.parametrize(("model", "name", "is_link"), BODIES)
def test_nothing_is_faster_than_the_bound_and_something_nearly_as_fast(model, name, is_link) -> None:
    planned = group(model)
    limit = (link_limit if is_link else frame_limit)(planned, name, 1.0, 1.0)
    motion = random_motion(planned, 4)
    dense = dense_rates(planned, limit, motion)
    for reached, most in zip(limit.measure(motion), dense, strict=True):
        assert reached.found <= reached.bound <= (1.0 + ACCURACY) * reached.found
        assert most <= reached.bound * (1.0 + 1e-9)
        assert reached.found <= most * (1.0 + 1e-3)  # samples of ours may be where those aren't


@settings(max_examples=15)
@given(KINDS, st.integers(0, 2**32 - 1), st.sampled_from([1, 3, 5]))
def test_a_bound_holds_on_chains_of_any_joints(kinds, seed, degree) -> None:
    planned = grouped(box_arm(" ".join(["y", *kinds]), 0))
    limit = link_limit(planned, f"l{len(kinds) + 1}", 1.0, 1.0)
    motion = random_motion(planned, seed, 2, degree)
    dense = dense_rates(planned, limit, motion)
    for reached, most in zip(limit.measure(motion), dense, strict=True):
        assert most <= reached.bound * (1.0 + 1e-9) + 1e-12


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 2.0))
def test_a_timed_motion_keeps_its_limits_in_space_and_reaches_one(seed, speed) -> None:
    planned = group("ur5")
    limit = frame_limit(planned, "tool0", speed, 4.0 * speed)
    limits = Limits(planned.velocity_limits, planned.acceleration_limits, np.full(planned.nv, np.inf), (limit,))
    places = np.cumsum(np.random.default_rng(seed).normal(0.0, 0.3, (6, planned.nv)), axis=0)
    motion = stretch_spline_to_limits(parameterize(PathCurve.along(places), limits), limits)
    fastest, strongest = limit.measure(motion.polynomials)
    rates = np.abs(motion.velocities) / planned.velocity_limits
    assert fastest.bound <= speed * (1.0 + 1e-9)
    assert strongest.bound <= 4.0 * speed * (1.0 + 1e-9)
    ratios = fastest.bound / speed, strongest.bound / (4.0 * speed), rates.max(), _acceleration_share(planned, motion)
    assert max(ratios) > 1.0 - 1e-6


def _acceleration_share(planned: PlanningGroup, motion: Trajectory) -> float:
    return float((np.abs(motion.accelerations) / planned.acceleration_limits).max())


def test_what_has_no_speed_is_refused_by_name() -> None:
    planned = group("ur5")
    with pytest.raises(UnknownFrame, match="no frame 'nose'"):
        frame_limit(planned, "nose", 1.0, 1.0)
    with pytest.raises(UnknownFrame, match="no link 'nose'"):
        link_limit(planned, "nose", 1.0, 1.0)
    with pytest.raises(MalformedRequest, match="'tool0' has no collision geometry"):
        link_limit(planned, "tool0", 1.0, 1.0)


TREES = st.lists(st.sampled_from(["revolute", "continuous", "prismatic"]), min_size=1, max_size=5)
LIMIT = '<limit lower="-2" upper="2" effort="40" velocity="2"/>'


def weighty_chain(kinds: list[str], seed: int) -> PlanningGroup:
    """A chain of links with any masses and inertias, and joints with any axes."""
    return grouped(UrdfText(text=weighty_urdf(kinds, seed)))


def weighty_urdf(kinds: list[str], seed: int) -> str:
    """Its URDF."""
    rng = np.random.default_rng(seed)
    parts = ['<link name="l0"/>']
    for i, kind in enumerate(kinds, 1):
        a, b, c = rng.uniform(0.001, 0.02, 3)  # second moments about the axes of the centre of mass
        moments = f'ixx="{b + c}" iyy="{a + c}" izz="{a + b}" ixy="0" ixz="0" iyz="0"'
        place = [f"{x:.3f}" for x in rng.uniform(-0.2, 0.2, 9)]
        parts.append(
            f'<link name="l{i}"><inertial><origin xyz="{" ".join(place[:3])}" rpy="0.3 {place[3]} 1"/>'
            f'<mass value="{rng.uniform(0.2, 3.0)}"/><inertia {moments}/></inertial></link>'
        )
        limit = LIMIT if kind != "continuous" else ""
        axis = " ".join(f"{x:.3f}" for x in rng.normal(size=3))
        parts.append(
            f'<joint name="j{i}" type="{kind}"><origin xyz="0.1 {place[4]} 0.3" rpy="{" ".join(place[5:8])}"/>'
            f'<parent link="l{i - 1}"/><child link="l{i}"/><axis xyz="{axis}"/>{limit}</joint>'
        )
    return f'<robot name="chain">{"".join(parts)}</robot>'


def dense_torques(planned: PlanningGroup, motion: MotionPolynomials) -> np.ndarray:
    """Torques at samples of all pieces, shape (n, nv), by Pinocchio."""
    model, data, expand = planned.model, planned.model.createData(), planned.expand_velocity
    zs, rates, rises = states(motion)
    both = tangents(planned, zs, rates), tangent_accelerations(planned, zs, rates, rises)
    rows = zip(zs, *both, strict=True)
    found = [pin.rnea(model, data, planned.expand_from_local(z), expand @ v, expand @ a) for z, v, a in rows]
    return np.array(found) @ expand


@pytest.mark.parametrize("name", ["panda", "kinova"])
def test_torques_are_pinocchios_and_nothing_takes_more_than_the_bound(name) -> None:
    planned, motion = group(name), random_motion(group(name), 7)
    tree, limits = tree_of(planned), stated_efforts(planned)
    dense = dense_torques(planned, motion)
    np.testing.assert_allclose(torques_of(tree, *states(motion)), dense, atol=1e-9)
    for reached, most, limit in zip(
        largest_efforts(tree, motion, limits)[0], np.abs(dense).max(axis=0), limits, strict=True
    ):
        assert most <= reached.bound + 1e-9
        assert reached.found <= reached.bound <= reached.found + 0.01 * limit + 1e-12
        assert reached.found <= most * (1.0 + 1e-3)


@settings(max_examples=20)
@given(TREES, st.integers(0, 2**32 - 1), st.sampled_from([3, 5]))
def test_a_bound_holds_on_any_chain(kinds, seed, degree) -> None:
    planned = weighty_chain(kinds, seed)
    tree, motion = tree_of(planned), random_motion(planned, seed, 2, degree)
    dense = dense_torques(planned, motion)
    np.testing.assert_allclose(torques_of(tree, *states(motion)), dense, atol=1e-9, rtol=1e-9)
    bounds = [one.bound for one in largest_efforts(tree, motion, np.full(planned.nv, 40.0))[0]]
    assert (np.abs(dense).max(axis=0) <= np.array(bounds) + 1e-9).all()


@settings(max_examples=5)
@given(TREES, st.integers(0, 2**32 - 1))
def test_torques_are_mujocos(kinds, seed) -> None:
    mujoco = pytest.importorskip("mujoco", reason="the extra `mujoco` isn't installed")
    planned = weighty_chain(kinds, seed)
    tree, rows = tree_of(planned), [row[::50] for row in states(random_motion(planned, seed, 1))]
    model = mujoco.MjModel.from_xml_string(weighty_urdf(kinds, seed))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, found = mujoco.MjData(model), []
    for data.qpos[:], data.qvel[:], data.qacc[:] in zip(*rows, strict=True):
        mujoco.mj_inverse(model, data)
        found.append(data.qfrc_inverse.copy())
    np.testing.assert_allclose(torques_of(tree, *rows), found, rtol=1e-6, atol=1e-6)


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1), st.floats(1.05, 2.0))
def test_a_timed_motion_keeps_its_limits_of_torque(seed, room) -> None:
    planned = group("panda")
    tree = tree_of(planned)
    steps = np.random.default_rng(seed).normal(0.0, 0.2, (6, planned.nv))
    places = planned.robot.rest[: planned.nv] + np.cumsum(steps, axis=0)
    held = np.abs(holding_torques(tree, PathCurve.along(places).at(np.linspace(0.0, 5.0, 400)))).max(axis=0)
    limit = EffortLimit(tree, room * held + 0.5, tuple(planned.velocity_names))
    limits = Limits(planned.velocity_limits, planned.acceleration_limits, np.full(planned.nv, np.inf), (limit,))
    motion = stretch_spline_to_limits(parameterize(PathCurve.along(places), limits), limits).polynomials
    dense = np.abs(dense_torques(planned, motion)).max(axis=0)
    assert (dense <= limit.limits * (1.0 + 1e-9)).all()


def test_work_against_gravity_is_what_the_height_takes() -> None:
    planned = grouped(
        UrdfText(
            text='<robot name="lift"><link name="a"/><link name="b"><inertial><mass value="2"/><inertia ixx="1" iyy="1"'
            ' izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="j" type="prismatic"><parent link="a"/>'
            f'<child link="b"/><axis xyz="0 0 1"/>{LIMIT}</joint></robot>'
        )
    )
    tree = tree_of(planned)
    rising = polynomials_of(np.array([[[0.0], [1.0]]]), np.array([0.0, 10.0]))
    assert largest_efforts(tree, rising, np.full(1, 40.0))[1] == pytest.approx(2.0 * 9.81 * 1.0)


def test_work_is_that_of_dense_samples() -> None:
    planned, motion = group("panda"), random_motion(group("panda"), 7)
    tree = tree_of(planned)
    moments, (_, rates, _) = np.linspace(motion.times[0], motion.times[-1], 4001), states(motion)
    power = np.abs(dense_torques(planned, motion) * rates).sum(axis=1)
    at = np.linspace(motion.times[0], motion.times[-1], len(power))
    dense = float(np.trapezoid(np.interp(moments, at, power), moments))
    assert largest_efforts(tree, motion, stated_efforts(planned))[1] == pytest.approx(dense, rel=0.1)


def test_a_robot_without_inertia_is_told_so() -> None:
    planned = grouped(UrdfText(text=_BARE))
    found = measure_efforts(planned, None, random_motion(planned, 1, 1))
    assert "no link that j move has a mass" in found.reason
    assert not found.uses
    assert math.isinf(stated_efforts(load_group("0"))[0])
    assert stated_efforts(load_group("7"))[0] == 7.0


_BARE = (
    '<robot name="bare"><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/>'
    f'<child link="b"/><axis xyz="0 1 0"/>{LIMIT}</joint></robot>'
)


def load_group(effort: str) -> PlanningGroup:
    return grouped(UrdfText(text=_BARE.replace('effort="40"', f'effort="{effort}"')))
