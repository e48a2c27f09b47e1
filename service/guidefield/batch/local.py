"""Answer a batch over worker processes of this machine, or render its recordings; `answer_one` is for clusters, too."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, wait
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TypeVar

from guidefield.batch.results import Item, ItemAnswer, make_crash_answer
from guidefield.engine import Engine
from guidefield.errors import GuidefieldError, WorkerCrashed, strip_path
from guidefield.first_start import CannotStart
from guidefield.messages import codec
from guidefield.messages.replies import make_error_reply
from guidefield.messages.requests import CertifyRequest, MotionRequest, PlanRequest
from guidefield.pool.pool import Pool
from guidefield.pool.process import Call, Setup, Work
from guidefield.pool.waiting import BACKSTOP, LONGEST_WORK, Answer, Limits, Task
from guidefield.rendering import Renderings
from guidefield.stores.recordings import Recordings


def answer_one(engine: Engine, request: bytes, record_to: Path | None, *, deferred: bool = False) -> tuple[bool, bytes]:
    """Return whether there is a reply to a JSON request, not an error, and its JSON; deferred, log the recording."""
    try:
        decoded = codec.decode_request(request)
        if record_to is not None and isinstance(decoded, MotionRequest):
            record_to.parent.mkdir(parents=True, exist_ok=True)
            return True, codec.encode(engine.answer(decoded, record_to=record_to, deferred=deferred))
        return True, codec.encode(engine.answer(decoded))
    except GuidefieldError as error:
        return False, codec.encode(make_error_reply(error))


def find_longest_time(request: bytes) -> float:
    """Return the longest time that a worker may take for a request [s]."""
    try:
        decoded = codec.decode_request(request)
    except GuidefieldError:
        return LONGEST_WORK
    if isinstance(decoded, PlanRequest):
        return decoded.allowed_planning_time + BACKSTOP
    return decoded.allowed_time + BACKSTOP if isinstance(decoded, CertifyRequest) else LONGEST_WORK


AHEAD = 4  # requests handed over for each worker: with fewer a worker may wait, with more they fill memory
LOOK_UP = 0.5  # period of waking while waiting for results: a Ctrl-C that another thread takes doesn't wake it [s]

_Job = TypeVar("_Job")


def _prepare_answers() -> Work:
    """Set a worker process up, which like the command line may read local files: warm an engine up."""
    logging.basicConfig(level=logging.WARNING)
    engine = Engine()
    engine.warm_up()

    def answer_item(item: Item, _call: Call) -> Answer:
        return answer_one(engine, item.request, item.recording, deferred=True)

    return answer_item


def _prepare_rendering(folder: Path) -> Work:
    logging.basicConfig(level=logging.ERROR)
    recordings, renderings = Recordings(folder), Renderings()

    def render(name: str, _call: Call) -> Answer:
        try:
            renderings.render(recordings, name, whole=True)
        except OSError as error:
            return False, strip_path(error).encode()
        return True, b""

    return render


def render_over_workers(folder: Path, workers: int) -> Iterator[str | None]:
    """Render the recordings of a folder from their logs; yield why each isn't rendered yet, None if it is."""
    names = Recordings(folder).list_owed()
    tasks = (Task(name, LONGEST_WORK) for name in names)
    for _, task in _over_pool(partial(_prepare_rendering, folder), zip(names, tasks, strict=True), workers):
        try:
            done, why = task.result()
        except WorkerCrashed as error:
            yield error.message
        else:
            yield None if done else why.decode()
    Recordings(folder).sweep_shared(unused=0.0)


def answer_over_workers(items: Iterable[Item], workers: int) -> Iterator[ItemAnswer]:
    """Yield answers to requests in the order in which they come; of recordings only logs, see `render_over_workers`."""
    tasks = ((item, Task(item, find_longest_time(item.request), size=len(item.request))) for item in items)
    for item, task in _over_pool(_prepare_answers, tasks, workers):
        yield _outcome(item, task)


def _over_pool(setup: Setup, tasks: Iterable[tuple[_Job, Task]], workers: int) -> Iterator[tuple[_Job, Task]]:
    """Have workers do tasks; yield each with its job when done; raises CannotStart if no worker can be prepared."""
    pool = Pool(setup, workers=workers, limits=Limits(tasks=AHEAD * workers, tasks_of_client=AHEAD * workers))
    pool.start()
    try:
        _await(pool)
        left, asked = iter(tasks), dict[Task, _Job]()
        while True:
            for job, task in islice(left, AHEAD * workers - len(asked)):
                asked[pool.submit(task)] = job
            if not asked:
                return
            for done in wait(asked, LOOK_UP, FIRST_COMPLETED).done:
                assert isinstance(done, Task), "they are what was asked"
                yield asked.pop(done), done
    finally:
        pool.close(0.0)


def _await(pool: Pool) -> None:
    try:
        while not pool.ready(1.0):
            pass
    except RuntimeError as error:
        raise CannotStart(str(error)) from None


def _outcome(item: Item, task: Task) -> ItemAnswer:
    try:
        return ItemAnswer(item, *task.result())
    except WorkerCrashed as error:
        return make_crash_answer(item, error)
