"""How late a service answers large requests that allow little time: what `tools/attack deadlines` asks."""

import contextlib
import gc
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from guidefield.endpoint.endpoint import LATE, LATE_SHARE, Endpoint
from guidefield.endpoint.monitoring import Condition, no_trace
from guidefield.endpoint.streams import Streams
from guidefield.engines import EngineSetup
from guidefield.errors import GuidefieldError
from guidefield.handlers.info import Rules
from guidefield.messages import keys
from guidefield.messages.codec import Encoding
from guidefield.messages.keys import Query
from guidefield.messages.service import Health
from guidefield.pool.pool import Pool
from guidefield.stores.runs import RunDatabase
from tests.deadline_requests import MAKERS, Made

TIMES = (0.1, 0.3, 1.0)  # allowed [s]

SLACK, SHARE = 0.05, 0.05  # how late an answer may be [s], and by which share of what it allows

SMALL = {"robot": "panda", "scene": "table", "goal": {"type": "joints", "positions": {"panda_joint1": 0.4}}}

PATIENCE = 300.0  # longer than anything takes here [s]

Ask = Callable[[bytes], tuple[float, str]]
"""Asks the service; returns the time until the answer without what the machine took of it [s], and how it ended."""

SLEEPER = """
import sys, time
for line in sys.stdin:
    due = float(line)
    time.sleep(max(0.0, due - time.monotonic()))
    print(max(0.0, time.monotonic() - due), flush=True)
"""
"""A process that tells how late it was woken at each time that it was given, on a busy machine."""


@contextlib.contextmanager
def service(workers: int = 1) -> Iterator[Ask]:
    """A service without network and disk: its endpoint, and workers that have answered a small plan."""
    with tempfile.TemporaryDirectory() as folder:
        setup = EngineSetup(Path(folder), "attacked")
        runs = RunDatabase(Path(folder))
        runs.writer.submit = _written_at_once
        pool = Pool(setup, workers=workers)
        condition = Condition()
        condition.now = Health(state="ready")
        endpoint = Endpoint(
            setup,
            setup.engines(runs),
            runs,
            pool,
            Streams(setup, 0, 0, _publish),
            _publish,
            no_trace,
            condition,
            Rules(),
            False,
            lambda: 0,
        )
        pool.start()
        assert pool.ready(PATIENCE)
        sleeper = subprocess.Popen(
            [sys.executable, "-c", SLEEPER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        tell, hear = sleeper.stdin.write, sleeper.stdout.readline

        def ask(payload: bytes) -> tuple[float, str]:
            tag = payload[:30].partition(b'{"type":"')[2].partition(b'"')[0].decode()
            key = {"": "plan", "certify": "certify"}.get(tag, "kinematics")
            ended: Future[float] = Future()
            query = Query((key,), {}, payload, Encoding.JSON)
            head = keys.decode_run_head(query) or keys.decode_work_head(query)
            received, worked = time.monotonic(), time.process_time()
            tell(f"{received + head.allowed + LATE + LATE_SHARE * head.allowed}\n")
            answer = endpoint.ask(query, received)
            came = time.monotonic()
            waited = came - received - (time.process_time() - worked)  # while no thread of ours ran
            answer.add_done_callback(lambda _: ended.set_result(time.monotonic()))
            try:
                is_reply, told = answer.result(PATIENCE)
            except GuidefieldError as error:
                return ended.result(PATIENCE) - received, f"{type(error).__name__}: {error.message[:80]}"
            finally:
                machine = float(hear()) + max(0.0, min(waited, came - received - head.allowed))
            decoded = msgspec.json.decode(told)
            status = decoded.get("status", {"name": "answered"}) if is_reply else {"name": decoded["name"]}
            outcome = f"{status['name']} {status.get('details', {}).get('preparing', '')}".strip()
            return ended.result(PATIENCE) - received - machine, outcome

        try:
            for _ in range(workers):
                ask(msgspec.json.encode(SMALL | {"recording": "off"}))
            yield ask
        finally:
            sleeper.kill()
            pool.close(0.0)
            endpoint.close()
            runs.close()


def _publish(*_told: Any) -> None:
    pass


def _written_at_once(*_write: Any, **_options: Any) -> Future[Any]:
    done: Future[Any] = Future()
    done.set_result(None)
    return done


def late(ask: Ask, kind: str, form: str, allowed: float, again: int = 0, share: float = 1.0) -> list[tuple[float, str]]:
    """Ask for something large that was never seen, and again at once.

    Args:
        ask: Asks the service.
        kind: What it has many of.
        form: How it is written.
        allowed: What each answer is allowed [s].
        again: How often it is asked for again.
        share: How large it is, of the most that there may be of a kind.

    Returns:
        Seconds after what was allowed, and how the answer ended, of each.
    """
    payload = _payload(kind, form, allowed, share)
    gc.collect()  # a service has no such garbage to look for
    answers = [ask(payload) for _ in range(1 + again)]
    return [(seconds - allowed, ended) for seconds, ended in answers]


def _payload(kind: str, form: str, allowed: float, share: float) -> bytes:
    made, most = MAKERS[kind]
    asked = made(round(share * most))
    asked["allowed_time" if "type" in asked else "allowed_planning_time"] = allowed
    return FORMS[form](asked)


def too_late(seconds: float, allowed: float) -> bool:
    """Whether an answer that came so long after its time was up [s] came too late."""
    return seconds > SLACK + SHARE * allowed


def _with(made: Any, change: Callable[[str, np.ndarray], Any], name: str = "") -> Any:
    """A request with its arrays as something else."""
    if isinstance(made, dict):
        return {field: _with(value, change, field) for field, value in made.items()}
    if isinstance(made, list):
        return [_with(one, change, name) for one in made]
    return change(name, made) if isinstance(made, np.ndarray) else made


def _listed(made: Made) -> Made:
    return _with(made, lambda _, array: array.tolist())


def _packed(made: Made) -> Made:
    """Where points and triangles may be packed they are."""

    def packed(one: Any) -> Any:
        if isinstance(one, list):
            return [packed(each) for each in one]
        if not isinstance(one, dict):
            return one
        changed = {field: packed(value) for field, value in one.items()}
        if one.get("type") in ("mesh", "point_cloud"):
            for field in {"vertices", "points"} & one.keys():
                changed[field] = {"float32": one[field].astype("<f4").tobytes()}
            if "triangles" in one:
                changed["triangles"] = {"uint32": one["triangles"].astype("<u4").tobytes()}
        return changed

    return _listed(packed(made))


FORMS: dict[str, Callable[[Made], bytes]] = {
    "json": lambda made: msgspec.json.encode(_listed(made)),
    "packed": lambda made: msgspec.json.encode(_packed(made)),
}
"""How a request is written: JSON of lists, and of packed arrays."""
