"""A slice of `tools/attack_deadlines`: answers come in time however large what is given, and however it is given."""

from __future__ import annotations

import time

import pytest

import guidefield
from tests.deadline_attack import FORMS, MAKERS, SMALL, TIMES, late, too_late, triangles

SHARE = 0.2
"""Of the largest scenes: reading one takes from 5 to 100 ms, and building it more."""


@pytest.mark.parametrize("allowed", TIMES)
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", MAKERS)
def test_an_answer_comes_in_time(kind: str, form: str, allowed: float) -> None:
    for seconds, ended in late(kind, form, allowed * SHARE, again=1, share=SHARE):
        assert not too_late(seconds, allowed), ended


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
