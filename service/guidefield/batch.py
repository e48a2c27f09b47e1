"""Many requests at once: their file and its results, answered over worker processes or a Ray cluster; resumable.

Users read `results.jsonl`, and a batch that was ended goes on from it: fields and fingerprints have to stay. Answers
may come in any order: `Results` files them by the line of the request. `AHEAD` and `AHEAD_OF_CORE`, above 0, cost time
or memory alone. The cluster needs ``guidefield[ray]``.
"""

from __future__ import annotations

import fcntl
import functools
import hashlib
import logging
import re
import shutil
import socket
import sys
import tempfile
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, wait
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self, TypeVar

import msgspec

from guidefield.engine import Engine
from guidefield.errors import GuidefieldError, MalformedRequest, Status, WorkerCrashed, strip_path
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

RECORDINGS = "recordings"  # folder of recordings, named by the line of the request; that of stores (kept_runs.py), too
BLANK = 0  # the fingerprint of a line without a request


@dataclass(frozen=True)
class Item:
    """One request of a batch: its line from 1, its text, and its recording's file, if any."""

    line: int
    request: bytes
    recording: Path | None

    @property
    def content(self) -> str:
        """The request's fingerprint in hexadecimal, as results have it: a request that was edited is asked anew."""
        return f"{fingerprint(self.request):016x}"


class RequestFile:
    """The requests of a file, each on a line that isn't blank; a context manager.

    One line at a time is held in memory. What can be read only once, such as a pipe, is copied to a temporary file.

    Attributes:
        fingerprints: A number for the request on each line from 1, or `BLANK`; 8 bytes a line.
    """

    def __init__(self, path: Path) -> None:
        with ExitStack() as opened:
            try:
                self._file: BinaryIO = opened.enter_context(path.open("rb"))
                if not self._file.seekable():
                    copy = opened.enter_context(tempfile.TemporaryFile())
                    shutil.copyfileobj(self._file, copy)
                    self._file = copy
                self.fingerprints = array("Q", [BLANK])
                self.fingerprints.extend(fingerprint(request) if request else BLANK for request in self._lines())
            except OSError as error:
                raise MalformedRequest(
                    f"the requests can't be read: {path.name}: {error.strerror}", path=str(path)
                ) from None
            self._opened = opened.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()

    def __len__(self) -> int:
        """Count the requests."""
        return len(self.fingerprints) - self.fingerprints.count(BLANK)

    def items(self, folder: Path, *, recordings: bool) -> Iterator[Item]:
        """Yield the requests in their order; their recordings go to a folder."""
        for number, request in enumerate(self._lines(), 1):
            if request:
                yield Item(number, request, folder / RECORDINGS / f"{number}.rrd" if recordings else None)

    def _lines(self) -> Iterator[bytes]:
        self._file.seek(0)
        for line in self._file:
            yield line.rstrip(b"\r\n") if line.strip() else b""


def fingerprint(request: bytes) -> int:
    """Return a number for a request, which is never `BLANK`: 64 bits of SHA-256."""
    return int.from_bytes(hashlib.sha256(request).digest()[:8], "big") or 1


RESULTS = "results.jsonl"
LINE_BEGIN = b'{"line":'  # the first field of `_ResultRecord`: so begins a torn line, too
READ_AT_ONCE = 1 << 20  # buffer for the file that is read [bytes]


@dataclass(frozen=True)
class ItemAnswer:
    """The outcome of one request: JSON of its reply, or else of its error."""

    item: Item
    is_reply: bool
    payload: bytes


class _ResultRecord(msgspec.Struct, omit_defaults=True):
    line: int
    request: str
    reply: msgspec.Raw = msgspec.Raw()
    error: msgspec.Raw = msgspec.Raw()


class _AnswerStatus(msgspec.Struct):
    code: int = Status.SUCCESS
    status: _AnswerStatus | None = None

    def outcome(self) -> int:
        """Return the code of a reply's status, or of an error; a reply without a status is a success."""
        return self.code if self.status is None else self.status.code


class _Result(msgspec.Struct):
    line: int
    request: str
    reply: _AnswerStatus | None = None
    error: _AnswerStatus | None = None


class Results:
    """The results of a batch in a folder; a context manager.

    A line is written whole after the request's recording. What a killed process left of a line is cut off, and that
    request is asked again; so is one whose worker crashed, which then has a second line. Nothing is rewritten, and
    nothing is held in memory but 9 bytes for each line of the requests. Results of other requests, such as of a line
    before it was edited, don't count.

    Raises:
        MalformedRequest: if its results can't be understood, or another process adds to them.

    Attributes:
        codes: How often each code was answered, without crashes; a reply without a status counts as a success.
    """

    def __init__(self, folder: Path, requests: RequestFile) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / RESULTS
        self._wanted = requests.fingerprints
        self._answered = bytearray(len(self._wanted))
        self.codes: Counter[int] = Counter()
        self._file = self._path.open("ab")
        try:
            self._lock()
            end = self._read()
            if end < self._file.tell():
                self._file.truncate(end)
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def has(self, item: Item) -> bool:
        """Tell if a request is answered."""
        return bool(self._answered[item.line])

    def add(self, outcome: ItemAnswer) -> None:
        """Write the outcome of a request."""
        item, raw = outcome.item, msgspec.Raw(outcome.payload)
        line = _ResultRecord(item.line, item.content, **{"reply" if outcome.is_reply else "error": raw})
        self._file.write(msgspec.json.encode(line) + b"\n")
        self._file.flush()
        self._note(item.line, msgspec.json.decode(outcome.payload, type=_AnswerStatus).outcome())

    def _lock(self) -> None:
        """Keep other processes out, where the file system has locks."""
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise MalformedRequest(
                f"another process adds to {str(self._path)!r}; wait for it, or choose another folder"
            ) from None
        except OSError:
            return

    def _read(self) -> int:
        """Read all whole lines; return where they end [bytes]."""
        end = 0
        with self._path.open("rb", READ_AT_ONCE) as file:
            for text in file:
                if not text.endswith(b"\n") and text.startswith(LINE_BEGIN[: len(text)]):
                    break  # a killed process was writing it
                end += len(text)
                result = self._decode(text)
                known = 0 < result.line < len(self._wanted) and self._wanted[result.line] != BLANK
                if known and f"{self._wanted[result.line]:016x}" == result.request:
                    self._note(result.line, (result.reply or result.error or _AnswerStatus()).outcome())
        return end

    def _decode(self, text: bytes) -> _Result:
        try:
            return msgspec.json.decode(text, type=_Result)
        except msgspec.DecodeError as error:
            raise MalformedRequest(
                f"{str(self._path)!r} holds something else than the results of a batch ({error}); choose another folder"
            ) from None

    def _note(self, line: int, code: int) -> None:
        if code != Status.CRASH and not self._answered[line]:
            self._answered[line] = True
            self.codes[code] += 1


def make_crash_answer(item: Item, error: WorkerCrashed) -> ItemAnswer:
    """Return the outcome of a request whose worker died."""
    return ItemAnswer(item, False, codec.encode(make_error_reply(error)))


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
# period of waking while waiting for results: a Ctrl-C that another thread takes doesn't wake it [s]
WAKE_INTERVAL_S = 0.5

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
            for done in wait(asked, WAKE_INTERVAL_S, FIRST_COMPLETED).done:
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
