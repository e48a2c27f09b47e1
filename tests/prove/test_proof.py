"""Proofs that a search writes down: complete, small, and without a change to what it finds."""

import numpy as np
import pytest

from guidefield.case_file import curve_of
from guidefield.kernels.prove.kept_distance import LOG_CAPACITY
from guidefield.prove import proof
from guidefield.prove.proof import prove
from guidefield.prove.search import SearchLog, SearchQuery, search
from tests.collision.scenery import panda_in
from tests.referee.cases import straight


@pytest.fixture(scope="module")
def asked() -> tuple:
    world = panda_in("bookshelf")
    start = world.group.to_local(world.group.part_of(world.group.robot.rest))
    end = start + np.linspace(0.3, -0.2, len(start))
    curve = curve_of(straight(world, [start, end]))
    return world, curve, SearchQuery(0.0, spans=[(0.0, 1.0)], samples=np.linspace(0.0, 1.0, 9))


def test_writing_a_proof_down_changes_nothing_that_is_found(asked: tuple) -> None:
    plain, (found, written) = search(*asked), prove(*asked)
    assert (plain.verdict.reason, plain.verdict.evaluations) == (found.verdict.reason, found.verdict.evaluations)
    assert (plain.obstacle, plain.own) == (found.obstacle, found.own)
    assert len(written.segments) == found.verdict.evaluations - 2
    assert len(written.slab_segments) > 50
    assert sum(array.nbytes for name, array in vars(written).items() if name.startswith(("s", "c"))) < 100_000


def test_a_log_without_room_for_all_is_written_again(asked: tuple, monkeypatch: pytest.MonkeyPatch) -> None:
    _, whole = prove(*asked)
    monkeypatch.setattr(proof, "FIRST_ROWS", 8)
    _, again = prove(*asked)
    assert whole is not None
    assert again is not None
    for name, array in vars(whole).items():
        assert np.array_equal(array, getattr(again, name)), name


def test_nothing_is_written_without_room(asked: tuple) -> None:
    log = SearchLog.with_capacity(0)
    search(*asked, log=log)
    assert log.numbers[LOG_CAPACITY] == 0.0
    assert not len(log.rows)


def test_a_motion_that_isnt_free_has_no_proof(asked: tuple) -> None:
    world, curve, goal = asked
    found, written = prove(world, curve, goal._replace(min_clearance=5.0))
    assert not found.verdict.free
    assert written is None
