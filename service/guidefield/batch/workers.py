"""Answer a batch over worker processes of this machine, or a Ray cluster (``guidefield[ray]``); render recordings.

Answers may come in any order: `results.py` files them by the line of the request. `AHEAD` and `AHEAD_OF_CORE` cost time
or memory alone.
"""

from __future__ import annotations

import functools
import logging
import re
import socket
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, wait
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any, TypeVar

from guidefield.batch.results import Item, ItemAnswer, make_crash_answer
from guidefield.engine import Engine
from guidefield.errors import GuidefieldError, WorkerCrashed, strip_path
from guidefield.first_start import CannotStart
from guidefield.messages import codec
from guidefield.messages.replies import make_error_reply
from guidefield.messages.requests import CertifyRequest, KinematicsRequest, MotionRequest, PlanRequest
from guidefield.pool.pool import Pool
from guidefield.pool.process import Call, Setup, Work
from guidefield.pool.waiting import BACKSTOP, LONGEST_WORK, Answer, Limits, Task
from guidefield.rendering import Renderings
from guidefield.stores.recordings import Recordings
from guidefield.whole_file import write_whole


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
    """Return the longest time that a worker may take for a request, which loads and prepares before its time [s]."""
    try:
        decoded = codec.decode_request(request)
    except GuidefieldError:
        return LONGEST_WORK
    if isinstance(decoded, PlanRequest):
        return max(LONGEST_WORK, decoded.allowed_planning_time + BACKSTOP)
    if isinstance(decoded, CertifyRequest | KinematicsRequest):
        return max(LONGEST_WORK, decoded.allowed_time + BACKSTOP)
    return LONGEST_WORK


AHEAD = 4  # requests handed over for each worker: with fewer one may wait, with more they fill memory
BYTES_AHEAD = 1 << 28  # size of requests handed over, beyond which there is but one for each worker [bytes]
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
    most = AHEAD * workers
    pool = Pool(setup, workers=workers, limits=Limits(most, most, bytes=sys.maxsize, bytes_of_client=sys.maxsize))
    pool.start()
    try:
        _await(pool)
        left, asked = iter(tasks), dict[Task, _Job]()
        while True:
            while len(asked) < workers or (len(asked) < most and sum(task.size for task in asked) < BYTES_AHEAD):
                if (following := next(left, None)) is None:
                    break
                job, task = following
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


AHEAD_OF_CORE = 4  # number of requests that are handed over for each core of the cluster
CONNECT_WITHIN = 5.0  # longest time to connect to a cluster [s]
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")  # escape sequences that change a terminal's colour
ATTEMPTS = 3
"""How often Ray repeats a request whose worker was lost, and how often one that Ray gave up is handed over again.

So a request that kills its worker is tried (`ATTEMPTS` + 1)^2 times before its answer is CRASH.
"""


def answer_over_cluster(items: Iterable[Item], address: str) -> Iterator[ItemAnswer]:
    """Yield outcomes as they come from a Ray cluster with guidefield on every node: an address, ``auto`` or ``local``.

    Raises:
        CannotStart: if Ray isn't installed, or there is no cluster there.
    """
    try:
        import ray
    except ImportError:
        raise CannotStart("a batch over a cluster needs Ray: pip install 'guidefield[ray]'") from None
    _require_listening(address)
    try:
        ray.init(address=address, log_to_driver=False, configure_logging=False)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise CannotStart(f"there is no Ray cluster at {address!r}: {_COLOUR.sub('', str(error))}") from None
    try:
        yield from _answer_items(ray, items)
    finally:
        ray.shutdown()


def _require_listening(address: str) -> None:
    """Raise CannotStart if nobody listens at a host and port: Ray itself would try for minutes."""
    host, _, port = address.rpartition(":")
    if not (host and port.isdecimal()):
        return
    try:
        socket.create_connection((host, int(port)), CONNECT_WITHIN).close()
    except (OSError, OverflowError) as error:
        raise CannotStart(f"there is no Ray cluster at {address!r}: {error}") from None


def _answer_items(ray: Any, items: Iterable[Item]) -> Iterator[ItemAnswer]:
    remote = ray.remote(num_cpus=1, max_retries=ATTEMPTS)(_answer)
    left, asked, lost = iter(items), dict[Any, Item](), Counter[int]()
    while True:
        most = AHEAD_OF_CORE * max(1, int(ray.cluster_resources().get("CPU", 1)))
        for item in islice(left, max(0, most - len(asked))):
            asked[remote.remote(item.request, item.recording is not None)] = item
        if not asked:
            return
        done, _ = ray.wait(list(asked), num_returns=1)
        for answer in done:
            item = asked.pop(answer)
            try:
                yield _remote_outcome(item, *ray.get(answer))
            except ray.exceptions.RayError as error:
                lost[item.line] += 1
                if lost[item.line] <= ATTEMPTS:  # the answer was lost with its node, not the request
                    left = chain([item], left)
                else:
                    yield make_crash_answer(item, WorkerCrashed(_why(error)))


def _why(error: Exception) -> str:
    cause = getattr(error, "cause", None)
    if isinstance(cause, Exception):
        return f"a node can't answer: {type(cause).__name__}: {cause}; guidefield must be installed on every node"
    return f"the worker of this request was lost: {_COLOUR.sub('', str(error)).strip().partition(chr(10))[0]}"


def _remote_outcome(item: Item, is_reply: bool, payload: bytes, recording: bytes | None) -> ItemAnswer:
    if recording is not None and item.recording is not None:
        item.recording.parent.mkdir(parents=True, exist_ok=True)
        write_whole(item.recording, recording)
    return ItemAnswer(item, is_reply, payload)


@functools.cache
def _engine() -> Engine:
    """The engine of a worker process of the cluster, warm after its first request."""
    engine = Engine()
    engine.warm_up()
    return engine


def _answer(request: bytes, record: bool) -> tuple[bool, bytes, bytes | None]:
    with tempfile.TemporaryDirectory(prefix="guidefield-") as folder:
        recording = Path(folder) / "run.rrd"
        is_reply, payload = answer_one(_engine(), request, recording if record else None)
        return is_reply, payload, recording.read_bytes() if recording.exists() else None
