"""What a service says about itself and about the runs under way."""

from __future__ import annotations

from typing import Any

from guidefield.messages.values import Reply


class Histogram(Reply):
    """How often something took how long: `counts[i]` up to `bounds[i]` [s], the last count beyond; and the sum [s]."""

    bounds: list[float]
    counts: list[int]
    sum: float


class InfoReply(Reply):
    """What a service is and does.

    Attributes:
        version: Of guidefield.
        packages: Versions of what it stands on.
        schemas: JSON Schema of every message; empty where a brief answer was asked for, as are the packages.
        workers: Processes that work on requests.
        busy: How many of them do so now.
        queue: Requests that wait.
        counters: What was counted since the start.
        uptime: Time since the start [s].
        latency: From a query's arrival to its answer, by the first chunk of its key.
        memory: Resident memory of the workers [bytes].
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
