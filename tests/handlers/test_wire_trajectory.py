"""A motion on the wire is the motion that was certified, however far it turns between its knots."""

import numpy as np
from hypothesis import given, strategies as st

from guidefield.handlers.plan_reply import wire_trajectory
from guidefield.planner.motion.trajectory import Trajectory
from tests.robots import box_arm, grouped


@given(st.integers(0, 2**32 - 1))
def test_the_knots_of_a_motion_say_which_way_a_body_turns(seed: int) -> None:
    """Found by tools/doubt: a body that turned by 5 rad between two knots was read as turning the other way."""
    rng = np.random.default_rng(seed)
    body = grouped(box_arm("floating x", 2))
    zs = rng.normal(size=(3, body.nv))
    zs[:, 3:6] *= rng.uniform(0.0, 6.0, (3, 1)) / np.linalg.norm(zs[:, 3:6], axis=1, keepdims=True)
    zs[0, 3:6] *= 0.5  # whoever reads the first row takes the shorter way to it
    motion = Trajectory(np.array([0.0, 1.0, 2.5]), zs, rng.normal(size=zs.shape))
    sent = wire_trajectory(motion, None, body)
    assert set(motion.times) <= set(sent.times)
    read = [zs[0]]
    for row in sent.positions[1:]:
        read.append(body.unwrapped(body.chart(np.array(row)), read[-1]))
    there = motion.evaluate(np.array(sent.times))[0]
    assert np.abs(np.array(read) - there).max() < 1e-6
    rates = [np.linalg.solve(body.tangent_map(z), row) for z, row in zip(read, sent.velocities, strict=True)]
    again = Trajectory(np.array(sent.times), np.array(read), np.array(rates))
    times = np.linspace(0.0, 2.5, 200)
    assert np.abs(again.evaluate(times)[0] - motion.evaluate(times)[0]).max() < 1e-5
