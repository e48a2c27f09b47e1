"""The certify request: our own plans pass with the same figures; what is wrong with a motion is told with its place."""

import dataclasses
import functools
import itertools
import time
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import guidefield
from guidefield.cli.certifying import make_recorded_fields
from guidefield.collision.clearance import clearance_at
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.errors import InvalidConfiguration, MalformedRequest, Status
from guidefield.handlers.certify import answer_certify
from guidefield.handlers.certify_problem import certify_problem
from guidefield.handlers.plan import answer_plan
from guidefield.messages import codec, requests, scene as messages
from guidefield.messages.codec import read_request
from guidefield.messages.replies import CertifyReply, PlanReply, to_plain_data
from guidefield.planner.judgement import GivenProblem, Judgement, judge
from guidefield.planner.motion.limit_load import LimitUses
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.scene.scene import build
from guidefield.stores import scenes
from tests.collision.plain import are_mixed
from tests.examples import example
from tests.handlers.test_plan import PATIENT, READY, ask as plan, joints
from tests.planner.problems import closed_shell
from tests.robots import robot

NAMES = [f"panda_joint{i}" for i in range(1, 8)]
HOME = list(READY.values())
TURN = [0.4, *HOME[1:]]
LATE = {"allowed_time": 60.0, "recording": "off"}


def certify(scene: str | dict = "table", model: str = "panda", **request) -> CertifyReply:
    message = codec.decode_request(
        {"type": "certify", "robot": model, "scene": scene, "allowed_time": 60.0, "recording": "off", **request}
    )
    built = build(scenes.read_packaged(scene) if isinstance(scene, str) else message.scene)
    return answer_certify(message, robot(model), built, run_id="run", received=time.monotonic())


def motion_of(reply: PlanReply) -> dict:
    assert reply.trajectory is not None
    return {"trajectory": to_plain_data(reply.trajectory), "position_names": reply.position_names}


@functools.cache
def planned(**request: Any) -> PlanReply:
    return plan(start=READY, goal=joints(panda_joint1=1.2, panda_joint4=-1.6), guide_planes=[], **request)


def test_columns_may_be_left_out() -> None:
    still = certify(path=[[0.0], [0.4]], position_names=["panda_joint1"], start=READY)
    assert still.status.name == "SUCCESS"
    assert still.position_names == ["panda_joint1"]


def test_what_is_ill_posed_is_refused_by_name() -> None:
    with pytest.raises(InvalidConfiguration, match="7 columns"):
        certify(path=[[0.0]])
    with pytest.raises(MalformedRequest, match=r"times\[1\]"):
        certify(trajectory={"positions": [[0.0], [0.1]], "times": [1.0, 0.5]}, position_names=["panda_joint1"])
    with pytest.raises(MalformedRequest, match="either a `path` or a `trajectory`"):
        certify()


# ---- our own plans


TURNED = {**READY, "panda_joint1": 1.1}
POST = {"type": "box", "name": "post", "size": [0.06, 0.06, 0.5], "position": [0.42, 0.27, 0.25]}
ROD = {
    "obstacle": {"type": "box", "name": "rod", "size": [0.02, 0.02, 0.25]},
    "link": "panda_hand",
    "placement": {"position": [0, 0, 0.22]},
    "touch_links": ["panda_leftfinger", "panda_rightfinger"],
}
LEVEL = {
    "type": "orientation_cone", "frame": "panda_hand", "axis": [0, 0, 1], "target_axis": [0, 0, -1], "half_angle": 0.2
}  # fmt: skip
PLANS = {
    "a configuration with a clearance": {"goal": joints(panda_joint1=0.7, panda_joint4=-1.9), "min_clearance": 0.02},
    "any of several": {"goal": {"type": "joint_set", "positions": [{"panda_joint1": 1.0}, {"panda_joint1": -1.0}]}},
    "a pose": {
        "goal": {"type": "pose", "position": [0.4, 0.3, 0.5], "quaternion_xyzw": [1, 0, 0, 0]}, "scene": "table"
    },
    "guide planes": {"goal": {"type": "guide_plane"}, "scene": "bookshelf", "start": {}},
    "a held object": {"goal": joints(panda_joint1=0.5), "attached_objects": [ROD]},
    "a jerk limit": {"goal": joints(panda_joint1=0.5), "limits": {name: {"jerk": 50.0} for name in NAMES}},
    "slower": {"goal": joints(panda_joint1=0.5), "max_velocity_scaling_factor": 0.3},
    "a path constraint": {
        "goal": {"type": "joints", "positions": TURNED}, "scene": {"name": "s", "obstacles": [POST]},
        "path_constraints": [LEVEL], "guide_planes": [],
    },
}  # fmt: skip


