from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from guidefield.recorder import motion
from tests.recorder.runs import PLACEMENT, made_up

ROBOTS = ("panda", "kinova", "chain_moving_3x260_r20")


@pytest.mark.parametrize("name", ROBOTS)
def test_reads_a_replys_rows_back(name):
    run = made_up(name)
    read = motion.configurations_of(run.group, run.reply.path)
    for q, z in zip(read, run.trajectory.positions, strict=True):
        assert np.allclose(run.group.difference(q, run.group.from_chart(z)), 0.0, atol=1e-9)
    rows = motion.position_rows(run.group, read)
    assert rows.shape == (len(run.reply.path), len(run.reply.position_names))


@pytest.mark.parametrize("name", ROBOTS)
def test_the_tip_is_where_pinocchio_has_it(name):
    run = made_up(name)
    at = motion.poses(run.group, run.profile.configurations)
    whole = run.group.robot.model
    data = whole.createData()
    for row, q in enumerate(run.profile.configurations):
        q_whole = run.group.q_reference.copy()
        for joint in run.group.joints:
            place = run.group.robot.joint(joint.name)
            q_whole[place.idx_q : place.idx_q + place.nq] = q[joint.idx_q : joint.idx_q + joint.nq]
        pin.framesForwardKinematics(whole, data, q_whole)
        tip = PLACEMENT.act(data.oMf[whole.getFrameId(run.group.tip)].translation)
        assert np.allclose(at.tip[row], tip, atol=1e-9)
