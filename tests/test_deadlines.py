"""A slice of `tools/attack_deadlines`: answers come in time however large what is given, and however it is given."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

import guidefield
from tests.deadline_attack import FORMS, SMALL, TIMES, too_late
from tests.deadline_requests import triangles

HOUSE = Path(__file__).parents[1]

SHARE = 0.2
"""Of the largest scenes: reading one takes from 5 to 100 ms, and building it more."""


IN_ITS_OWN = """
import json, sys
from tests.deadline_attack import late
told = [(*one, late(*one, again={again}, share={share})) for one in json.loads(sys.argv[1])]
print(json.dumps(told))
"""
"""Asks in every way, in a process in which nobody else has left what the collector would have to look through."""

SCENES = ["boxes", "triangles", "points"]

OTHERS = [
    *(
        "polygons",
        "planes",
        "scene_planes",
        "step_planes",
        "places",
        "movers",
        "crowd",
        "moving_mesh",
        "held",
        "path",
        "trajectory",
    ),
    *("samples", "goals", "blocked_goals", "steps", "constraints", "pairs", "frames", "clearances", "poses", "field"),
]
"""What else there may be much of: each of them was late once, or might be."""


Asked = tuple[str, str, float]
"""What there is much of, how it is given, and what is allowed [s]."""

TRIES = 3
"""On a busy machine who waits for a thread sees late that time is up, while that thread's time counts."""


def missed(asked: list[Asked], share: float, again: int = 0) -> list[Asked]:
    """Those requests to which answers came too late each time they were tried, in a process of their own."""
    for _ in range(TRIES):
        given = [sys.executable, "-c", IN_ITS_OWN.format(share=share, again=again), json.dumps(asked)]
        done = subprocess.run(given, check=True, capture_output=True, text=True, cwd=HOUSE)
        told = json.loads(done.stdout)
        assert len(told) == len(asked)
        asked = [(kind, form, time) for kind, form, time, each in told if any(too_late(late, time) for late, _ in each)]
        if not asked:
            break
    return asked


def test_answers_come_in_time() -> None:
    ways = [(kind, form) for kind in SCENES for form in FORMS]
    asked = [(kind, form, SHARE * TIMES[k % len(TIMES)]) for k, (kind, form) in enumerate(ways)]
    assert missed(asked, SHARE, again=1) == []


@pytest.mark.parametrize("kinds", [OTHERS[0::2], OTHERS[1::2]])
def test_answers_to_whatever_is_long_come_in_time(kinds: list[str]) -> None:
    assert missed([(kind, form, 0.05) for kind in kinds for form in ("dicts", "json")], 0.1) == []


def test_what_a_robot_holds_is_built_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes some seconds, and goes on by itself; how far it gets depends on what is kept on disk."""
    mesh = triangles(60_000)["scene"]["obstacles"][0]
    held = {
        **mesh,
        "name": "held",
        "vertices": (0.02 * mesh["vertices"]).tolist(),
        "triangles": mesh["triangles"].tolist(),
    }
    attached = [{"obstacle": held, "link": "panda_hand"}]
    asked = {
        **SMALL,
        "guide_planes": [],
        "attached_objects": attached,
        "allowed_planning_time": 0.3,
        "recording": "off",
    }
    guidefield.answer(SMALL)
    monkeypatch.setattr(time, "monotonic", time.process_time)  # threads beside one another count twice
    began = time.process_time()
    reply = guidefield.answer(asked)
    assert not too_late(time.process_time() - began - 0.3, 0.3)
    assert isinstance(reply, guidefield.PlanReply)
    assert (reply.status.name, reply.status.details["stage"]) == ("TIMED_OUT", "load")
    assert reply.status.details["preparing"]
    assert (reply.certificate.collision_free, reply.certificate.evaluations) == (False, 0)
