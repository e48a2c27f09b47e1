"""Rounds in one kernel are the rounds that are made step by step."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.planner.guide.guide import FIRST_STEP, inset_of, margin_at
from guidefield.planner.guide.guided_path import GuidedPath
from guidefield.planner.guide.rounds import Aim, Attempt, Made, Projected, Round, approach, rounds
from tests.planner.problems import seed_problem

ATTEMPT = Attempt(Projected(), FIRST_STEP)


@pytest.mark.parametrize("title", ["seed_c_blocked", "seed_d_passage_3", "seed_e_L_6"])
def test_the_same_way_to_a_plane(title: str) -> None:
    made = seed_problem(title)
    plane = made.guide_planes[0]
    aim = Aim(plane, inset_of(made, plane))
    walkers = [GuidedPath(made, made.q_start, margin_at(made, made.q_start), 0) for _ in range(2)]
    at_once: list[Made] = []
    while not at_once or at_once[-1].ended is Round.NEARER:
        at_once += rounds(walkers[0], aim, ATTEMPT)
    one_by_one = []
    while not one_by_one or one_by_one[-1].ended is Round.NEARER:
        before = aim.distance(walkers[1].tip)
        one_by_one.append(Made(approach(walkers[1], aim, ATTEMPT), before, aim.distance(walkers[1].tip)))
    assert at_once[-1].ended is Round.ARRIVED
    assert [made.ended for made in at_once] == [made.ended for made in one_by_one]
    for a, b in zip(at_once, one_by_one, strict=True):
        np.testing.assert_allclose((a.before, a.after), (b.before, b.after), atol=1e-9)
    np.testing.assert_allclose(walkers[0].path, walkers[1].path, atol=1e-8)