def asked_and_planned(robot_: str = "panda", **fields) -> tuple[requests.PlanRequest, PlanReply]:
    request = codec.decode_request({"robot": robot_, "scene": "table", "start": READY, **PATIENT, **fields})
    reply = answer_plan(request, robot(robot_), scene_of(request), run_id="r", received=time.monotonic())
    assert reply.status.name == "SUCCESS", reply.status.message
    return request, reply


def scene_of(request: requests.MotionRequest):
    return build(scenes.read_packaged(request.scene) if isinstance(request.scene, str) else request.scene)


def judged(request: requests.PlanRequest, reply: PlanReply) -> CertifyReply:
    """The plan's own motion, as whoever kept its request and reply would ask."""
    fields = msgspec.json.decode(msgspec.json.encode(make_recorded_fields(request, to_plain_data(reply), "run")))
    return certify(**{"model": request.robot, **fields, "scene": request.scene, "robot": request.robot})


def require_same(request: requests.PlanRequest, made: PlanReply) -> CertifyReply:
    reply = judged(request, made)
    assert reply.status.name == "SUCCESS", reply.status.message
    assert reply.curve == "hermite"
    assert reply.certificate.collision_free
    assert reply.certificate.free_until.time == made.trajectory.times[-1]
    assert reply.certificate.free_until.row == len(made.trajectory.times) - 1
    assert reply.clearance.minimum == pytest.approx(made.clearance.minimum, abs=1e-12)
    assert reply.clearance.time == pytest.approx(made.clearance.time, abs=1e-9)
    assert reply.clearance.pair == made.clearance.pair
    assert reply.clearance.inner == pytest.approx(made.clearance.inner, abs=1e-12)
    assert reply.self_clearance.minimum == pytest.approx(made.self_clearance.minimum, abs=1e-12)
    assert reply.self_clearance.pair == made.self_clearance.pair
    assert reply.limits.acceleration.share <= 1.0 + 1e-6
    return reply


@pytest.mark.parametrize("kind", PLANS)
def test_plans_of_every_kind_are_certified_as_they_were(kind: str) -> None:
    request, made = asked_and_planned(**PLANS[kind])
    reply = require_same(request, made)
    assert (reply.limits.jerk.share is not None) == (kind == "a jerk limit")
    assert not reply.limits.jerk.steps


@pytest.mark.parametrize("title", ["door", "conveyor"])
def test_a_plan_among_moving_obstacles_is_certified_at_its_times_only(title: str) -> None:
    plain = msgspec.json.decode(example(title))
    request = codec.decode_request({**plain, "allowed_planning_time": 120.0})
    made = answer_plan(request, robot(request.robot), scene_of(request), run_id="r", received=time.monotonic())
    assert made.status.name == "SUCCESS"
    require_same(request, made)

    def judge_at(share: float) -> CertifyReply:
        hurried = to_plain_data(made)
        hurried["trajectory"]["times"] = [share * moment for moment in hurried["trajectory"]["times"]]
        return certify(model=request.robot, **{**make_recorded_fields(request, hurried, "run"), "scene": request.scene})

    refused = [one for one in map(judge_at, (0.3, 0.6, 1.5, 2.0)) if not one.certificate.collision_free]
    assert refused, "at another time something is in the way"
    assert all(one.certificate.reason in ("contact", "undecided") for one in refused)
    assert all(one.certificate.place.time is not None for one in refused)
    with pytest.raises(MalformedRequest, match="obstacles move"):
        certify(model=request.robot, scene=request.scene, path=made.path, position_names=made.position_names)


