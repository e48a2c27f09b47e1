"""A batch over worker processes of this machine."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, wait
from dataclasses import dataclass
from itertools import islice

from guidefield.batch.answering import CannotWork, answered, seconds_for
from guidefield.batch.request_file import Item
from guidefield.batch.results import Outcome, crashed
from guidefield.engine import Engine
from guidefield.errors import WorkerCrashed
from guidefield.pool.pool import Pool
from guidefield.pool.process import Call
from guidefield.pool.waiting import Answer, Limits, Task

AHEAD = 4
"""How many requests are handed over for each worker."""

LOOK_UP = 0.5
"""How often who waits for results looks up: a Ctrl-C that another thread takes doesn't wake it [s]."""


@dataclass(frozen=True)
class BatchSetup:
    """Prepares a worker of a batch; like the command line it may read local files."""

    def __call__(self) -> BatchWorker:
        """In a worker process: warm an engine up."""
        logging.basicConfig(level=logging.WARNING)
        engine = Engine()
        engine.warm_up()
        return BatchWorker(engine)


@dataclass(frozen=True)
class BatchWorker:
    """Answers the requests of a batch."""

    engine: Engine

    def __call__(self, item: Item, _call: Call) -> Answer:
        """Whether there is a reply, or else an error; and its JSON."""
        return answered(self.engine, item.request, item.recording)


def over_workers(items: Iterable[Item], workers: int) -> Iterator[Outcome]:
    """What comes of requests, in the order in which it does.

    Raises:
        CannotWork: if no worker can be prepared.
    """
    pool = Pool(BatchSetup(), workers=workers, limits=Limits(tasks=AHEAD * workers, tasks_of_client=AHEAD * workers))
    pool.start()
    try:
        _await(pool)
        left, asked = iter(items), dict[Task, Item]()
        while True:
            for item in islice(left, AHEAD * workers - len(asked)):
                asked[pool.submit(Task(item, seconds_for(item.request), size=len(item.request)))] = item
            if not asked:
                return
            for task in wait(asked, LOOK_UP, FIRST_COMPLETED).done:
                assert isinstance(task, Task), "they are what was asked"
                yield _outcome(asked.pop(task), task)
    finally:
        pool.close(0.0)


def _await(pool: Pool) -> None:
    try:
        while not pool.ready(1.0):
            pass
    except RuntimeError as error:
        raise CannotWork(str(error)) from None


def _outcome(item: Item, task: Task) -> Outcome:
    try:
        return Outcome(item, *task.result())
    except WorkerCrashed as error:
        return crashed(item, error)
