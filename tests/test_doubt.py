"""`tools/doubt`: some fixed units are not contradicted, and planted faults are found."""

from pathlib import Path
from typing import Any

import coal
import msgspec
import numpy as np
import pinocchio as pin
import pytest

from guidefield.engine import Engine
from guidefield.messages.certify_reply import Place
from guidefield.messages.replies import CertifyReply, PlanReply
from guidefield.messages.requests import CertifyRequest, GivenTrajectory, JointsGoal, PlanRequest, UrdfText
from guidefield.messages.scene import Box, ObstacleTrajectory, Scene, Sphere
from guidefield.messages.values import Placement
from tests.planner.problems import closed_shell
from tests.robot.odd_meshes import stl

TOOLS = Path(__file__).parents[1] / "tools"
ENGINE = Engine()
replace = msgspec.structs.replace


class Lying:
    """An engine whose replies are changed."""

    def __init__(self, change: Any) -> None:
        self._change = change

    def answer(self, request: Any) -> Any:
        reply = ENGINE.answer(request)
        return self._change(reply) if isinstance(reply, CertifyReply) else reply


def certified(reply: CertifyReply) -> CertifyReply:
    return replace(reply, certificate=replace(reply.certificate, collision_free=True, reason="free"))


def farther(reply: CertifyReply) -> CertifyReply:
    return replace(reply, clearance=replace(reply.clearance, minimum=reply.clearance.minimum + 2e-4))


def refused(reply: CertifyReply) -> CertifyReply:
    place = Place(row=0.0, time=None, configuration={})
    verdict = replace(reply.certificate, collision_free=False, reason="contact", pair=reply.clearance.pair, place=place)
    return replace(reply, certificate=verdict)


@pytest.fixture(autouse=True)
def tools(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(TOOLS))


BALL = '<link name="{}"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>'
SLIDER = (
    f'<robot name="slider">{BALL.format("rail")}{BALL.format("ball")}<joint name="slide" type="prismatic">'
    '<origin xyz="0 0 0.5"/><parent link="rail"/><child link="ball"/><axis xyz="1 0 0"/>'
    '<limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>'
)


def loaded(folder: Path, engine: Any = ENGINE, catalog: str | None = None) -> Any:
    """A robot of the catalog, or the slider."""
    from doubting.loaded import Loaded
    from doubting.robots import Robot

    return Loaded.of(Robot(catalog=catalog, text="" if catalog else SLIDER), folder, engine)


def slide(until: float) -> CertifyRequest:
    """The ball slides from 0; a box begins at 0.7 in its way."""
    boxes = [
        Box(name="far", size=(0.1, 0.1, 0.1), position=(0.0, 0.0, 2.0)),
        Box(name="near", size=(0.2, 0.2, 0.2), position=(0.8, 0.0, 0.5)),
    ]
    scene = Scene(name="s", obstacles=boxes)
    return CertifyRequest(
        UrdfText(text=SLIDER), scene, path=[[0.0], [until]], position_names=["slide"], recording="off"
    )


def test_aligned_motions_are_not_contradicted(tmp_path: Path) -> None:
    from doubting.unit import Work

    for seed in (1, 3, 7):
        unit = Work(seed, tmp_path, ENGINE).done(motions=15)
        assert unit.found == []
        assert unit.counts["mutants"] >= 10
        assert min(unit.counts["mutants certified"], unit.counts["mutants refused"]) > 0


@pytest.mark.parametrize("seed", [16, 30])
def test_fixed_units_are_not_contradicted(tmp_path: Path, seed: int) -> None:
    from doubting.unit import Work

    ENGINE.warm_up()  # a plan has one second, which loading kernels takes on a busy machine
    unit = Work(seed, tmp_path, ENGINE).done(plans=2, changed=6)
    assert unit.found == []
    assert "disagreements" not in unit.counts
    assert unit.counts["plans"] == 2
    assert unit.counts["mutants"] >= 5
    assert unit.counts["mutants certified"] > 0


def test_a_goal_that_something_comes_to_rest_in_is_rightly_refused(tmp_path: Path) -> None:
    """At time 0 it would be free: a refusal is false only if it is free once all rest."""
    from doubting.doubted import doubt_answer

    way = ObstacleTrajectory(
        times=[0.0, 1.0], placements=[Placement(position=at) for at in ((0.6, 0.0, 2.0), (0.6, 0.0, 0.5))]
    )
    scene = Scene(name="s", obstacles=[Sphere(name="lid", radius=0.1, trajectory=way)])
    goal = JointsGoal({"slide": 0.6})
    came = doubt_answer(
        loaded(tmp_path),
        PlanRequest(UrdfText(text=SLIDER), scene, goal=goal, start={"slide": 0.0}, guide_planes=[], recording="off"),
    )
    assert came.reply.status.name == "GOAL_IN_COLLISION"
    assert came.found == ()


