"""Send a recording to a running Rerun viewer while its run or stream goes on; nothing waits for the viewer.

`run.py` uses `LiveRun`, `stream/shown.py` a `Channel`. Numbers decide how much is drawn, waits in memory and is shown.
"""

from __future__ import annotations

import functools
import logging
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.recorder import bodies, entities
from guidefield.recorder.bodies import Drawn
from guidefield.recorder.chunks import APPLICATION_ID, STEP, visible_entities
from guidefield.recorder.motion import poses
from guidefield.recorder.stored import RecordingPlace, SharedScene
from guidefield.recorder.view import Eye, choose_eye, layout
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.joints import Configuration
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import Scene
from guidefield.viewer import is_listening

STEP_INTERVAL_S = 0.05  # shortest time between two of the planner's steps that are drawn and sent [s]
MAX_PENDING = 8  # steps are left out while this many parts wait to be sent
MAX_BACKLOG = 64  # parts that wait to be sent, each maybe a whole recording of MBs in memory; further ones aren't shown

_backlog = threading.BoundedSemaphore(MAX_BACKLOG)

_log = logging.getLogger(__name__)

Part = tuple[Iterable[Chunk], Any]  # chunks, and a layout (a Rerun blueprint) or None


class Channel:
    """Sends one recording to a viewer, in a thread: nobody waits for a viewer that is slow or gone."""

    def __init__(self, address: str, recording_id: str) -> None:
        self._address, self._recording_id = address, recording_id
        self._recording: rr.RecordingStream | None = None
        self._pending = 0

    @property
    def is_busy(self) -> bool:
        """Return whether so much waits that a part may be left out."""
        return self._pending >= MAX_PENDING

    def send(self, make: Callable[[], Part], *, last: bool = False) -> None:
        """Have a part made and sent, and the recording ended if it is the last one; returns at once.

        If the viewer takes nothing, parts that exceed `MAX_BACKLOG` aren't shown.
        """
        if not _backlog.acquire(blocking=False):
            _log.warning("the viewer at %s takes nothing: a part of %s isn't shown", self._address, self._recording_id)
            return
        self._pending += 1
        _sender().submit(self._send, make, last)

    def _send(self, make: Callable[[], Part], last: bool) -> None:
        try:
            if not is_listening(self._address):
                _log.warning("no viewer listens at %s", self._address)
                return
            chunks, views = make()
            if self._recording is None:
                self._recording = rr.RecordingStream(
                    f"{APPLICATION_ID}-{self._recording_id}", recording_id=self._recording_id
                )
                self._recording.connect_grpc(self._address)
            if views is not None:
                self._recording.send_blueprint(views)
            self._recording.send_chunks(chunks)
            if last:
                self._recording.disconnect()
                self._recording = None
        except Exception:  # what is shown is no part of an answer
            _log.exception("a part of a recording can't be shown")
        finally:
            self._pending -= 1
            _backlog.release()


@functools.cache
def _sender() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, "guidefield-viewer")


class LiveRun:
    """A run in a viewer: the planner's steps while it runs, and then its whole recording."""

    def __init__(self, address: str, run_id: str, group: PlanningGroup, scene: Scene) -> None:
        self._group, self._scene, self._channel = group, scene, Channel(address, run_id)
        self._steps, self._sent = 0, -np.inf

    def show_step(self, q: Configuration) -> None:
        """Show the robot after one of the planner's steps, at a configuration (nq,), a few times a second."""
        self._steps += 1
        now = time.monotonic()
        if now - self._sent >= STEP_INTERVAL_S and not self._channel.is_busy:
            self._channel.send(functools.partial(self._draw_step, q, self._steps, first=self._sent < 0.0))
            self._sent = now

    def _draw_step(self, q: Configuration, number: int, *, first: bool) -> Part:
        group, at = self._group, poses(self._group, [q])
        drawn = bodies.load_drawn(group.robot, bodies.cache_folder())
        moved = entities.link_motion(group, drawn.links, at, np.array([number]), STEP)
        if not first:
            return [moved], None
        robot = at.placements[:, :, :3].reshape(-1, 3)
        eye = choose_eye(at.tip, robot, np.empty((0, 3)), self._scene.obstacles, group.size)
        obstacles = entities.obstacles(self._scene.obstacles, eye.hiding, ())
        chunks = [*bodies.meshes(group.robot, drawn), *obstacles, entities.tip_axes(group), moved]
        return chunks, layout(eye, STEP, visible_entities(chunks))

    @property
    def place(self) -> RecordingPlace:
        """Return a place for the whole recording, which sends it to the viewer instead of writing a file."""
        return _ViewerPlace(Path(), bodies.cache_folder(), True, self._channel)


@dataclass(frozen=True)
class _ViewerPlace(RecordingPlace):
    channel: Channel

    def write(
        self,
        run_id: str,  # noqa: ARG002 - the channel knows it
        chunks: Sequence[Chunk],
        scene: SharedScene,
        robot: RobotModel,
        drawn: Drawn,
        eye: Eye,
        timeline: str,
    ) -> None:
        every = [*chunks, *scene.chunks(), *bodies.meshes(robot, drawn)]
        views = layout(eye, timeline, visible_entities(chunks))
        self.channel.send(lambda: (every, views), last=True)
