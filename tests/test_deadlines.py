"""A slice of `tools/attack_deadlines`: answers come in time however large what is given, and however it is given."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import guidefield
from tests.deadline_attack import FORMS, MAKERS, SMALL, TIMES, too_late, triangles

HOUSE = Path(__file__).parents[1]

SHARE = 0.2
"""Of the largest scenes: reading one takes from 5 to 100 ms, and building it more."""


IN_ITS_OWN = f"""
import json
from tests.deadline_attack import FORMS, MAKERS, TIMES, late
asked = [(kind, form, time) for kind in MAKERS for form in FORMS for time in TIMES]
print(json.dumps([(*one, late(*one[:2], {SHARE} * one[2], again=1, share={SHARE})) for one in asked]))
"""
"""Asks in every way, in a process in which nobody else has left what the collector would have to look through."""


def test_answers_come_in_time() -> None:
    done = subprocess.run([sys.executable, "-c", IN_ITS_OWN], check=True, capture_output=True, text=True, cwd=HOUSE)
    told = json.loads(done.stdout)
    assert len(told) == len(MAKERS) * len(FORMS) * len(TIMES)
    missed = [one for one in told if any(too_late(seconds, SHARE * one[2]) for seconds, _ in one[3])]
    assert missed == []


def test_what_a_robot_holds_is_built_in_time() -> None:
    """Building it takes some seconds, and goes on by itself."""
    mesh = triangles(60_000)["obstacles"][0]
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
    began = time.process_time()
    reply = guidefield.answer(asked)
    assert not too_late(time.process_time() - began - 0.3, 0.3)
    assert isinstance(reply, guidefield.PlanReply)
    assert (reply.status.name, reply.status.details["preparing"]) == ("TIMED_OUT", "what the robot holds was built")
