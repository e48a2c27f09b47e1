"""The worker between queries: it goes on with what a plan had no time for, until the next query."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from guidefield.pool.pool import Pool
from guidefield.pool.waiting import Task
from tests import worker_setups

PATIENCE = 60.0


@pytest.mark.parametrize("asked_again", [False, True])
def test_a_preparation_goes_on_until_the_next_query(asked_again: bool, tmp_path: Path) -> None:
    (parts := tmp_path / "parts").touch()
    pool = Pool(worker_setups.obedient, workers=1)
    pool.start()
    try:
        assert pool.submit(Task(("go_on", str(parts)), PATIENCE)).result(PATIENCE) == (True, b"goes on")
        if asked_again:
            time.sleep(0.1)
            assert pool.submit(Task(("echo", "next"), PATIENCE)).result(PATIENCE) == (True, b"next")
            done = len(parts.read_bytes())
            assert done < 30
            time.sleep(0.1)
            assert len(parts.read_bytes()) == done
        else:
            until = time.monotonic() + PATIENCE
            while len(parts.read_bytes()) < 30 and time.monotonic() < until:
                time.sleep(0.02)
            assert len(parts.read_bytes()) == 30
    finally:
        pool.close(0.0)
