"""`tools/robots`: finds the robots of a folder, tells each result by its kind, and sees a false certificate."""

import json
from pathlib import Path

import msgspec
import pytest

from guidefield.engine import Engine
from guidefield.messages.requests import JointsGoal, PlanRequest, UrdfFile
from guidefield.messages.scene import Box, Scene
from tests.robots import box_arm

TOOLS = Path(__file__).parents[1] / "tools"


@pytest.fixture(autouse=True)
def tools(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(TOOLS))


def test_each_robot_of_a_folder_gets_its_kind_of_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from robot_trials import trials

    robots = tmp_path / "robots"
    (robots / "deep").mkdir(parents=True)
    (robots / "deep" / "arm.URDF").write_text(box_arm("y x y", 3).text)
    (robots / "broken.urdf").write_text("<robot name='r'>")
    (robots / "package.xml").write_text("<?xml version='1.0'?><!-- <mujoco/> --><package/>")
    (robots / "arm.xml").write_text("<!-- an arm --><mujoco/>")
    (robots / "macros.xacro").write_text("<other/>")
    found = [str(file.relative_to(robots)) for file in trials.robot_files(robots)]
    assert found == ["arm.xml", "broken.urdf", "deep/arm.URDF"]

    output = tmp_path / "out" / "robots.json"
    arguments = [str(robots), "--output", str(output), "--only", "r.urdf"]
    assert trials.main([*arguments[:-1], ".urdf"], "") == 0
    lines = {line["robot"]: line for line in json.loads(output.read_text())}
    assert lines["broken.urdf"]["kind"] == "refused"
    assert "not XML" in lines["broken.urdf"]["message"]

    assert trials.main([*arguments[:-1], "arm.URDF"], "") == 0
    (line,) = json.loads(output.read_text())
    assert line["kind"] == "planned"
    assert [plan["status"] for plan in line["plans"]] == ["SUCCESS", "SUCCESS"]
    assert line["dof"] == 3
    assert 0.0 < line["load_cpu"] < line["first_cpu"]
    assert "1 robots: 1 planned" in capsys.readouterr().out

    (line,) = trials.run(["deep/arm.URDF"], robots, 0.01, 1, 0)
    assert line["kind"] == "time limit"


def test_a_certificate_that_does_not_hold_is_found(tmp_path: Path) -> None:
    from robot_trials.goals import Goals

    (tmp_path / "arm.urdf").write_text(box_arm("y x y", 3).text)
    engine, reference = Engine(), UrdfFile(str(tmp_path / "arm.urdf"))
    goals = Goals.of(engine._loaded.catalog.load(reference), reference, engine)
    drawn = goals.draw([1], 50, 0)
    request = PlanRequest(robot=reference, scene=Scene("empty"), goal=JointsGoal(drawn[0]), recording="off")
    reply = engine.answer(request)
    assert reply.status.name == "SUCCESS"
    assert goals.doubt(request, reply) == []
    crate = Box("crate", position=(0.0, 0.0, 0.6), size=(0.3, 0.3, 0.3))
    among = msgspec.structs.replace(request, scene=Scene("crate", obstacles=[crate]))
    assert any(one.kind.name == "FALSE_CERTIFICATE" for one in goals.doubt(among, reply))


def test_robots_with_faults_that_are_read_alike_are_judged(tmp_path: Path) -> None:
    """Reversed limits, a source of a mimic joint without its prefix, and joints whose names have dots."""
    from robot_trials.trial import Trial

    text = box_arm("y x mimic", 3).text.replace('lower="-2" upper="2"', 'lower="2" upper="-2"', 1)
    for name, new in (('name="j1"', 'name="left_j1"'), ('name="j2"', 'name="joint_2.0"'), ("j3", "left_j3")):
        assert name in text
        text = text.replace(name, new)
    (tmp_path / "arm.urdf").write_text(text)
    trial = Trial(str(tmp_path / "arm.urdf"), True, 0, 5.0, tmp_path / "line.json")
    trial.run()
    assert [plan["kind"] for plan in trial.line["plans"]] == ["planned", "planned"]
    assert any("taken for 'left_j1'" in warning for warning in trial.line["warnings"])
    assert any("exceeds" in warning for warning in trial.line["warnings"])
