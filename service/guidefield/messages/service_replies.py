"""Replies about the service and the runs under way."""

from __future__ import annotations

from typing import Any, Literal

from guidefield.messages.codes import CodeInfo
from guidefield.messages.quotas import Quota
from guidefield.messages.served import KeyInfo
from guidefield.messages.values import Reply


class Histogram(Reply):
    """A histogram of durations: `counts[i]` up to `bounds[i]` [s], the last count beyond; and the sum [s]."""

    bounds: list[float]
    counts: list[int]
    sum: float


class Health(Reply):
    """The health of a service.

    Attributes:
        state: starting: only what needs no worker is answered; ready; ending: nothing new is begun.
        doing: What it does meanwhile, in a sentence; empty where it is ready.
    """

    state: Literal["starting", "ready", "ending"] = "ready"
    doing: str = ""


class Disk(Reply):
    """The disk that the data folder is on: how much is free, and how large it is [bytes]."""

    free: int
    total: int


class LimitInfo(Reply):
    """One limit that a service keeps.

    Attributes:
        name: Its name.
        value: How much.
        unit: Of what: s, bytes, or what is counted.
        what: What is limited, and what becomes of what is beyond it.
    """

    name: str
    value: float
    unit: str
    what: str


class DeliveryRule(Reply):
    """One rule by which queries are answered.

    Attributes:
        name: What it is about.
        rule: What holds, in a sentence or a few.
    """

    name: str
    rule: str


class UserFigures(Reply):
    """The requests and processor time of a user now.

    Attributes:
        waiting: Requests that wait.
        running: Requests that are worked on.
        processor: Seconds of a processor that it got lately; what it got 30 s ago counts half [s].
    """

    waiting: int = 0
    running: int = 0
    processor: float = 0.0


class Identity(Reply):
    """Who asks, as far as the service can tell.

    Attributes:
        user: The user whose keys were asked on; ``plain`` on keys without one.
        access_control: Whether the service's own configuration has access control. Where it hasn't, and no router has
            in its place, anybody can use anybody's keys, and all who use the plain keys are one user.
        quota: What this user may have.
    """

    user: str
    access_control: bool
    quota: Quota


class InfoReply(Reply):
    """The service and its figures.

    Attributes:
        version: Of guidefield.
        packages: Versions of what it stands on.
        schemas: JSON Schema of every message; empty where a brief answer was asked for, as are the packages, keys,
            codes, limits and rules.
        workers: Processes that work on requests.
        busy: How many of them do so now.
        queue: Requests that wait.
        counters: What was counted since the start.
        uptime: Time since the start [s].
        latency: From a query's arrival to its answer, by the first chunk of its key.
        memory: Resident memory of the workers, of the streams' processes and of that which renders recordings [bytes].
        keys: Every key with its parameters and messages; the names are those of the schemas.
        codes: Every code that a status or an error may have.
        limits: What it bounds, and by how much.
        delivery: The rules by which it answers.
        health: How it is.
        own_memory: Resident memory of the service's own process, without the workers [bytes].
        disk: Where it keeps runs, scenes and robots; null where it keeps none.
        payload_limit: The largest payload that is looked at [bytes]; a larger one is refused.
        identity: Who asks; null where nobody can but oneself.
        users: What users have now; for operators that of all who have any, for a user its own.
        streams: How many streams are open.
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
        stage: The stage that it is in, such as load, guide, connect, relax, parameterize, certify.
        plane: Index of the guide plane that it approaches, if any.
        clearance: Distance of the robot from the obstacles at the last step [m]; None without obstacles, or before.
        best_clearance: The largest of those told by now [m].
        elapsed: Time since the request arrived [s].
        preparing: In the stage load, which part of robot or scene is prepared: ``cutting link2, shape 3 of 8``.
    """

    run_id: str
    stage: str
    plane: int | None
    clearance: float | None
    best_clearance: float | None
    elapsed: float
    preparing: str | None = None
    schema: int = 1