def test_a_motion_that_flies_and_turns_is_certified_in_its_local_coordinates() -> None:
    urdf = (
        "<robot name='brick'><link name='l'><collision><geometry><box size='0.3 0.1 0.1'/></geometry></collision>"
        "</link></robot>"
    )
    model = {"type": "urdf", "text": urdf, "root_joint": "free"}
    turned = [0.6, 0.2, 0.1, 0.0, 0.0, float(np.sin(0.7)), float(np.cos(0.7))]
    wall = {"name": "s", "obstacles": [{**POST, "position": [0.3, 0.4, 0.0]}]}
    asked = {"robot": model, "scene": wall, "goal": joints(root_joint=turned), **PATIENT}
    made = guidefield.answer(asked)
    assert made.status.name == "SUCCESS", made.status.message
    reply = guidefield.answer({"type": "certify", "robot": model, "scene": wall, **motion_of(made), **LATE})
    assert reply.status.name == "SUCCESS", reply.status.message
    assert reply.clearance.minimum == pytest.approx(made.clearance.minimum, abs=1e-9)
    assert reply.limits.velocity.share == pytest.approx(1.0, abs=0.05)


# ---- mutated motions


def sampled_contact(request: requests.CertifyRequest, samples: int = 300) -> bool:
    """Whether Coal finds any contact, or less than the clearance, at samples evenly along the motion."""
    problem, _ = certify_problem(request, robot(request.robot), scene_of(request), Deadline())
    world, curve, margin = problem.world, problem.motion.measured, problem.min_clearance
    for z in curve.evaluate(np.linspace(curve.times[0], curve.times[-1], samples))[0]:
        q = problem.group.expand_from_local(z)
        if world.in_collision(q):
            return True
        if margin > 0.0:
            world.place(q)
            mixed = np.flatnonzero(are_mixed(world)).tolist()
            if min(world.distance(pair)[0] for pair in mixed) < margin:
                return True
    return False


@settings(max_examples=6)
@given(seed=st.integers(0, 2**32 - 1), timed=st.booleans(), margin=st.sampled_from([0.0, 0.03]))
def test_what_is_certified_dense_samples_find_free_and_the_place_of_a_refusal_is_refused(seed, timed, margin):
    made, rng = planned(), np.random.default_rng(seed)
    rows = np.array(made.path)
    rows[1:] += rng.normal(scale=rng.choice([0.02, 0.15, 0.4]), size=rows[1:].shape)
    motion = {"trajectory": {"positions": rows.tolist()}, "time_step": 0.2} if timed else {"path": rows.tolist()}
    request = codec.decode_request(
        {"type": "certify", "robot": "panda", "scene": "table", "min_clearance": margin, **LATE, **motion}
    )
    reply = answer_certify(request, robot("panda"), scene_of(request), run_id="r", received=time.monotonic())
    certificate = reply.certificate
    if certificate.collision_free:
        assert not sampled_contact(request)
        assert reply.clearance.minimum >= margin
        assert reply.self_clearance.minimum > 0.0
    if certificate.reason in ("contact", "too close"):
        there = [certificate.place.configuration[name] for name in NAMES]
        at_place = {"path": [there], "position_names": NAMES, "min_clearance": margin}
        assert not certify(**at_place).certificate.collision_free
        until = certificate.free_until.row
        before = certify(path=_until(rows, until), position_names=NAMES, min_clearance=margin) if not timed else None
        assert before is None or before.certificate.collision_free


def _until(rows: np.ndarray, row: float) -> list[list[float]]:
    """A path up to a place along it, and not quite there."""
    whole, share = int(row), (row - int(row)) * (1.0 - 1e-9)
    last = rows[whole] + share * (rows[min(whole + 1, len(rows) - 1)] - rows[whole])
    return [*rows[: whole + 1].tolist(), last.tolist()]


