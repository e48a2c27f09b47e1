"""Tools say how they are used; what they name is there; each says the same every time and sees what is false."""

import ast
import json
import math
import platform
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import msgspec
import pytest

from guidefield.engine import Engine
from guidefield.messages.requests import JointsGoal, PlanRequest, UrdfFile
from guidefield.messages.scene import Box, Scene
from tests.robots import box_arm

TOOLS = Path(__file__).parents[1] / "tools"
TABLE = (TOOLS.parent / "CONTRIBUTING.md").read_text().partition("## Run things")[2].partition("\n## ")[0]


def test_each_tool_says_how_it_is_used_and_is_in_the_table() -> None:
    tools = [path for path in TOOLS.iterdir() if path.is_file() and not path.suffix]
    asked = {
        tool.name: subprocess.Popen([tool, "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for tool in tools
    }
    told = {name: process.communicate(timeout=300)[0] for name, process in asked.items()}
    assert [name for name, process in asked.items() if process.returncode] == []
    assert [name for name, said in told.items() if f"usage: tools/{name}" not in said.lower()] == []
    assert [name for name in told if f"`tools/{name}" not in TABLE] == []


@pytest.mark.parametrize(("tool", "folder"), [("attack", "attacks"), ("bench", "benchmarks")])
def test_a_tool_lists_what_it_can_be_asked_with_a_line_on_each(tool: str, folder: str) -> None:
    done = subprocess.run(
        [sys.executable, str(TOOLS / tool), "nothing"], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 2
    told = dict(line.split(maxsplit=1) for line in done.stdout.partition("\n\n")[2].splitlines()[4:] if line)
    subjects = {path.stem for path in (TOOLS / folder).glob("*.py") if "\ndef run(arguments" in path.read_text()}
    assert set(told) == subjects
    assert all(
        told[name] == ast.get_docstring(ast.parse((TOOLS / folder / f"{name}.py").read_text())).partition("\n")[0]
        for name in told
    )


HOUSE = Path(__file__).parents[1]
SLICE = (TOOLS / "slice").read_text()


def _wheels(machine: str, python: str) -> dict[str, str]:
    command = [sys.executable, str(TOOLS / "emulated" / "wheels.py"), machine, python]
    told = subprocess.run(command, check=True, capture_output=True, text=True, timeout=600).stdout
    return dict(line.split("==") for line in told.splitlines())


@pytest.mark.parametrize("named", re.findall(r"tests/\S+\.py\S*", SLICE))
def test_tests_that_are_named_exist(named: str) -> None:
    file, _, test = named.partition("::")
    functions = [node.name for node in ast.parse((HOUSE / file).read_text()).body if isinstance(node, ast.FunctionDef)]
    assert not test or test in functions


def test_wheels_are_those_that_the_other_machine_needs() -> None:
    """Of these packages, yourdfpy's optional ones are not for every processor."""
    there = _wheels("aarch64", "3.11")
    assert {"numba", "pin", "coal", "libcoal", "numpy", "pytest", "execnet"} <= set(there)
    assert there["numba"] == version("numba")
    assert not {"embreex", "mypy"} & set(there), "it has no embreex, and the slice needs no linters"
    if platform.machine() == "x86_64":
        assert "embreex" in _wheels("x86_64", "3.11")


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


ANSWER: dict[str, Any] = {
    "status": {"name": "SUCCESS", "code": 1},
    "path": [[0.0, 1.0], [0.5, 1.0]],
    "links": {"hand": {"force": [[1.0, 2.0, 3.0]]}},
    "clearance": None,
    "warnings": [],
}


@pytest.fixture
def comparing() -> ModuleType:
    from fixed import comparing

    return comparing


def _kept(folder: Path, name: str, answer: dict[str, Any]) -> Path:
    file = folder / f"{name}.json"
    file.write_text(json.dumps({"made_with": {"guidefield": name}, "answers": {"ours": answer}}))
    return file


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda answer: answer["path"][1].__setitem__(0, 0.75), "path: 1 of 4 values, by at most 0.25 at [1][0]"),
        (
            lambda answer: answer["path"][0].__setitem__(1, math.nextafter(1.0, 2.0)),
            "path: 1 of 4 values, by at most 2.22e-16 at [0][1]",
        ),
        (lambda answer: answer["path"][0].__setitem__(0, -0.0), "path: 1 of 4 values, by at most 0 at [0][0]"),
        (lambda answer: answer["path"].append([1.0, 1.0]), "path: another shape: 4 -> 6 values"),
        (lambda answer: answer["links"]["hand"]["force"][0].reverse(), "links.hand.force: 2 of 3 values, by at most 2"),
        (lambda answer: answer["status"].update(name="FAILURE"), "status.name: 'SUCCESS' -> 'FAILURE'"),
        (lambda answer: answer.update(clearance=0.1), "clearance: None -> 0.1"),
        (lambda answer: answer["warnings"].append("near"), "warnings: another shape: 1 -> 1 values"),
        (lambda answer: answer.update(added=1), "added: only in the second"),
    ],
)
def test_a_difference_is_told_with_its_place(comparing, tmp_path, capsys, change, said):
    changed = json.loads(json.dumps(ANSWER))
    change(changed)
    first, second = _kept(tmp_path, "first", ANSWER), _kept(tmp_path, "second", changed)
    assert comparing.compare(first, first) == 0
    assert capsys.readouterr().out == "ours: same to the bit\n1 of 1 are the same to the bit\n"
    assert comparing.compare(first, second) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[:2] == ["guidefield: first -> second", "ours: differs"]
    assert lines[2].strip().startswith(said)
    assert lines[3:] == ["0 of 1 are the same to the bit"]


def test_answers_are_the_same_every_time(comparing, tmp_path, capsys):
    files = [tmp_path / f"{name}.json" for name in ("one", "two")]
    for (
        file
    ) in files:  # Coal begins with what it found last, so that an old process tells a distance otherwise by 5e-12 m
        tool = [sys.executable, str(TOOLS / "fixed_requests"), str(file), "--only", "lift", "goal beyond"]
        subprocess.run(tool, check=True, capture_output=True, timeout=600)
    answers = json.loads(files[0].read_text())["answers"]
    assert len(answers) >= 5
    assert {"goal beyond limits", "lift all joints", "potential on lift"} <= set(answers)
    assert answers["lift all joints"]["status"]["name"] == "SUCCESS"
    assert comparing.compare(*files) == 0
    assert f"{len(answers)} of {len(answers)} are the same to the bit" in capsys.readouterr().out
