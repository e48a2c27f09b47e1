"""A certificate that its reply's own clearance contradicts is an internal failure with a file, never an answer."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import pytest

import guidefield
from guidefield.errors import InternalFailure
from guidefield.handlers import plan, sequence
from guidefield.kernels.jit.cache import cache_folder
from guidefield.planner import judgement
from guidefield.prove import search
from guidefield.prove.verdict import Reason, Verdict
from guidefield.referee.case import Answer
from guidefield.referee.judge import judge
from guidefield.referee.loading import load
from tests.handlers.test_upright import ANGLES, GEOMETRIES, STEP, TURN, arm, certify, obstacle


def free(*_: Any, **__: Any) -> Verdict:
    """What a certificate says that has gone wrong."""
    return Verdict(Reason.FREE, 1)


@pytest.fixture(autouse=True)
def cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cache_folder().parents[1]))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


def kept(error: InternalFailure, cache: Path) -> Path:
    """The file that is named in an error."""
    found = re.search(r"kept as '([^']+)'", error.message)
    assert found is not None, error.message
    return cache / "guidefield" / "failures" / found.group(1)


@pytest.mark.parametrize(("gap", "asked"), [(-0.003, 0.0), (0.006, 0.0061)])
@pytest.mark.parametrize("kind", ["box", "mesh"])
def test_a_false_certificate_is_no_answer(monkeypatch, cache, kind, gap, asked):
    monkeypatch.setattr(judgement, "certify_given", free)
    robot, one = arm(GEOMETRIES["cylinder"]), obstacle(kind, gap)
    with pytest.raises(
        InternalFailure, match="the certificate says that the motion is free, but l4 and o keep"
    ) as caught:
        certify(robot, one, min_clearance=asked)
    (case,) = load(kept(caught.value, cache))
    assert judge(case, seconds=60.0).answer is (Answer.CONTACT if gap < 0.0 else Answer.TOO_CLOSE)


def test_a_false_certificate_in_time_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(judgement, "certify_given", free)
    one = obstacle("box", -0.003)
    placements = [{"position": one.pop("position")}] * 2
    moving = {**one, "trajectory": {"times": [0.0, 1.0], "placements": placements}}
    way = {"times": [0.0, 1.0], "positions": [[TURN], [TURN + STEP]]}
    with pytest.raises(InternalFailure, match="l4 and o keep"):
        certify(arm(GEOMETRIES["cylinder"]), moving, trajectory=way)


def test_a_false_certificate_of_the_robot_itself_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(judgement, "certify_given", free)
    robot = arm(GEOMETRIES["cylinder"])
    x, y, z = obstacle("box", 0.0)["position"]
    post = f'<collision><origin xyz="{x} {y} {z + 0.08}"/><geometry><sphere radius="0.05"/></geometry></collision>'
    robot["text"] = robot["text"].replace('<link name="w">', f'<link name="w">{post}')
    far = {"type": "sphere", "name": "far", "radius": 0.1, "position": [0.0, 0.0, 5.0]}
    with pytest.raises(InternalFailure, match=r"w and l4 keep|l4 and w keep"):
        certify(robot, far)


def ask(**more: Any) -> Any:
    """A plan, or one with steps, beside a box."""
    names = [f"j{k}" for k in range(5)]
    return guidefield.answer(
        {
            "robot": arm(GEOMETRIES["cylinder"]),
            "scene": {"name": "s", "obstacles": [obstacle("box", 0.006)]},
            "start": dict(zip(names, (TURN, *ANGLES), strict=True)),
            "guide_planes": [],
            "recording": "off",
            **more,
        }
    )


GOAL = {"goal": {"type": "joints", "positions": {"j0": TURN + STEP}}, "group": ["j0"]}


@pytest.mark.parametrize("steps", [False, True])
def test_a_plan_that_its_clearance_contradicts_is_no_answer(monkeypatch, cache, steps):
    asked = {"steps": [GOAL]} if steps else GOAL
    assert ask(**asked).status.name == "SUCCESS"
    handler = sequence if steps else plan
    measure = handler.measure_clearances

    def deeper(*arguments: Any) -> Any:
        found = measure(*arguments)
        return [dataclasses.replace(one, obstacle=dataclasses.replace(one.obstacle, distance=-0.0125)) for one in found]

    monkeypatch.setattr(handler, "measure_clearances", deeper)
    with pytest.raises(InternalFailure, match=r"l4 and o keep -12\.5 mm of 0 mm") as caught:
        ask(**asked)
    assert [judge(case, seconds=60.0).answer for case in load(kept(caught.value, cache))] == [Answer.FREE]


@pytest.mark.parametrize("kind", ["confirm", "smallest"])
def test_a_search_that_coal_contradicts_is_no_answer_and_a_file(monkeypatch, cache, kind):
    """Where no reply is made, too, the motion is kept for the referee."""
    if kind == "confirm":
        monkeypatch.setattr(search.World, "touches", lambda *_: False)
        monkeypatch.setattr(search.World, "penetration", lambda *_: None)
    else:
        monkeypatch.setattr(search.World, "distance", lambda *_: (9.0, None))
    robot, one = arm(GEOMETRIES["cylinder"]), obstacle("box", -0.003 if kind == "confirm" else 0.006)
    said = "and Coal hasn't" if kind == "confirm" else "Coal has 9000 mm"
    with pytest.raises(InternalFailure, match=said) as caught:
        certify(robot, one)
    (case,) = load(kept(caught.value, cache))
    assert judge(case, seconds=60.0).answer is (Answer.CONTACT if kind == "confirm" else Answer.FREE)