def test_what_exceeds_a_limit_is_told_with_joint_and_time() -> None:
    made = to_plain_data(planned())
    quick = {**made["trajectory"], "times": [0.5 * moment for moment in made["trajectory"]["times"]]}
    quick["velocities"] = [[2.0 * value for value in row] for row in quick["velocities"]]
    reply = certify(trajectory=quick, position_names=made["position_names"])
    usual = certify(**motion_of(planned())).limits
    assert reply.status.name == "INVALID_MOTION_PLAN"
    assert reply.certificate.collision_free
    assert reply.limits.velocity.share == pytest.approx(2.0 * usual.velocity.share)
    assert reply.limits.acceleration.share == pytest.approx(4.0 * usual.acceleration.share)
    assert reply.status.details["limit"] == "acceleration"
    assert reply.limits.acceleration.joint in reply.status.message
    assert any("`trajectory.accelerations` are not those" in warning for warning in reply.warnings)


def test_a_motion_that_begins_beyond_its_limits_is_refused_there() -> None:
    reply = certify(path=[[*HOME[:3], 0.1, *HOME[4:]], HOME], position_names=NAMES)
    assert reply.status.name == "INVALID_MOTION_PLAN"
    assert reply.certificate.reason == "beyond limits"
    assert reply.certificate.free_until.row == 0.0
    assert reply.limits.position.joint == "panda_joint4"
    assert reply.limits.position.share > 1.0
    assert reply.status.details["joint"] == "panda_joint4"


def test_jerk_limits_are_kept_by_no_motion_whose_acceleration_jumps() -> None:
    limits = {"panda_joint1": {"jerk": 1e6}}
    motion = motion_of(planned())
    motion["trajectory"]["velocities"] = [[0.9 * rate for rate in row] for row in motion["trajectory"]["velocities"]]
    stepped = certify(**motion, limits=limits)
    assert stepped.limits.jerk.steps
    assert stepped.limits.jerk.share is None
    assert "jumps" in stepped.status.message
    gentle = asked_and_planned(goal=joints(panda_joint1=0.5), limits={"panda_joint1": {"jerk": 20.0}})[1]
    rows = np.array(gentle.trajectory.positions)
    samples = {"positions": rows.tolist(), "times": gentle.trajectory.times}
    splined = certify(trajectory=samples, position_names=gentle.position_names, limits=limits)
    assert splined.curve == "spline"
    assert not splined.limits.jerk.steps


def test_a_point_is_a_motion() -> None:
    for motion in ({"path": [HOME]}, {"trajectory": {"positions": [HOME], "times": [4.0]}}):
        reply = certify(**motion, position_names=NAMES)
        assert reply.status.name == "SUCCESS"
        assert reply.certificate.free_until.row == 0.0
    still = certify(trajectory={"positions": [HOME, HOME], "times": [1.0, 3.0]}, position_names=NAMES)
    assert still.status.name == "SUCCESS"
    assert still.certificate.free_until.time == 3.0
    assert still.limits.velocity.share == 0.0


def a_room() -> dict:
    """A dented cube about the robot, so that its surface is judged."""
    return msgspec.to_builtins(msgspec.structs.replace(closed_shell(3.0), name="room"))


@pytest.mark.parametrize("limit", [0.0, 100.0])
def test_a_plan_that_fails_inside_of_something_has_no_certificate(limit: float) -> None:
    goal = joints(panda_joint1=0.5 + limit)  # beyond its limits nothing is looked at
    scene = {"name": "s", "obstacles": [a_room()]}
    request = {"robot": "panda", "scene": scene, "start": READY, "goal": goal, "guide_planes": [], **PATIENT}
    reply = guidefield.answer({**request, "recording": "off"})
    assert reply.status.name == ("GOAL_STATE_INVALID" if limit else "START_STATE_IN_COLLISION")
    assert not reply.certificate.collision_free


