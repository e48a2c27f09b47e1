"""A slice of `tools/attack_deadlines`: answers come in time however large what is given, and however it is given."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import guidefield
from guidefield.aside import wait_for_others
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


def held_anew() -> dict[str, Any]:
    """A request with a held mesh of 30,000 triangles that nobody has seen."""
    mesh = triangles(30_000)["scene"]["obstacles"][0]
    size = 0.02 * (1.0 + 1e-6 * np.random.default_rng().random())
    held = {**mesh, "name": "held", "vertices": (size * mesh["vertices"]).tolist()}
    attached = [{"obstacle": {**held, "triangles": mesh["triangles"].tolist()}, "link": "panda_hand"}]
    return {**SMALL, "guide_planes": [], "attached_objects": attached, "recording": "off"}


def test_what_a_robot_holds_is_built_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes some seconds, and goes on by itself."""
    guidefield.answer(SMALL)
    monkeypatch.setattr(time, "monotonic", time.process_time)  # threads beside one another count twice
    late = []
    for _ in range(TRIES):
        asked = held_anew() | {"allowed_planning_time": 0.3}
        began = time.process_time()
        reply = guidefield.answer(asked)
        late.append(time.process_time() - began - 0.3)
        assert isinstance(reply, guidefield.PlanReply)
        assert (reply.status.name, reply.status.details["stage"]) == ("TIMED_OUT", "load")
        assert reply.status.details["preparing"]
        assert (reply.certificate.collision_free, reply.certificate.evaluations) == (False, 0)
        wait_for_others(lambda: None)
    assert not too_late(min(late), 0.3)