@pytest.mark.parametrize(
    ("change", "until", "kind"),
    [(certified, 0.9, "FALSE_CERTIFICATE"), (farther, 0.3, "FIGURE"), (refused, 0.3, "FALSE_REFUSAL")],
)
def test_planted_faults_are_found_and_shrunk(tmp_path: Path, change: Any, until: float, kind: str) -> None:
    from doubting.case import shrink
    from doubting.compare import Kind
    from doubting.doubted import doubt_answer

    liar = loaded(tmp_path, Lying(change))
    came = doubt_answer(liar, slide(until))
    assert Kind[kind] in {one.kind for one in came.found}
    small = shrink(liar, slide(until), Kind[kind])
    assert [one.name for one in small.scene.obstacles] == ["near"]
    assert Kind[kind] in {one.kind for one in doubt_answer(liar, small).found}


@pytest.mark.parametrize("robot", ["chain_moving_3x260_r25", "chain_planar_3x260_r25", "ur5"])
def test_the_judges_curve_is_that_of_the_samples(tmp_path: Path, robot: str) -> None:
    from doubting.asked import free
    from doubting.compare import planned_curve
    from doubting.curve import Curve

    known, rng = loaded(tmp_path, catalog=robot), np.random.default_rng(1)
    ends = [free(rng, known, known.movable, {}) for _ in range(2)]
    request = PlanRequest(
        robot, Scene(name="s"), JointsGoal(ends[1]), start=ends[0], guide_planes=[], recording="off", seed=1
    )
    request = replace(request, group=[joint.name for joint in known.movable])
    knots, samples = (ENGINE.answer(replace(request, sample_rate=rate)) for rate in (None, 40.0))
    assert isinstance(knots, PlanReply)
    curve = planned_curve(knots)
    values = curve.at(np.array(samples.trajectory.times))
    told = Curve.of(samples.position_names, samples.trajectory.positions)
    for part in told.parts:
        rows = told.at(told.times)[part.name]
        mine = values[part.name]
        if part.width >= 4:  # a quaternion of either sign
            mine = np.where((rows[:, -4:] * mine[:, -4:]).sum(axis=1)[:, None] < 0.0, -mine, mine)
            np.testing.assert_allclose(mine[:, -4:], rows[:, -4:], rtol=0.0, atol=1e-9)
            continue
        np.testing.assert_allclose(mine, rows, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("judge", ["ask_referee", "ask_hpp"])
@pytest.mark.parametrize(("change", "until"), [(certified, 0.9), (refused, 0.3), (lambda reply: reply, 0.9)])
def test_the_referee_and_hpp_contradict_what_is_false_alone(tmp_path, judge, change, until):
    from doubting import hpp, refereed

    if judge == "ask_hpp" and not hpp.is_installed():
        pytest.skip("HPP isn't installed; `tools/doubt --hpp` does it")
    reply = change(ENGINE.answer(slide(until)))
    given = (slide(until), reply) if judge == "ask_referee" else (loaded(tmp_path), slide(until), reply)
    outcome, found = getattr(refereed, judge)(*given)
    expected = (refereed.Outcome.DISAGREES, 1) if change in (certified, refused) else (refereed.Outcome.AGREES, 0)
    assert (outcome, len(found)) == expected


def test_hpp_finds_contacts_along_cubics_of_an_arm(tmp_path: Path) -> None:
    """Random motions of a Panda through a box: the verdicts are the certificate's, first contacts no earlier."""
    from doubting import hpp

    if not hpp.is_installed():
        pytest.skip("HPP isn't installed; `tools/doubt --hpp` does it")
    known, rng = loaded(tmp_path, catalog="panda"), np.random.default_rng(2)
    names = [f"panda_joint{k}" for k in range(1, 8)]
    scene = Scene(name="s", obstacles=[Box(name="box", size=(0.2, 0.2, 0.2), position=(0.6, 0.3, 0.3))])
    asked, replies = [], []
    while len(asked) < 12:
        ends = rng.uniform(-0.5, 0.5, (2, 7)) + np.array([0.0, 0.2, 0.0, -1.8, 0.0, 1.8, 0.0])
        motion = GivenTrajectory(times=[0.0, 1.0], positions=ends.tolist(), velocities=rng.normal(size=(2, 7)).tolist())
        one = CertifyRequest(known.reference, scene, trajectory=motion, position_names=names, velocity_names=names)
        reply = ENGINE.answer(replace(one, recording="off"))
        if reply.certificate.reason in ("free", "contact"):
            asked.append(one)
            replies.append(reply.certificate)
    assert {reply.reason for reply in replies} == {"free", "contact"}, replies
    for said, reply in zip(hpp.ask([hpp.case(one) for one in asked], 120.0), replies, strict=True):
        assert said.answer == reply.reason
        assert said.answer == "free" or said.at >= reply.free_until.time


@pytest.mark.parametrize("seed", range(10))
def test_distances_of_convex_bodies_have_a_second_way(seed: int) -> None:
    from doubting import hulls

    rng = np.random.default_rng(seed)
    half, ball = rng.uniform(0.05, 1.0, 3), rng.normal(size=3) * 2.0
    box, sphere = coal.Box(*(2.0 * half)), coal.Sphere(0.01)
    there = pin.SE3(np.eye(3), ball)
    expected = np.linalg.norm(np.maximum(np.abs(ball) - half, 0.0)) - 0.01
    if expected > 0.0:
        assert hulls.distance(box, pin.SE3.Identity(), sphere, there) == pytest.approx(expected, abs=1e-12)
    points = rng.normal(size=(12, 3)) + rng.normal(size=3) * 3.0
    x = hulls.least_norm(points)
    found = coal.distance(
        coal.Convex.convexHull(vector(points), True, "Qt"),
        coal.Transform3s.Identity(),
        coal.Sphere(1e-9),
        coal.Transform3s.Identity(),
        coal.DistanceRequest(),
        coal.DistanceResult(),
    )
    assert x == pytest.approx(max(0.0, found), abs=1e-6)


def vector(points: np.ndarray) -> Any:
    found = coal.StdVec_Vec3s()
    for point in points:
        found.append(point)
    return found


def test_a_link_inside_of_another_is_refused_by_everybody(tmp_path: Path) -> None:
    from doubting.doubted import doubt_answer
    from doubting.loaded import Loaded
    from doubting.refereed import Outcome, ask_referee
    from doubting.robots import FOLDER, Robot

    shell = closed_shell(0.5)
    triangles = np.array(shell.vertices)[np.array(shell.triangles)]
    text = SLIDER.replace('<sphere radius="0.05"/>', f'<mesh filename="{FOLDER}shell.stl"/>', 1)
    text = text.replace('<link name="ball">', '<link name="empty"/><link name="ball">')
    text = text.replace('<parent link="rail"/>', '<parent link="empty"/>').replace("0 0 0.5", "0 0 0")
    joint = '<joint name="{}" type="prismatic"><parent link="rail"/><child link="empty"/><axis xyz="0 0 1"/>{}</joint>'
    lift = joint.format("lift", '<limit lower="0" upper="2" effort="1" velocity="1"/>')
    robot = Robot(text=text.replace("</robot>", f"{lift}</robot>"), meshes={"shell.stl": stl(triangles)})
    known = Loaded.of(robot, tmp_path, ENGINE)
    for height, reason in ((0.0, "contact"), (1.0, "free")):
        asked = CertifyRequest(
            known.reference,
            Scene(name="s"),
            path=[[height, 0.0], [height, 0.1]],
            position_names=["lift", "slide"],
            recording="off",
        )
        came = doubt_answer(known, asked)
        assert came.found == ()
        assert came.reply.certificate.reason == reason
        assert ask_referee(asked, came.reply) == (Outcome.AGREES, [])
    lie = certified(ENGINE.answer(replace(asked, path=[[0.0, 0.0], [0.0, 0.1]])))
    outcome, found = ask_referee(replace(asked, path=[[0.0, 0.0], [0.0, 0.1]]), lie)
    assert outcome is Outcome.DISAGREES
    assert "inside a closed mesh" in found[0].said


def test_proofs_are_replayed_and_refused_where_they_are_false(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Proofs of a slice of motions hold, changed ones don't; a referee that believes too much is found out."""
    from doubting import proofs
    from doubting.proofs import doubt_proof
    from guidefield.referee.replay import _Replay

    robot, earlier = loaded(tmp_path), list[Any]()
    for until in (0.3, 0.4, 0.5):
        request = slide(until)
        counts, found = doubt_proof(np.random.default_rng(3), robot, request, ENGINE.answer(request), earlier)
        assert found == []
        assert counts["proof:replayed"] == 1
        assert counts["proof:changed and refused"] >= 5
    assert len(earlier) == 3
    monkeypatch.setattr(proofs, "_false", lambda *_: "")  # else it is found out at once
    right = _Replay._apart
    monkeypatch.setattr(_Replay, "_apart", lambda self, *asked: right(self, *asked) + 0.3)
    _, found = doubt_proof(np.random.default_rng(3), robot, slide(0.5), ENGINE.answer(slide(0.5)), [])
    assert [one.said for one in found] == [f"after more_{what}: it is false" for what in ("clearance", "claimed")]
