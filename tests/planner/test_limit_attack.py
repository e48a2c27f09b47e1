"""A slice of `tools/attack limits`: no motion that is certified exceeds a limit, between its knots either."""

import random

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.engine import Engine
from guidefield.messages import codec
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import configuration_from_wire
from tests.examples import example
from tests.knots import random_knots
from tests.planner.limit_attack import Case, cases, excess, extremes, ranges
from tests.robot.random_chains import chain
from tests.robots import load, robot

ENGINE = Engine()
CHAINS = {6: "mixed", 9: "pose", 40: "jerk", 49: "spheres"}
"""Random robots whose motions were beyond a limit by 2 to 65 mrad, by the seed of each, and the plans that were."""
EXAMPLES = ("seed_a_gates", "seed_e_S_6", "seed_e_L_6_planar", "door", "conveyor")
"""Requests for the guided planner, in time for the last two."""


def judged(case: Case, urdf: str) -> None:
    reply = ENGINE.answer(case.request)
    assert reply.status.name == "SUCCESS", reply.status
    assert reply.certificate.collision_free
    assert excess(reply, case, urdf).none


@pytest.mark.parametrize("seed", CHAINS)
def test_random_robots_keep_their_limits(seed: int) -> None:
    urdf = chain(random.Random(seed), 1 + seed % 12)
    (case,) = cases(urdf, load(urdf), 0, (CHAINS[seed],))
    judged(case, urdf.text)


@pytest.mark.parametrize(
    ("name", "kind"), [("kinova", "spheres"), ("panda", "plane"), ("ur5", "unrelaxed"), ("panda", "moving")]
)
def test_arms_keep_their_limits(name: str, kind: str) -> None:
    (case,) = cases(name, robot(name), 0, (kind,))
    judged(case, robot(name).source.urdf_text)


@pytest.mark.parametrize("title", EXAMPLES)
def test_guided_motions_keep_their_limits(title: str) -> None:
    request = codec.decode_request(example(title))
    model = robot(request.robot) if isinstance(request.robot, str) else load(request.robot)
    q = configuration_from_wire(model, request.start)
    group = select(model, request.group, request.tip, q, pin.SE3.Identity())
    judged(Case("guided", request, group), model.source.urdf_text)


@settings(max_examples=18)
@given(st.integers(0, 2**32 - 1))
def test_extremes_are_those_of_dense_samples(seed: int) -> None:
    motion = Trajectory(*random_knots(seed))
    low, high, speed, acceleration, jerk = extremes(motion.times, motion.positions, motion.velocities)
    times = np.unique(np.linspace(motion.times[:-1], motion.times[1:], 400))
    q, v, a = motion.evaluate(times)
    span = np.diff(motion.times).max() / 399
    for found, sampled, slope in (
        (high, q.max(axis=0), speed),
        (-low, -q.min(axis=0), speed),
        (speed, np.abs(v).max(axis=0), acceleration),
        (acceleration, np.abs(a).max(axis=0), jerk),
    ):
        assert (found >= sampled - 1e-9 * (1.0 + np.abs(sampled))).all()
        assert (found <= sampled + slope * span + 1e-9).all()
    assert jerk.max() == pytest.approx(motion.peak_jerk, rel=1e-6)


def test_ranges_are_read_from_the_urdf_as_it_is_written() -> None:
    limit = '<limit lower="{}" upper="{}" effort="1" velocity="1"/>'
    joints = [
        f'<joint name="a" type="revolute">{limit.format(-1, 2)}</joint>',
        f'<joint name="b" type="prismatic">{limit.format(-3, 4)}<mimic joint="a" multiplier="2" offset="0.5"/></joint>',
        f'<joint name="c" type="revolute">{limit.format(-9, 9)}<mimic joint="b" multiplier="-1"/></joint>',
        '<joint name="d" type="continuous"/>',
        f'<joint name="e" type="revolute">{limit.format(-1, 1)}<mimic joint="d"/></joint>',
        f'<joint name="f" type="revolute">{limit.format(8, 9)}<mimic joint="a"/></joint>',
    ]
    assert ranges(f"<robot>{''.join(joints)}</robot>") == {
        "a": (-1.0, 2.0, 1.0, 0.0, "a"),
        "b": (-3.0, 4.0, 2.0, 0.5, "a"),
        "c": (-9.0, 9.0, -2.0, -0.5, "a"),
        "e": (-1.0, 1.0, 1.0, 0.0, "d"),
    }
