"""What a service says about itself and about the runs under way."""

from __future__ import annotations

from typing import Any, Literal

from guidefield.messages.served import KeyInfo
from guidefield.messages.values import Reply


class Histogram(Reply):
    """How often something took how long: `counts[i]` up to `bounds[i]` [s], the last count beyond; and the sum [s]."""

    bounds: list[float]
    counts: list[int]
    sum: float


class Health(Reply):
    """How a service is.

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


class InfoReply(Reply):
    """What a service is and does.

    Attributes:
        version: Of guidefield.
        packages: Versions of what it stands on.
        schemas: JSON Schema of every message; empty where a brief answer was asked for, as are the packages and keys.
        workers: Processes that work on requests.
        busy: How many of them do so now.
        queue: Requests that wait.
        counters: What was counted since the start.
        uptime: Time since the start [s].
        latency: From a query's arrival to its answer, by the first chunk of its key.
        memory: Resident memory of the workers [bytes].
        keys: Every key with its parameters and messages; the names are those of the schemas.
        health: How it is.
        own_memory: Resident memory of the service's own process, without the workers [bytes].
        disk: Where it keeps runs, scenes and robots; null where it keeps none.
        payload_limit: The largest payload that is looked at [bytes]; a larger one is refused.
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
    health: Health = Health()
    own_memory: int = 0
    disk: Disk | None = None
    payload_limit: int = 0
    schema: int = 1


class Progress(Reply):
    """How far a run is; published while it runs.

    Attributes:
        run_id: Its name.
        stage: The stage that it is in, such as load, guide, connect, relax, parameterize, certify.
        plane: Index of the guide plane that it approaches, if any.
        clearance: Distance of the robot from the obstacles at the last step [m]; None without obstacles, or before.
        best_clearance: The largest of those told by now [m].
        elapsed: Time since the request arrived [s].
        preparing: In the stage load, what of the robot is prepared for its first use: ``cutting link2, shape 3 of 8``.
    """

    run_id: str
    stage: str
    plane: int | None
    clearance: float | None
    best_clearance: float | None
    elapsed: float
    preparing: str | None = None
    schema: int = 1
