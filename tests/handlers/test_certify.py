"""The certify request: our own plans pass with the same figures; what is wrong with a motion is told with its place."""

from __future__ import annotations

import functools
import time

import numpy as np
import pytest

from guidefield.errors import InvalidConfiguration, MalformedRequest
from guidefield.handlers.certify import answer_certify
from guidefield.messages import codec
from guidefield.messages.replies import CertifyReply, PlanReply, as_plain_data
from guidefield.scene import library
from guidefield.scene.scene import build
from tests.handlers.test_plan import READY, ask as plan, joints
from tests.robots import robot

NAMES = [f"panda_joint{i}" for i in range(1, 8)]
HOME = list(READY.values())


def certify(scene: str | dict = "table", model: str = "panda", **request) -> CertifyReply:
    message = codec.decode_request(
        {"type": "certify", "robot": model, "scene": scene, "allowed_time": 60.0, "recording": "off", **request}
    )
    built = build(library.read(scene) if isinstance(scene, str) else message.scene)
    return answer_certify(message, robot(model), built, run_id="run", received=time.monotonic())


def motion_of(reply: PlanReply) -> dict:
    assert reply.trajectory is not None
    return {"trajectory": as_plain_data(reply.trajectory), "position_names": reply.position_names}


@functools.cache
def planned() -> PlanReply:
    return plan(start=READY, goal=joints(panda_joint1=1.2, panda_joint4=-1.6), guide_planes=[])


def test_our_own_plan_is_certified_with_the_same_figures() -> None:
    made = planned()
    reply = certify(**motion_of(made))
    assert reply.status.name == "SUCCESS"
    assert reply.curve == "hermite"
    assert reply.certificate.collision_free
    assert reply.certificate.free_until.time == made.trajectory.times[-1]
    assert reply.certificate.free_until.row == len(made.trajectory.times) - 1
    assert reply.clearance.minimum == made.clearance.minimum
    assert reply.clearance.time == made.clearance.time
    assert reply.clearance.pair == made.clearance.pair
    assert reply.self_clearance == made.self_clearance
    assert max(reply.limits.velocity.share, reply.limits.acceleration.share) == pytest.approx(1.0, abs=0.01)
    assert reply.limits.jerk.share is None
    assert codec.encode(reply)


def test_a_path_has_no_times() -> None:
    reply = certify(path=planned().path, position_names=planned().position_names)
    assert reply.status.name == "SUCCESS"
    assert reply.curve == "linear"
    assert reply.clearance.time is None
    assert reply.certificate.free_until.time is None
    assert reply.limits.velocity.share is None


def test_a_motion_into_an_obstacle_is_refused_with_its_place() -> None:
    down = [*HOME[:1], 0.9, *HOME[2:3], -1.2, *HOME[4:]]
    reply = certify(path=[HOME, down], position_names=NAMES)
    assert reply.status.name == "INVALID_MOTION_PLAN"
    certificate = reply.certificate
    assert certificate.reason == "contact"
    assert not certificate.collision_free
    assert 0.0 < certificate.free_until.row <= certificate.place.row < 1.0
    assert set(certificate.place.configuration) == set(NAMES)
    assert reply.clearance.minimum <= 0.0


def test_columns_may_stand_in_any_order_and_be_left_out() -> None:
    made = planned()
    whole = certify(path=made.path, position_names=made.position_names)
    order = [4, 2, 0, 6, 1, 5, 3]
    turned = certify(path=np.array(made.path)[:, order].tolist(), position_names=[NAMES[k] for k in order])
    assert turned.clearance == whole.clearance
    still = certify(path=[[0.0], [0.4]], position_names=["panda_joint1"], start=READY)
    assert still.status.name == "SUCCESS"
    assert still.position_names == ["panda_joint1"]


def test_what_is_ill_posed_is_refused_by_name() -> None:
    with pytest.raises(InvalidConfiguration, match="panda_joint9"):
        certify(path=[[0.0]], position_names=["panda_joint9"])
    with pytest.raises(InvalidConfiguration, match="2 times"):
        certify(path=[[0.0, 0.0]], position_names=["panda_joint1", "panda_joint1"])
    with pytest.raises(InvalidConfiguration, match="7 columns"):
        certify(path=[[0.0]])
    with pytest.raises(MalformedRequest, match=r"times\[1\]"):
        certify(trajectory={"positions": [[0.0], [0.1]], "times": [1.0, 0.5]}, position_names=["panda_joint1"])
    with pytest.raises(MalformedRequest, match="either a `path` or a `trajectory`"):
        certify()