def test_a_slight_contact_at_the_start_may_be_left() -> None:
    ball = {"type": "sphere", "name": "ball", "radius": 0.05}
    scene = {"name": "s", "obstacles": [{**ball, "position": [0.0, 0.0, 0.0]}]}
    problem, _ = certify_problem(
        codec.decode_request({"type": "certify", "robot": "panda", "scene": scene, "path": [HOME]}),
        robot("panda"), build(msgspec.convert(scene, messages.Scene)), Deadline(),
    )  # fmt: skip
    hand = _placed(problem.world, "panda_hand")
    scene["obstacles"][0]["position"] = [float(hand[0]), float(hand[1]) + 0.145, float(hand[2])]
    away, into = [-0.4, *HOME[1:]], [0.2, *HOME[1:]]
    asked = {"scene": scene, "position_names": NAMES}
    assert certify(path=[HOME, away], **asked).certificate.reason == "contact"
    left = certify(path=[HOME, away], leave_start_contact=True, **asked)
    assert left.status.name == "SUCCESS", left.status.message
    assert left.certificate.covers.startswith("path after row 0.")
    assert any("the motion begins by leaving it" in warning for warning in left.warnings)
    assert left.clearance.minimum < 0.0
    inside = {"name": "s", "obstacles": [*scene["obstacles"], a_room()]}
    enclosed = certify(path=[HOME, away], leave_start_contact=True, **{**asked, "scene": inside})
    assert enclosed.certificate.reason == "contact"
    assert "room" in enclosed.certificate.pair
    assert enclosed.certificate.free_until.row == 0.0
    closer = certify(path=[HOME, into], leave_start_contact=True, **asked)
    assert closer.certificate.reason == "contact"
    assert "doesn't leave it" in closer.status.message
    slowly = [
        [share, *HOME[1:]] for share in np.linspace(HOME[0], HOME[0] + 0.004, 3000)
    ]  # 2 mm, by steps of less than 1 um
    slower = certify(path=[*slowly, away], leave_start_contact=True, **asked)
    assert slower.certificate.reason == "contact"
    back = certify(path=[HOME, away, HOME], leave_start_contact=True, **asked)
    assert back.certificate.reason == "contact"
    assert 1.0 < back.certificate.place.row < 2.0


def _placed(world: World, link: str) -> np.ndarray:
    """Middle of a link at `HOME` [m, world]."""
    world.place(np.array(HOME))
    body = world.body_names.index(link)
    shape = world.exact.shape(body)
    shape.computeLocalAABB()
    return np.asarray(world.placement(body).act(np.asarray(shape.aabb_local.center())))


def test_a_path_constraint_is_refused_where_it_is_left_first() -> None:
    tilted = [*HOME[:5], HOME[5] + 0.6, *HOME[6:]]
    into = [tilted[0], 0.9, tilted[2], -1.2, *tilted[4:]]
    reply = certify(path=[HOME, tilted, into], position_names=NAMES, path_constraints=[LEVEL])
    assert reply.certificate.reason == "violates a path constraint"
    assert 0.2 < reply.certificate.place.row < 0.5
    assert certify(path=[HOME, tilted, into], position_names=NAMES).certificate.reason == "contact"


def test_a_time_that_is_up_tells_how_far_it_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [[-1.2 + 2.4e-3 * k, *HOME[1:]] for k in range(1_000)]
    asked = itertools.count()  # a machine may be too quick, or too slow, for any number of seconds

    class Short(Deadline):
        def expired(self) -> bool:
            return next(asked) >= 3

        def status(self) -> Status | None:
            return Status.TIMED_OUT if self.expired() else None

    def judged(problem: GivenProblem, uses: LimitUses) -> Judgement:
        return judge(dataclasses.replace(problem, deadline=Short()), uses)

    monkeypatch.setattr("guidefield.handlers.certify.judge", judged)
    monkeypatch.setattr("guidefield.prove.search.SEGMENTS_AT_ONCE", 5)
    reply = certify(path=rows, position_names=NAMES)
    assert reply.status.name == "TIMED_OUT"
    assert reply.certificate.reason == "stopped"
    assert not reply.certificate.collision_free
    assert 0.0 < reply.certificate.free_until.row < len(rows) - 1


