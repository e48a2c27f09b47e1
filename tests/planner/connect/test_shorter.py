"""Connections made shorter round by round: never longer, ended by the deadline."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.deadline import Deadline
from guidefield.errors import Status
from guidefield.planner.connect import tree_search
from guidefield.planner.connect.connect import (
    LEAST_SHORTER,
    ShortenedPath,
    ShorteningRounds,
    connect,
    shorten_path,
)
from guidefield.planner.connect.tree_search import sources_of
from guidefield.planner.motion.timing import length_of
from tests.planner.connect.test_connect import wall_between
from tests.planner.problems import densely_free, problem
from tests.robots import box_arm, group, grouped

COARSE = 32.0


def first_path(seed: int = 0) -> tuple:
    made, start, goal = wall_between()
    rng = np.random.default_rng(seed)
    found = tree_search.grow(made.lanes, start[None], goal[None], COARSE, 0.0, rng, Deadline())
    assert found.path is not None
    return made, found.path


def improved(number: int, accepted: bool = True, seed: int = 0, **deadline: object) -> tuple[ShortenedPath, np.ndarray]:
    made, path = first_path()
    bounded = problem("panda", made.scene, deadline=Deadline(**deadline))
    rounds, rng = ShorteningRounds(number, COARSE, 0.0), np.random.default_rng(seed)
    return shorten_path(bounded, path, path[-1:], rounds, rng, lambda _: accepted), path


def test_more_rounds_make_no_longer_paths_with_the_same_ends() -> None:
    lengths = []
    for number in (0, 1, 3, 10):
        better, path = improved(number)
        np.testing.assert_array_equal(better.path[[0, -1]], path[[0, -1]])
        lengths.append(length_of(better.path, np.ones(7)))
        assert better.rounds == number
    assert lengths[0] == length_of(path, np.ones(7))
    assert (np.diff(lengths) <= 0.0).all()
    assert lengths[-1] < (1.0 - LEAST_SHORTER) * lengths[0]


@pytest.mark.parametrize("stop", [{"at": 0.0}, {"is_cancelled": lambda: True}])
def test_a_spent_budget_ends_the_rounds_and_keeps_the_path(stop: dict[str, object]) -> None:
    better, path = improved(1_000_000, **stop)
    assert better.path is path
    assert better.rounds == 0
    assert "time ended them" in better.message


def test_a_connection_that_is_asked_for_more_is_shorter_and_certified() -> None:
    made, start, goal = wall_between()
    asked = problem("panda", made.scene, optimization_iterations=8)
    plain, more = (connect(one, start, goal[None], np.random.default_rng(2)) for one in (made, asked))
    assert more.status is Status.SUCCESS
    assert length_of(more.path, np.ones(7)) <= length_of(plain.path, np.ones(7))
    assert "shorter in 8 rounds" in more.message
    assert "rounds" not in plain.message
    assert densely_free(asked, more.path)


@settings(deadline=None, max_examples=18)
@given(st.integers(0, 10_000), st.floats(1.0, 1.8), st.booleans())
def test_a_point_on_a_path_that_is_short_enough_is_in_the_box(seed: int, more: float, wraps: bool) -> None:
    planned = grouped(box_arm("continuous x oblique-continuous slide", 4)) if wraps else group("panda")
    rng, sources = np.random.default_rng(seed), sources_of(planned)
    start, goal, via = (planned.chart(planned.random(rng)) for _ in range(3))
    goal, units = planned.unwrapped(goal, start), planned.units
    via = start + rng.random() * (planned.unwrapped(via, start) - start)
    length = sum(np.linalg.norm((b - planned.unwrapped(a, b)) / units) for a, b in ((start, via), (goal, via)))
    box = sources.between((start / units)[None], (goal / units)[None], more * length).sampling
    above = via / units - box.lower
    turns = box.period > 0.0
    above[turns] %= box.period[turns]
    assert (above >= -1e-9).all()
    assert (above <= box.width + 1e-9).all()
    assert (box.width <= sources.sampling.width + 1e-9).all()
