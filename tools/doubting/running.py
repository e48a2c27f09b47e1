"""Units of work in processes of their own, one after the other, until enough is done."""

from __future__ import annotations

import multiprocessing
import time
import traceback
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import Any

from pebble import ProcessPool

from doubting import tally, unit

LONGEST = 1800.0
"""A unit that takes longer hangs [s]."""
UNITS = 25
"""A process does so many units; then a new one begins with empty caches."""


def run(
    folder: Path,
    seed: int,
    plans: int | None,
    until: float | None,
    workers: int,
    work: Callable[[int, Path], tally.Unit] = unit.work,
) -> int:
    """Go on where a folder's tally stands.

    Args:
        folder: Where units and what is found are kept.
        seed: Of the first unit.
        plans: Until so many plans are kept; None: no matter how many.
        until: No unit begins after this, on the clock of `time.monotonic` [s]; None: no matter when.
        workers: How many processes.
        work: Does the unit of a seed, in a process of its own.

    Returns:
        0, or 1 if there is a disagreement.
    """
    folder.mkdir(parents=True, exist_ok=True)
    kept = tally.units(folder)
    done, following = {one.seed for one in kept}, seed
    planned = sum(one.counts.get("plans", 0) for one in kept)
    running: dict[Any, tuple[int, float]] = {}
    # not forked: threads of numba and Zenoh don't survive that
    with ProcessPool(workers, max_tasks=UNITS, context=multiprocessing.get_context("spawn")) as pool:
        while True:
            open_ = (until is None or time.monotonic() < until) and (plans is None or planned < plans)
            while open_ and len(running) < workers:
                while following in done:
                    following += 1
                done.add(following)
                running[pool.schedule(work, args=(following, folder), timeout=LONGEST)] = following, time.monotonic()
            if not running:
                break
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                one = _outcome(future, *running.pop(future))
                tally.append(folder, one)
                planned += one.counts.get("plans", 0)
                _tell(one, planned)
    print(tally.format_totals(folder))
    return int(any(one.found for one in tally.units(folder)))


def _outcome(future: Future[Any], seed: int, began: float) -> tally.Unit:
    """A unit that is done; one that failed, hung or ended its process is a disagreement that has only its seed."""
    try:
        done: tally.Unit = future.result()
    except Exception as error:  # whatever it is, it is told, and the run goes on
        traceback.print_exception(error)
        said = f"unit {seed}: {type(error).__name__} {error}"
        return tally.Unit(seed, time.monotonic() - began, {"disagreements": 1}, [said], tally.commit())
    return done


def _tell(one: tally.Unit, planned: int) -> None:
    counts = one.counts
    print(
        f"unit {one.seed}: {counts.get('plans', 0)} plans, {counts.get('mutants', 0)} mutants in {one.seconds:.0f} s;"
        f" {planned} plans in all" + "".join(f"\n  {file}" for file in one.found),
        flush=True,
    )