def test_samples_are_judged_as_the_spline_and_on_request_as_straight_pieces() -> None:
    made = planned().trajectory
    curve = Trajectory(np.array(made.times), np.array(made.positions), np.array(made.velocities))
    rows = curve.evaluate(np.arange(0.0, curve.duration, 0.02))[0].tolist()
    spline = certify(trajectory={"positions": rows}, time_step=0.02, position_names=NAMES)
    assert spline.curve == "spline"
    assert spline.clearance.minimum == pytest.approx(planned().clearance.minimum, abs=1e-3)
    assert spline.limits.velocity.share == pytest.approx(
        certify(**motion_of(planned())).limits.velocity.share, abs=0.05
    )
    linear = certify(trajectory={"positions": rows}, time_step=0.02, position_names=NAMES, interpolation="linear")
    assert (linear.status.name, linear.curve) == ("SUCCESS", "linear")
    assert linear.limits.acceleration.share is None
    assert linear.limits.velocity.share <= spline.limits.velocity.share + 1e-9


def test_a_long_motion_is_refused_at_its_place() -> None:
    swings = [[0.001 * (-1.0) ** k, *HOME[1:]] for k in range(2_500)]
    reply = certify(path=[*swings, TURN, [TURN[0], 0.9, 0.0, -1.2, *HOME[4:]]], position_names=NAMES)
    assert reply.status.name == "INVALID_MOTION_PLAN"
    assert reply.certificate.reason == "contact"
    assert set(reply.certificate.place.configuration) == set(NAMES)
    assert reply.clearance.minimum <= 0.0
    assert 2_500.0 < reply.certificate.free_until.row <= reply.certificate.place.row < 2_501.0
    assert 2_500.0 < reply.clearance.row <= 2_501.0


@pytest.mark.parametrize("interpolation", ["spline", "linear"])
def test_times_are_those_of_the_scene_and_arrays_may_stand_for_rows(interpolation: str) -> None:
    places = [{"position": [0.45, y, 0.5]} for y in (-0.8, 0.8)]
    mover = {"type": "sphere", "name": "mover", "radius": 0.08}
    scene = {"name": "m", "obstacles": [{**mover, "trajectory": {"times": [10.0, 14.0], "placements": places}}]}
    rows = np.array([HOME, TURN, HOME])
    given_ = requests.GivenTrajectory(positions=rows, times=np.array([11.0, 12.0, 13.5]))
    request = requests.CertifyRequest(
        "panda", msgspec.convert(scene, messages.Scene), trajectory=given_, position_names=NAMES,
        interpolation=interpolation, recording="off", allowed_time=60.0,
    )  # fmt: skip
    reply = guidefield.answer(request)
    assert reply.status.name == "SUCCESS", reply.status.message
    assert reply.certificate.free_until.time == 13.5
    problem, _ = certify_problem(read_request(request), robot("panda"), build(request.scene), Deadline())
    times = np.linspace(11.0, 13.5, 150)
    zs = problem.motion.scheduled.evaluate(times)[0]
    sampled = []
    for moment, z in zip(times.tolist(), zs, strict=True):
        world = World.build(problem.group, problem.scene.at(moment))
        q = problem.group.expand_from_local(z)
        sampled.append(clearance_at(world, q).obstacle_distance)
    assert min(sampled) - 5e-3 <= reply.clearance.minimum <= min(sampled) + 1e-4
    assert reply.clearance.time == pytest.approx(times[int(np.argmin(sampled))], abs=0.05)
    early = guidefield.answer(msgspec.structs.replace(request, trajectory=None, path=rows.tolist(), scene="table"))
    assert early.clearance.time is None


