"""The cost of kept runs: the wait of a plan beside its own work, and a page of the list, with few and many of them."""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from benchmarks.doors.costs import read_costs
from guidefield import Client, JointsGoal, PlanReply, PlanRequest, answer
from guidefield.cli.serving import service_in_child
from guidefield.messages import codec
from guidefield.messages.identities import PLAIN
from guidefield.stores.run_rows import NewRun
from guidefield.stores.runs import Retention, RunDatabase

PLAN = PlanRequest("panda", "table", JointsGoal({"panda_joint1": 0.1}), guide_planes=[], recording="off")
MOST_ROWS = 20
"""Rows of the reply that is kept: lists don't depend on it, and 100,000 whole ones take 5 GB."""
WARM = 5
"""Plans that don't count."""


def fill(count: int, data: Path) -> None:
    """Keep so many runs in a data folder: one in ten failed."""
    reply = answer(PLAN)
    assert isinstance(reply, PlanReply)
    reply = msgspec.structs.replace(reply, path=reply.path[:MOST_ROWS], trajectory=None)
    failed = msgspec.structs.replace(
        reply, status=msgspec.structs.replace(reply.status, code=-1, name="PLANNING_FAILED")
    )
    request, replies = codec.encode(PLAN), (*[codec.encode(reply)] * 9, codec.encode(failed))
    database = RunDatabase(data, Retention(runs=count + 1))
    runs = database.of(PLAIN)
    for number in range(count):
        runs.finish(NewRun(PLAIN, f"kept{number}", "plan", request), replies[number % 10])
    database.close()


def wait_for_plan(client: Client, front: int) -> tuple[float, float]:
    """Plan once; the time beyond the planner's work, and the processor time of the service without its worker [s]."""
    began, work = time.perf_counter(), read_costs(front)[0]
    timing = client.plan(PLAN).timing
    elapsed = time.perf_counter() - began
    return elapsed - (timing.total - timing.queue), read_costs(front)[0] - work


def time_of(ask: Callable[[], object]) -> float:
    """The time that an answer takes [s]."""
    began = time.perf_counter()
    ask()
    return time.perf_counter() - began


def measure(counts: Sequence[int], repeats: int) -> dict[int, np.ndarray]:
    """Ask a service for each number of runs, all in turn, and print a line for each.

    Args:
        counts: How many runs are kept.
        repeats: How often each is asked.

    Returns:
        By the number of runs: the median wait of a plan over Zenoh beyond the planner's own work, the median processor
        time of the service without its worker, and the least times of pages of 100 runs: the newest, some from the
        middle, and those of a filter that one in ten fits [s].
    """
    times: dict[int, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    with contextlib.ExitStack() as opened:
        asked = {}
        for count in counts:
            data = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="guidefield-")))
            fill(count, data)
            keep = ("--keep-runs", str(count + 10 * repeats))
            service = opened.enter_context(service_in_child(lambda _: None, options=keep, data=data))
            client = opened.enter_context(Client.connect(service.endpoint, wait=60.0))
            asked[count] = client, service.process.pid
        for turn in range(repeats + WARM):
            for count, (client, front) in asked.items():
                wait, work = wait_for_plan(client, front)
                pages = {
                    "page": partial(client.runs, limit=100),
                    "middle": partial(client.runs, limit=100, after=str(count // 2 + 1)),
                    "filtered": partial(client.runs, limit=100, status="PLANNING_FAILED"),
                }
                if turn >= WARM:
                    times[count]["wait"].append(wait)
                    times[count]["work"].append(work)
                    for name, page in pages.items():
                        times[count][name].append(time_of(page))
    figures = {
        count: np.array([*(np.median(found[name]) for name in ("wait", "work")), *(min(found[p]) for p in pages)])
        for count, found in times.items()
    }
    print(f"{'kept runs':>10s}{'wait':>10s}{'work':>10s}{'page':>10s}{'middle':>10s}{'filtered':>10s}   [ms]")
    for count, row in figures.items():
        print(f"{count:10d}" + "".join(f"{1e3 * value:10.2f}" for value in row))
    return figures
