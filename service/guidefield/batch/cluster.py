"""Answer a batch over a Ray cluster: the same answers, asked again where a node is lost. Needs ``guidefield[ray]``."""

from __future__ import annotations

import functools
import re
import socket
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import Any

from guidefield.batch.local import answer_one
from guidefield.batch.results import Item, ItemAnswer, make_crash_answer
from guidefield.engine import Engine
from guidefield.errors import WorkerCrashed
from guidefield.first_start import CannotStart
from guidefield.whole_file import write_whole

AHEAD = 4  # number of requests that are handed over for each core of the cluster
CONNECT_WITHIN = 5.0  # longest time to connect to a cluster [s]
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")  # escape sequences that change a terminal's colour
ATTEMPTS = 3  # the largest number of times that a request is repeated after its node or worker was lost


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
        most = AHEAD * max(1, int(ray.cluster_resources().get("CPU", 1)))
        for item in islice(left, max(0, most - len(asked))):
            asked[remote.remote(item.request, item.recording is not None)] = item
        if not asked:
            return
        done, _ = ray.wait(list(asked), num_returns=1)
        for answer in done:
            item = asked.pop(answer)
            try:
                yield _outcome(item, *ray.get(answer))
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


def _outcome(item: Item, is_reply: bool, payload: bytes, recording: bytes | None) -> ItemAnswer:
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
