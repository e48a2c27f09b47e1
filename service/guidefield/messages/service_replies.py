"""Replies about the service and the runs under way.

Names, meanings and defaults of fields are the wire. Docstrings of messages are in docs/wire.md and the schemas: after a
change, `tools/wire_page`.
"""

from __future__ import annotations

from typing import Any, Literal

from guidefield.messages.identities import Quota
from guidefield.messages.served import CodeInfo, KeyInfo
from guidefield.messages.values import Reply


class Histogram(Reply):
    """A histogram of durations: `counts[i]` up to `bounds[i]` [s], the last count beyond; and the sum [s]."""

    bounds: list[float]
    counts: list[int]
    sum: float


class Health(Reply):
    """The health of a service.

    Attributes:
        state: starting: only queries without a worker are answered; ready; ending: no new work begins.
        doing: Its present work in a sentence; empty if it is ready.
    """

    state: Literal["starting", "ready", "ending"] = "ready"
    doing: str = ""


class Disk(Reply):
    """The disk of the data folder: its free space and its size [bytes]."""

    free: int
    total: int


class LimitInfo(Reply):
    """One limit of a service.

    Attributes:
        name: Its name.
        value: Its value.
        unit: Its unit: s, bytes, or the counted things.
        what: The limited quantity, and the consequence of exceeding it.
    """

    name: str
    value: float
    unit: str
    what: str


class DeliveryRule(Reply):
    """One rule by which queries are answered.

    Attributes:
        name: Its subject.
        rule: The rule in a few sentences.
    """

    name: str
    rule: str


class UserFigures(Reply):
    """The requests and processor time of a user now.

    Attributes:
        waiting: Number of waiting requests.
        running: Number of running requests.
        processor: Recent processor time; time of 30 s ago counts half [s].
    """

    waiting: int = 0
    running: int = 0
    processor: float = 0.0


class Identity(Reply):
    """The identity of the caller, as far as the service knows it.

    Attributes:
        user: The user whose keys were queried; ``plain`` for keys without one.
        access_control: Whether the service's own configuration has access control. If neither it nor a router has,
            anybody can use anybody's keys, and all users of the plain keys are one user.
        quota: The quota of this user.
    """

    user: str
    access_control: bool
    quota: Quota


class InfoReply(Reply):
    """The service and its figures.

    Attributes:
        version: Of guidefield.
        packages: Versions of its packages.
        schemas: JSON Schema of every message; empty in a brief reply, as are the packages, keys, codes, limits and
            rules.
        workers: Number of worker processes.
        busy: Number of busy ones.
        queue: Number of waiting requests.
        counters: Counts since the start.
        uptime: Time since the start [s].
        latency: From a query's arrival to its answer, by the first chunk of its key.
        memory: Resident memory of the workers, of the streams' processes and of that which renders recordings [bytes].
        keys: Every key with its parameters and messages; the names are those of the schemas.
        codes: Every status code.
        limits: Its limits.
        delivery: Its rules of delivery.
        health: Its health.
        own_memory: Resident memory of the service's own process, without the workers [bytes].
        disk: The disk of its runs, scenes and robots; null if it stores none.
        payload_limit: The largest payload that is decoded [bytes]; a larger one is refused.
        identity: Identity of the caller; null in this process.
        users: Present figures of users: for operators all users with any, for a user its own.
        streams: Number of open streams.
    """

    version: str
    packages: dict[str, str]
    schemas: dict[str, Any]
    workers: int
    queue: int
    counters: dict[str, int]
    uptime: float
    busy: int = 0
    latency: dict[str, Histogram] = {}
    memory: int = 0
    keys: list[KeyInfo] = []
    codes: list[CodeInfo] = []
    limits: list[LimitInfo] = []
    delivery: list[DeliveryRule] = []
    health: Health = Health()
    own_memory: int = 0
    disk: Disk | None = None
    payload_limit: int = 0
    identity: Identity | None = None
    users: dict[str, UserFigures] = {}
    streams: int = 0
    schema: int = 1


class Progress(Reply):
    """The progress of a run, published while it runs.

    Attributes:
        run_id: Its name.
        stage: Its present stage, such as load, guide, connect, relax, parameterize, certify.
        plane: Index of the guide plane that it approaches, if any.
        clearance: Distance of the robot to the obstacles at the last step [m]; None without obstacles, or before.
        best_clearance: The largest of those published by now [m].
        elapsed: Time since the request arrived [s].
        preparing: In the stage load, the part of robot or scene that is prepared: ``cutting link2, shape 3 of 8``.
    """

    run_id: str
    stage: str
    plane: int | None
    clearance: float | None
    best_clearance: float | None
    elapsed: float
    preparing: str | None = None
    schema: int = 1
