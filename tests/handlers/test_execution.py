"""Motions as controllers execute them: certified, planned, and refused by name."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from guidefield.errors import InvalidConfiguration, MalformedRequest
from guidefield.messages.replies import CertifyReply, PlanReply
from tests.handlers.test_certify import NAMES, certify, motion_of, planned
from tests.handlers.test_plan import READY, ask as plan, joints

GOAL = {"start": READY, "goal": joints(panda_joint1=1.2, panda_joint4=-1.6), "guide_planes": []}


def executed(kind: str, **execution) -> PlanReply:
    return plan(**GOAL, execution={"interpolation": kind, **execution})


def judged(kind: str, **execution) -> CertifyReply:
    return certify(**motion_of(planned()), execution={"interpolation": kind, **execution})


@pytest.mark.parametrize(
    ("kind", "curve"),
    [
        ("linear", "linear"),
        ("cubic", "hermite"),
        ("quintic", "quintic"),
        ("first_order_hold", "linear"),
        ("zero_order_hold", "steps"),
    ],
)
def test_a_plan_certifies_what_a_controller_draws_of_it(kind: str, curve: str) -> None:
    made, given = executed(kind, rate=125.0, tolerance=0.002), judged(kind, rate=125.0, tolerance=0.002)
    assert made.status.name == given.status.name == "SUCCESS"
    assert given.curve == curve
    assert made.certificate.covers == "trajectory as executed"
    assert made.trajectory == planned().trajectory
    rows, planned_rows = made.execution, np.array(made.trajectory.positions)
    assert rows is not None
    assert given.execution is not None
    assert (rows.times, rows.positions, rows.velocities) == (
        given.execution.times,
        given.execution.positions,
        given.execution.velocities,
    )
    assert (rows.positions[0], rows.positions[-1]) == (planned_rows[0].tolist(), planned_rows[-1].tolist())
    assert np.diff(rows.times).min() > 0.0
    assert (rows.velocities is None, rows.accelerations is None) == (
        kind not in ("cubic", "quintic"),
        kind != "quintic",
    )
    assert rows.tolerance == [0.002] * 7
    assert rows.deviation.largest == max(rows.deviation.joints.values())
    assert rows.deviation.joints[rows.deviation.joint] == rows.deviation.largest
    fastest = np.abs(made.trajectory.velocities).max()
    bound = {"cubic": 1e-12, "quintic": 1e-12, "zero_order_hold": 2.0 * fastest / 125}.get(kind, 2e-4)
    assert rows.deviation.largest <= bound * 1.001
    assert rows.end == pytest.approx(rows.times[-1] + (kind == "zero_order_hold") / 125, abs=1e-12)


def test_a_jump_of_the_acceleration_makes_a_quintic_leave_the_plan_less_the_more_rows_there_are() -> None:
    rows = {"times": [0.0, 1.0, 2.0], "positions": [[0.0], [0.2], [0.4]], "velocities": [[0.0], [0.5], [0.0]]}
    motion = {"trajectory": rows, "position_names": NAMES[:1], "start": dict(list(READY.items())[1:])}
    found = [certify(**motion, execution={"interpolation": "quintic", "rate": rate}) for rate in (1.0, 10.0, 100.0)]
    leaves = [one.execution.deviation.largest for one in found]
    assert leaves[0] > 50.0 * leaves[1] > 2500.0 * leaves[2] > 0.0
    told = {**rows, "accelerations": [[0.0], [0.0], [0.0]]}
    other = certify(**{**motion, "trajectory": told}, execution={"interpolation": "quintic"})
    assert other.execution.accelerations == told["accelerations"]
    assert other.execution.deviation.largest > 0.0


def test_a_tolerance_that_is_too_large_is_said_with_the_pair() -> None:
    for reply in (executed("quintic", tolerance=0.5), judged("quintic", tolerance=0.5)):
        assert reply.status.name == "INVALID_MOTION_PLAN"
        assert "where the execution may be" in reply.status.message
        assert reply.certificate.collision_free is False
        pair = reply.status.details["pair"]
        assert " and ".join(pair) in reply.status.message
    assert executed("quintic", tolerance=0.5).execution is None


def test_a_tolerance_may_be_of_some_joints() -> None:
    made = executed("cubic", tolerance={"panda_joint7": 0.01})
    assert made.execution.tolerance == [0.0] * 6 + [0.01]


def test_a_curve_beyond_a_limit_is_refused_with_the_rate() -> None:
    rows = {"times": [0.0, 0.2, 0.4], "positions": [[0.0], [0.1], [0.2]], "velocities": [[0.0], [1.0], [0.0]]}
    rows["accelerations"] = [[0.0], [0.0], [0.0]]
    motion = {"trajectory": rows, "position_names": NAMES[:1], "start": dict(list(READY.items())[1:])}
    reply = certify(**motion, execution={"interpolation": "quintic"}, limits={"panda_joint1": {"acceleration": 2.0}})
    assert reply.status.name == "INVALID_MOTION_PLAN"
    assert "acceleration limit" in reply.status.message


@pytest.mark.parametrize(
    ("request_of", "error", "said"),
    [
        ({"execution": {"interpolation": "zero_order_hold"}}, MalformedRequest, "needs the `rate`"),
        ({"execution": {"interpolation": "cubic", "rate": -1.0}}, MalformedRequest, "rate"),
        ({"execution": {"interpolation": "septic"}}, MalformedRequest, "interpolation"),
        ({"execution": {"interpolation": "cubic", "tolerance": {"elbow": 0.1}}}, InvalidConfiguration, "'elbow'"),
        ({"execution": {"interpolation": "cubic"}, "leave_start_contact": True}, MalformedRequest, "leave_start_cont"),
        ({"execution": {"interpolation": "quintic"}, "proof": True}, MalformedRequest, "proofs and the referee"),
    ],
)
def test_what_is_not_served_is_refused_by_name(request_of: dict, error: type, said: str) -> None:
    for asked in (lambda: plan(**GOAL, **request_of), lambda: certify(**motion_of(planned()), **request_of)):
        with pytest.raises(error, match=said):
            asked()


def test_an_execution_is_of_a_trajectory_with_velocities_and_of_a_goal() -> None:
    execution = {"interpolation": "cubic"}
    positions = {"times": [0.0, 1.0], "positions": [list(READY.values())] * 2}
    with pytest.raises(MalformedRequest, match="needs velocities"):
        certify(trajectory=positions, position_names=NAMES, interpolation="linear", execution=execution)
    with pytest.raises(MalformedRequest, match="has no times"):
        certify(path=[list(READY.values())], position_names=NAMES, execution=execution)
    with pytest.raises(MalformedRequest, match="not for `steps`"):
        plan(start=READY, steps=[{"goal": GOAL["goal"]}], goal=None, execution=execution)


def test_a_reply_exports_what_it_is_certified_for() -> None:
    made, given = executed("quintic", rate=125.0), judged("quintic", rate=125.0)
    for reply in (made, given):
        message = yaml.safe_load(reply.export("yaml"))["trajectory"]
        first, last = message["points"][0], message["points"][-1]
        assert message["joint_names"] == NAMES
        np.testing.assert_allclose(first["positions"], list(READY.values()), atol=1e-9)
        np.testing.assert_allclose(last["positions"], made.trajectory.positions[-1], atol=1e-9)
    with pytest.raises(MalformedRequest, match="not certified for a controller"):
        planned().export("yaml")
    with pytest.raises(MalformedRequest, match="is not certified: where the execution may be"):
        judged("quintic", tolerance=0.5).export("csv")


def test_a_refusal_of_what_is_drawn_leads_to_where_the_plan_is_then() -> None:
    """What is drawn has more pieces than the plan: two fingers between books that no tolerance fits between."""
    columns = [f"panda_joint{k + 1}" for k in range(7)]
    start = (2.4477525, -0.4822559, 2.507003, -1.9026313, -0.5294257, 2.7783542, 0.7581467)
    goal = (-0.7317239, -0.2503417, 1.2483969, -2.0950782, 1.6822434, 3.0635226, -0.8047687)
    reply = plan(
        scene="bookshelf",
        guide_planes=[],
        goal=joints(**dict(zip(columns, goal, strict=True))),
        start=dict(zip(columns, start, strict=True)),
        execution={"interpolation": "linear", "rate": 125, "tolerance": 0.005},
        seed=85,
    )
    assert isinstance(reply, PlanReply)
    assert reply.status.name == "INVALID_MOTION_PLAN"
    assert "tolerance" in reply.status.message
    assert reply.status.details["pair"] == ["panda_leftfinger", "book4"]


@pytest.mark.filterwarnings("error")
def test_a_motion_that_goes_nowhere_is_refused_where_it_is() -> None:
    made = plan(
        start=READY, goal=joints(**READY), guide_planes=[], execution={"interpolation": "cubic", "tolerance": 1.0}
    )
    assert made.status.name == "INVALID_MOTION_PLAN"
    assert "where the execution may be" in made.status.message
