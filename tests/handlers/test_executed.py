"""What a robot executed, judged against its plan: deviations, what a recording shows, and joint states that are odd."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import guidefield
from guidefield.errors import InvalidConfiguration, MalformedRequest, UnknownObject
from guidefield.messages.certify_reply import JointStates, judgement_of
from guidefield.messages.requests import JointLimits, PlanRequest, PlanStep
from guidefield.recorder.stored import read_recording
from tests.handlers.test_certify import NAMES, certify, planned
from tests.handlers.test_plan import READY
from tests.recorder.runs import Recording

REQUEST = PlanRequest("panda", "table", guidefield.JointsGoal({"panda_joint1": 1.2, "panda_joint4": -1.6}), start=READY)


def states(late: float = 0.01, step: float = 0.004, begin: float = 0.0) -> JointStates:
    """Those of a robot that is late, and tells another joint too, the last first."""
    plan = planned().trajectory
    curve = CubicHermiteSpline(plan.times, plan.positions, plan.velocities)
    times = np.arange(0.0, plan.times[-1] + 0.1, step)
    rows = curve(np.clip(times - late, 0.0, plan.times[-1]))
    table = np.column_stack([np.full(len(times), 0.02), rows[:, ::-1]])
    return JointStates(["finger", *NAMES[::-1]], (begin + times).tolist(), table.tolist())


def test_an_executed_motion_is_off_its_plan_by_its_delay() -> None:
    reply = guidefield.answer(judgement_of(REQUEST, planned(), states(begin=7.5), 7.5))
    assert reply.certificate.collision_free
    assert reply.curve == "linear"
    assert reply.execution is None
    fastest = np.abs(planned().trajectory.velocities).max(axis=0)
    assert reply.deviation.largest == pytest.approx(0.01 * fastest.max(), rel=0.05)
    for name, speed in zip(NAMES, fastest, strict=True):
        assert reply.deviation.joints[name] <= 0.01 * speed * 1.02 + 1e-6
    assert reply.deviation.joint == NAMES[int(fastest.argmax())]
    still = guidefield.answer(judgement_of(REQUEST, planned(), states(late=0.0)))
    assert still.deviation.largest < 1e-4


def test_a_recording_lays_the_plan_over_it(tmp_path: Path) -> None:
    guidefield.answer(judgement_of(REQUEST, planned(), states()), record_to=tmp_path / "run.rrd")
    recording, found = Recording(tmp_path / "run.rrd"), read_recording(tmp_path / "run.rrd").reply.deviation
    assert {"/path/to_follow", "/path/tip", "/plots/clearance", "/plots/deviation"} <= recording.entities
    plotted = np.abs(recording.values("/plots/deviation", "Scalars:scalars", "path_time"))
    assert 0.9 * found.largest < plotted.max() <= found.largest * (1.0 + 1e-9)
    (summary,) = recording.one("/documents/summary", "TextDocument:text")
    assert f"{found.largest:.3g} rad or m at most, {found.joint}" in summary


def test_whole_turns_of_a_continuous_joint_are_no_deviation() -> None:
    rows = {"times": [0.0, 1.0], "positions": [[0.1], [0.2]]}
    turned = {"times": [0.0, 1.0], "positions": [[0.1 + 2.0 * np.pi], [0.2 + 2.0 * np.pi]]}
    robot = {"type": "urdf", "text": CONTINUOUS}
    reply = guidefield.answer(
        {
            "type": "certify",
            "robot": robot,
            "scene": {"name": "empty"},
            "position_names": ["turn"],
            "trajectory": turned,
            "planned": rows,
            "interpolation": "linear",
        }
    )
    assert reply.deviation.largest < 1e-12


CONTINUOUS = """<robot name="wheel"><link name="base"/>
<link name="arm"><collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>
<joint name="turn" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint></robot>"""


@pytest.mark.parametrize(
    ("told", "begin", "error", "said"),
    [
        (
            states()._replace(joints=["finger", *NAMES[:0:-1], "elbow"]),
            0.0,
            MalformedRequest,
            "no joint 'panda_joint1'",
        ),
        (states()._replace(joints=[NAMES[1], *NAMES[1:]]), 0.0, MalformedRequest, "no joint 'panda_joint1'"),
        (JointStates([*NAMES, NAMES[0]], [0.0], [[0.0] * 8]), 0.0, MalformedRequest, "'panda_joint1' more than once"),
        (states()._replace(times=states().times[::-1]), 0.0, MalformedRequest, "in the wrong order: state 1"),
        (states(), 99.0, MalformedRequest, "no joint state is of 99 s or later: the last one is of"),
        (JointStates(NAMES, [], []), 0.0, MalformedRequest, "there are none"),
        (JointStates(NAMES, [0.0, np.nan], [[0.0] * 7] * 2), 0.0, MalformedRequest, "state 1 is of nan s, which is no"),
        (JointStates(NAMES, [0.0], [[0.0, np.nan, *[0.0] * 5]]), 0.0, MalformedRequest, "'panda_joint2' at nan"),
        (JointStates(NAMES, [0.0], [[0.0] * 6]), 0.0, MalformedRequest, "state 0 has 6 values for 7 joints"),
        (JointStates(NAMES, [0.0, 1.0], [[0.0] * 7]), 0.0, MalformedRequest, "have 2 times and 1 rows"),
        (JointStates(NAMES, [0.0, 1e300], [[0.0] * 7] * 2), 0.0, MalformedRequest, "`times.1.` must be within"),
    ],
)
def test_odd_joint_states_are_refused_by_name(told: JointStates, begin: float, error: type, said: str) -> None:
    with pytest.raises(error, match=said):
        judgement_of(REQUEST, planned(), told, begin)


def test_a_plan_without_a_motion_or_that_picks_up_is_not_judged() -> None:
    with pytest.raises(UnknownObject, match="has no motion"):
        judgement_of(REQUEST, msgspec.structs.replace(planned(), trajectory=None), states())
    moving = msgspec.structs.replace(REQUEST, goal=None, steps=[PlanStep(goal=REQUEST.goal)])
    assert judgement_of(moving, planned(), states()) == judgement_of(REQUEST, planned(), states())
    picking = msgspec.structs.replace(moving, steps=[PlanStep(goal=REQUEST.goal, detach="crate")])
    with pytest.raises(MalformedRequest, match="carries the same things all along"):
        judgement_of(picking, planned(), states())


def test_torques_that_bind_a_plan_are_not_asked_of_joint_states() -> None:
    bound = msgspec.structs.replace(REQUEST, limits={states().joints[0]: JointLimits(effort=50.0, velocity=1.0)})
    asked = judgement_of(bound, planned(), states()).limits[states().joints[0]]
    assert (asked.effort, asked.velocity) == (None, 1.0)


def test_what_is_planned_has_times_and_the_same_columns() -> None:
    rows = {"times": [0.0, 1.0], "positions": [list(READY.values())] * 2}
    motion = {"trajectory": rows, "position_names": NAMES}
    with pytest.raises(MalformedRequest, match="must have `times`"):
        certify(**motion, planned={"positions": rows["positions"]})
    with pytest.raises(MalformedRequest, match="`planned` or `execution`"):
        certify(**motion, planned=rows, execution={"interpolation": "linear"})
    with pytest.raises(InvalidConfiguration, match=r"planned\.positions"):
        certify(**motion, planned={"times": [0.0], "positions": [[0.0]]})
    with pytest.raises(MalformedRequest, match="`planned` is for a `trajectory`"):
        certify(path=rows["positions"], position_names=NAMES, planned=rows)
