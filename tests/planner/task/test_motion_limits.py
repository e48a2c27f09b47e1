"""How fast points are along a motion, against Pinocchio at dense samples; limits are kept, and no more than that."""

import math

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.errors import MalformedRequest, UnknownFrame
from guidefield.kernels.timing.carried_rates import MotionPolynomials
from guidefield.planner.motion.timing import Limits, PathCurve, parameterize, stretch_spline_to_limits
from guidefield.planner.motion.trajectory import Trajectory
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
    carrier = model.frames[planned.robot.frame_id(limit.name)].parentJoint
    most = np.zeros(2)
    zs, rates, rises = states(motion)
    velocities, accelerations = tangents(planned, zs, rates), tangent_accelerations(planned, zs, rates, rises)
    for z, dz, ddz in zip(zs, velocities, accelerations, strict=True):
        expand = planned.expand_velocity
        pin.forwardKinematics(model, data, planned.expand_from_chart(z), expand @ dz, expand @ ddz)
        v, a = pin.getVelocity(model, data, carrier, pin.LOCAL), pin.getAcceleration(model, data, carrier, pin.LOCAL)
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
