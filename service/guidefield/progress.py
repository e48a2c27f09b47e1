"""Report the progress of a run: at every stage, and a few times a second at most.

Reports are for watching: no plan depends on them. Clearances are measured for reports, so with another `MIN_PERIOD_S`
the best one of a run is another.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Protocol

from guidefield.messages import codec
from guidefield.messages.replies import Progress

if TYPE_CHECKING:
    from guidefield.collision.world import World
    from guidefield.planner.task.trace import Event
    from guidefield.robot.group.group import PlanningGroup
    from guidefield.robot.model.joints import Configuration
    from guidefield.scene.scene import Scene

MIN_PERIOD_S = 0.2
"""Shortest time between two reports within a stage [s]; a clearance takes a fraction of a millisecond."""


class Watcher(Protocol):
    """A client's link to a run: takes progress, and may cancel the run; `pool/process.py` `Call` is one."""

    def is_cancelled(self) -> bool:
        """Return whether the run is to end early."""

    def is_listened_to(self) -> bool:
        """Return whether anybody listens to progress; else nothing is measured."""

    def tell(self, what: bytes) -> None:
        """Take a Progress message as JSON."""

    def be_prepared(self) -> None:
        """Take note that robot and scene are loaded, and that the request checks its deadline itself from now on."""


class ProgressReporter:
    """Reports the progress of a run to a watcher."""

    def __init__(self, run_id: str, received: float, watcher: Watcher) -> None:
        self._run_id = run_id
        self._received = received
        self._watcher = watcher
        self._reported_at = -math.inf
        self._stage = "load"
        self._preparing: str | None = None
        self._plane: int | None = None
        self._world: World | None = None
        self._q: Configuration | None = None
        self._clearance: float | None = None
        self._best: float | None = None

    def begin(self, group: PlanningGroup, scene: Scene) -> None:
        """Set the moving joints and the scene."""
        from guidefield.collision.world import World

        self._world = World.build(group, scene)

    def observe(self, event: Event) -> None:
        """Take an event of the planner."""
        from guidefield.planner.task import trace

        match event:
            case trace.StageEntered(name=name):
                self._stage, self._plane, self._preparing = name, None, None
                self._tell()
            case trace.Step(q=q, plane=plane):
                self._q, self._plane = q, plane
                self._tell_if_due()

    def be_prepared(self) -> None:
        """Pass on that all is prepared."""
        self._watcher.be_prepared()

    def prepare(self, what: str) -> None:
        """Report the part of the robot that is prepared now."""
        self._preparing = what
        self._tell()

    def pass_time_and_ask(self) -> bool:
        """Report if it is time, and return whether the run is cancelled."""
        self._tell_if_due()
        return self._watcher.is_cancelled()

    def _tell_if_due(self) -> None:
        if time.monotonic() - self._reported_at >= MIN_PERIOD_S:
            self._tell()

    def _tell(self) -> None:
        self._reported_at = time.monotonic()
        if not self._watcher.is_listened_to():
            return
        self._measure()
        message = Progress(
            run_id=self._run_id,
            stage=self._stage,
            plane=self._plane,
            clearance=self._clearance,
            best_clearance=self._best,
            elapsed=self._reported_at - self._received,
            preparing=self._preparing,
        )
        self._watcher.tell(codec.encode(message))

    def _measure(self) -> None:
        if self._world is None or self._q is None:
            return
        from guidefield.collision.clearance import clearance_at

        distance = clearance_at(self._world, self._world.group.expand(self._q)).obstacle_distance
        self._q = None
        if math.isfinite(distance):
            self._clearance = distance
            self._best = distance if self._best is None else max(self._best, distance)
