"""The motion found so far: each stage makes a new one, and what it was made of stays."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from guidefield.errors import Status
from guidefield.planner.path_so_far import PathSoFar
from guidefield.planner.task.stages import Ending
from tests.planner.problems import problem, scene_of

START, MIDDLE, END = np.zeros(2), np.full(2, 0.5), np.ones(2)


def test_it_begins_at_the_start_of_a_problem() -> None:
    made = problem("panda", scene_of())
    found = PathSoFar.at_start(made)
    assert found.path.tolist() == [made.group.chart(made.q_start).tolist()]
    assert (dict(found.crossings), found.proven, found.failure) == ({}, True, None)


def test_going_on_leaves_what_was_there_as_it_was() -> None:
    begun = PathSoFar(np.array([START, MIDDLE]), {0: 1})
    longer = begun.extend(np.array([MIDDLE, END])).with_plane_reached(3)
    assert longer.path.tolist() == [START.tolist(), MIDDLE.tolist(), END.tolist()]
    assert longer.crossings == {0: 1, 3: 2}
    assert begun.path.tolist() == [START.tolist(), MIDDLE.tolist()]
    assert begun.crossings == {0: 1}
    with pytest.raises(dataclasses.FrozenInstanceError):
        begun.path = longer.path


def test_a_path_is_proven_if_all_of_it_is() -> None:
    begun, more = PathSoFar(START[None]), np.array([START, END])
    assert begun.extend(more).proven
    assert not begun.extend(more, proven=False).proven
    assert not begun.extend(more, proven=False).extend(more[::-1]).proven


def test_one_that_failed_goes_as_far_as_it_went() -> None:
    begun = PathSoFar(np.array([START, END]), {0: 1})
    failure = Ending(Status.PLANNING_FAILED, "nothing leads on")
    failed = begun.with_failure(failure)
    assert failed.failure is failure
    assert failed.path is begun.path
    assert failed.crossings == begun.crossings
    again = failed.back_at_start()
    assert (again.path.tolist(), dict(again.crossings), again.failure) == ([START.tolist()], {}, None)
