"""`tools/fixed_requests`: the same answers every time, and a difference of one bit is told with its place."""

import json
import math
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

TOOLS = Path(__file__).parents[1] / "tools"
ANSWER: dict[str, Any] = {
    "status": {"name": "SUCCESS", "code": 1},
    "path": [[0.0, 1.0], [0.5, 1.0]],
    "links": {"hand": {"force": [[1.0, 2.0, 3.0]]}},
    "clearance": None,
    "warnings": [],
}


@pytest.fixture
def comparing(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(TOOLS))
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
