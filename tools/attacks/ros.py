"""Send payloads, whole and broken, to a service's ROS services: exactly one answer to each, and the service lives on.

Usage: tools/attack ros [--payloads N] [--seed K] [--seconds S]

A service of its own is started with --ros. Payloads are requests with fields or bytes changed; attachments are right,
wrong, absurdly long or missing. A payload that can be read has to be answered by a response, any other by an error.
Exit code 0: each got exactly one answer of the right kind, no worker was lost, and the memory stayed bounded.
"""

from __future__ import annotations

import argparse
import json
import queue
import random
import threading
import time
from collections import Counter

import zenoh

from attacks.ros_payloads import SERVICES, TYPES, Sent, draw_payload
from guidefield.cli.serving import service_in_child
from guidefield.endpoint.ros.rmw_zenoh import Entity, Kind, Unreadable
from guidefield.system import resident

AT_ONCE = 24
"""Queries that wait for an answer."""
ANSWERED_WITHIN = 60.0
MOST_MEMORY = 2 << 30
"""Of the service's own process, at the end [bytes]."""


class Judge:
    """Sends payloads and judges the answers."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._keys = {
            name: Entity(Kind.SERVICE, name, kind, TYPES.type_hash(kind)).key(0) for name, kind in SERVICES.items()
        }
        self.counts: Counter[str] = Counter()
        self.faults: list[str] = []
        self._lock = threading.Lock()

    def work(self, waiting: queue.Queue[Sent | None]) -> None:
        """Send what waits, until there is no more."""
        while (sent := waiting.get()) is not None:
            told = self._judged(sent)
            with self._lock:
                self.counts[told] += 1
                if told.startswith("FAULT"):
                    self.faults.append(f"{told} {sent.name} {sent.payload[:4000].hex()}")

    def _judged(self, sent: Sent) -> str:
        answers = list(
            self._session.get(
                self._keys[sent.name],
                payload=sent.payload,
                attachment=sent.attachment,
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
                timeout=ANSWERED_WITHIN,
            )
        )
        if len(answers) != 1:
            return f"FAULT: {len(answers)} answers"
        (answer,) = answers
        try:
            TYPES.read(sent.payload, f"{SERVICES[sent.name]}_Request")
        except Unreadable:
            return "unreadable" if answer.ok is None else "FAULT: a response to what can't be read"
        if answer.ok is None:
            return f"FAULT: {answer.err.payload.to_string()}"
        response = TYPES.read(answer.ok.payload.to_bytes(), f"{SERVICES[sent.name]}_Response")
        code = getattr(getattr(response, "motion_plan_response", response), "error_code", None)
        if code is None:
            return "answered"
        return "FAULT: a bug" if "a bug in guidefield" in code.message else f"code {code.val}"


def run(arguments: list[str]) -> int:
    """Fuzz, and say what came of it."""
    parser = argparse.ArgumentParser(prog="tools/attack ros", description=__doc__.partition("\n")[0])
    parser.add_argument("--payloads", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=7200.0, help="at most so long")
    options = parser.parse_args(arguments)
    with service_in_child(print, workers=2, options=("--ros",)) as service:
        return _fuzz(service.endpoint, service.process.pid, options)


def _fuzz(endpoint: str, pid: int, options: argparse.Namespace) -> int:
    config = zenoh.Config.from_json5(json.dumps({"mode": "client", "connect": {"endpoints": [endpoint]}}))
    rng, begun = random.Random(options.seed), time.monotonic()  # noqa: S311 - no secret
    with zenoh.open(config) as session:
        judge, waiting = Judge(session), queue.Queue[Sent | None](AT_ONCE)
        threads = [threading.Thread(target=judge.work, args=(waiting,)) for _ in range(AT_ONCE)]
        for thread in threads:
            thread.start()
        for number in range(options.payloads):
            if time.monotonic() - begun > options.seconds:
                break
            waiting.put(draw_payload(rng))
            if number % 5000 == 4999:
                print(f"{number + 1} sent in {time.monotonic() - begun:.0f} s, {len(judge.faults)} faults", flush=True)
        for _ in threads:
            waiting.put(None)
        for thread in threads:
            thread.join()
        (told,) = session.get("guidefield/local/info?brief", timeout=ANSWERED_WITHIN)
        crashes, memory = json.loads(told.ok.payload.to_bytes())["counters"]["crashes"], resident(pid)
    print(f"\n{judge.counts.total()} payloads in {time.monotonic() - begun:.0f} s; {len(judge.faults)} faults")
    print(f"workers lost: {crashes}; memory of the service's process: {memory >> 20} MiB")
    for name, count in judge.counts.most_common():
        print(f"  {name:40s} {count}")
    for fault in judge.faults[:20]:
        print(fault)
    return int(bool(judge.faults) or crashes > 0 or memory > MOST_MEMORY)