def test_a_joint_that_stands_still_beyond_its_limit_is_judged_too() -> None:
    asked = {"type": "certify", "robot": "ur5", "scene": {"name": "e"}, "position_names": ["shoulder_pan_joint"]}
    for motion in ({"path": [[0.0], [0.1]]}, {"trajectory": {"times": [0, 1], "positions": [[0.0], [0.1]]}}):
        reply = guidefield.answer({**asked, **motion, "start": {"elbow_joint": 7.0}})
        assert reply.status.name == "INVALID_MOTION_PLAN"
        assert reply.status.message.startswith("joint elbow_joint reaches 7, 3.86 beyond its limits")
        assert reply.status.details["joint"] == "elbow_joint"
        assert reply.certificate.reason == "beyond limits"
        assert reply.limits.position.joint == "elbow_joint"
        assert reply.limits.position.share == pytest.approx(7.0 / np.pi, rel=1e-5)
        assert guidefield.answer({**asked, **motion, "start": {"elbow_joint": 1.0}}).status.name == "SUCCESS"


@pytest.mark.parametrize("rows", [1, 3])
@pytest.mark.parametrize("rate", [-100.0, 3.0])
def test_a_single_row_is_judged_by_the_rates_that_it_gives(rate: float, rows: int) -> None:
    asked = {"type": "certify", "robot": "ur5", "scene": {"name": "e"}, "position_names": ["shoulder_pan_joint"]}
    motion = {"times": [0.0] * rows, "positions": [[0.0]] * rows, "velocities": [[rate]] * rows}
    limits = {"shoulder_pan_joint": {"velocity": 4.0, "acceleration": 20.0}}
    reply = guidefield.answer({**asked, "trajectory": motion, "limits": limits})
    assert reply.limits.velocity.share == pytest.approx(abs(rate) / 4.0)
    assert (reply.status.name == "SUCCESS") == (abs(rate) <= 4.0)
    slow = motion | {"velocities": [[0.0]] * rows, "accelerations": [[rate]] * rows}
    reply = guidefield.answer({**asked, "trajectory": slow, "limits": limits})
    assert reply.limits.acceleration.share == pytest.approx(abs(rate) / 20.0)
    assert (reply.status.name == "SUCCESS") == (abs(rate) <= 20.0)


FOLLOWED = """<robot name="followed">
<link name="base"><collision><geometry><sphere radius="0.02"/></geometry></collision></link>
<link name="arm"><collision><origin xyz="0 0 0.3"/><geometry><sphere radius="0.02"/></geometry></collision></link>
<link name="crank"><collision><origin xyz="0 0.5 0"/><geometry><sphere radius="0.02"/></geometry></collision></link>
<link name="slide"><collision><origin xyz="0 -0.5 0"/><geometry><sphere radius="0.02"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="1" velocity="2"/></joint>
<joint name="drive" type="revolute"><parent link="base"/><child link="crank"/><axis xyz="0 0 1"/>
<limit lower="-20" upper="20" effort="1" velocity="2"/></joint>
<joint name="follow" type="prismatic"><parent link="base"/><child link="slide"/><axis xyz="0 0 1"/>
<limit lower="-0.2279" upper="0.155" effort="1" velocity="2"/>
<mimic joint="drive" multiplier="0.025" offset="-0.118"/></joint></robot>"""


def test_a_mimic_joint_that_stands_at_its_limit_may_be_rounded_beyond_it() -> None:
    """Its law gives 2.8e-17 m more than its limit there."""
    assert 0.025 * 10.92 - 0.118 > 0.155
    reply = guidefield.answer(
        {
            "type": "certify",
            "robot": {"type": "urdf", "text": FOLLOWED},
            "scene": {"name": "none", "obstacles": []},
            "group": ["turn"],
            "start": {"turn": 0.0, "drive": 10.92},
            "position_names": ["turn"],
            "path": [[0.0], [0.5]],
        }
    )
    assert reply.certificate.collision_free, reply.status.message
