"""One run: its progress, its live view, its recording and proof; a failure to store these becomes a warning.

`Run` is made by the engine; handlers call `record`, `prove`, and planners its observer. Nothing here may fail a plan.
Progress is reported at every stage, and a few times a second at most; clearances are measured for reports, so with
another `MIN_PERIOD_S` the best one of a run is another.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar, cast

import msgspec

from guidefield.errors import strip_path
from guidefield.messages import codec
from guidefield.messages.replies import CertifyReply, MotionReply, PlanReply, Progress
from guidefield.messages.requests import MotionRequest
from guidefield.rendering import LARGEST_RECORDING, Drawing
from guidefield.stores.recordings import Recordings
from guidefield.versions import describe_versions
from guidefield.whole_file import write_whole

if TYPE_CHECKING:
    from guidefield.case_file import Motion
    from guidefield.collision.world import World
    from guidefield.deadline import Deadline
    from guidefield.handlers.recording import RecordedMotion
    from guidefield.planner.task.trace import Event
    from guidefield.robot.group.group import PlanningGroup
    from guidefield.robot.model.joints import Configuration
    from guidefield.run_log import RobotOrigin
    from guidefield.scene.anchor import Anchor
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


_log = logging.getLogger(__name__)

_R = TypeVar("_R", PlanReply, CertifyReply)


@dataclass(frozen=True)
class Destination:
    """The place of a run's recording."""

    file: Path  # the recording
    key: str  # its place, for the reply
    bodies: Path | None = None  # folder of robots' meshes that recordings share; None: it holds them itself
    # folder and name of the log that is written instead of the recording; None: the recording is written
    log: tuple[Recordings, str] | None = None

    @classmethod
    def stored(cls, recordings: Recordings, run_id: str, key: str) -> Destination:
        """Return the place of a recording in a store, whose log is written first."""
        return cls(recordings.path(run_id), key, recordings.bodies_folder, (recordings, run_id))


class Run:
    """One run, with its progress and its recording.

    Args:
        request: As it came, in the world's coordinates.
        destination: Place of its recording; None: none is kept. A request may turn recording, and the viewer, off.
        robot: Returns the source of its robot; asked only once the robot is loaded.
        progress: Reports its progress, if anybody listens.
        proof_place: File of its proof, and its place for the reply; None: nowhere.
        anchor: The point that the planner gets all positions relative to; None: the world's origin.
        viewer: Address of a running viewer that shows it; None: none.
    """

    def __init__(
        self,
        run_id: str,
        request: MotionRequest,
        destination: Destination | None,
        robot: Callable[[], RobotOrigin],
        progress: ProgressReporter | None = None,
        proof_place: tuple[Path, str] | None = None,
        anchor: Anchor | None = None,
        viewer: str | None = None,
    ) -> None:
        self.run_id = run_id
        self._anchor, self._declared = anchor, cast("Scene | None", None)
        self._progress = progress
        self._request = request
        self._destination, self._viewer = (None, None) if request.recording == "off" else (destination, viewer)
        self._robot = robot
        self._warnings = _Warnings(run_id)
        self._recording: _Recording | None = None
        self._proof_place, self._proof = proof_place, b""

    def is_cancelled(self) -> bool:
        """Return whether the run is cancelled; called at every iteration, it also reports progress."""
        return self._progress is not None and self._progress.pass_time_and_ask()

    def see(self, scene: Scene) -> Scene:
        """Return the run's scene relative to its anchor; it is recorded as it was declared."""
        if self._anchor is None:
            return scene
        self._declared = scene
        for text in self._anchor.coarse_warnings(self._request, scene):
            self._warnings.add(text)
        return self._anchor.see(scene)

    def prepare(self, what: str) -> None:
        """Report the part of the robot that is prepared now."""
        if self._progress is not None:
            self._progress.prepare(what)

    def record(self, group: PlanningGroup, scene: Scene) -> _Observers | None:
        """Return an observer of the run: its progress, recording and live view; None if it has none of them."""
        if self._progress is not None:
            self._progress.begin(group, scene)
        if self._destination is not None:
            origin = self._robot()
            self._recording = _Recording(
                self.run_id,
                self._request,
                self._destination,
                origin,
                self._declared or scene,
                self._warnings,
                self._anchor,
            )
        if self._progress is not None:
            self._progress.be_prepared()
        live = None
        if self._viewer is not None:
            live = _LiveView(self.run_id, self._request, self._viewer, group, self._declared or scene, self._anchor)
        observers = (self._progress, self._recording, live)
        return _Observers(*observers) if any(one is not None for one in observers) else None

    def prove(self, motions: Sequence[Motion], deadline: Deadline) -> None:
        """Prove the motions of the run; without a proof the reply warns why."""
        from guidefield.case_file import UnprovedError, proof_of

        try:
            if self._proof_place is None:
                raise UnprovedError("there is no place for it: name a file, or ask a service")
            if not motions:
                raise UnprovedError("no motion is certified free and within its limits")
            content = proof_of([replace(motion, anchor=self._anchor) for motion in motions], deadline)
            if len(content) > LARGEST_RECORDING:
                raise UnprovedError(f"it has {len(content)} bytes, at most {LARGEST_RECORDING} are kept")
            self._proof = content
            for missing in dict.fromkeys(motion.outside_proof for motion in motions if motion.outside_proof):
                self._warnings.add(f"the proof doesn't tell that {missing}")
        except (UnprovedError, OSError) as error:
            why = strip_path(error) if isinstance(error, OSError) else error
            self._warnings.add(f"no proof is kept: {why}")

    def _keep_proof(self) -> str | None:
        if not self._request.proof or self._proof_place is None:
            return None
        file, key = self._proof_place
        try:
            if self._proof:
                file.parent.mkdir(parents=True, exist_ok=True)
                write_whole(file, self._proof, durable=False)
                return key
        except OSError as error:
            self._warnings.add(f"no proof is kept: {strip_path(error)}")
        for text in remove_earlier_proof(file):
            self._warnings.add(text)
        return None

    def end(self, reply: _R, received: float | None = None) -> _R:
        """Complete a reply with the places of its recording and proof, or warnings why there are none.

        Time since the reply's timing was made counts as `measure`, unless a recording was stored then.

        Args:
            received: Arrival of the request, by `time.monotonic()` [s]; None: the timing stays as it is.
        """
        place, proof = None if self._recording is None else self._recording.kept, self._keep_proof()
        timing = reply.timing
        if received is not None and self._recording is None:
            total = time.monotonic() - received
            measure = timing.measure + max(0.0, total - timing.total)
            timing = msgspec.structs.replace(timing, total=total, measure=measure)
        warnings = [*reply.warnings, *self._warnings.texts]
        return msgspec.structs.replace(reply, recording=place, proof=proof, warnings=warnings, timing=timing)


def remove_earlier_proof(file: Path) -> list[str]:
    """Remove the file of an earlier motion's proof, if there is one; return warnings about it."""
    try:
        file.unlink()
    except FileNotFoundError:
        return []
    except OSError as error:
        return [f"the file of the proof isn't of this motion: {strip_path(error)}"]
    return ["the file of the proof was of an earlier motion, and is removed"]


class _Warnings:
    """Warnings about a run's files.

    Its own object: a recording with a reference to its run would keep both, and the world, alive until cycles are
    collected.
    """

    def __init__(self, run_id: str) -> None:
        self._run_id = run_id
        self.texts: list[str] = []

    def add(self, text: str) -> None:
        _log.warning("run %s: %s", self._run_id, text)
        self.texts.append(text)


@dataclass(frozen=True)
class _Observers:
    progress: ProgressReporter | None
    recording: _Recording | None
    live: _LiveView | None

    def observe(self, event: Event) -> None:
        for observer in (self.progress, self.recording, self.live):
            if observer is not None:
                observer.observe(event)

    def finish(self, reply: MotionReply, motion: RecordedMotion) -> None:
        for observer in (self.recording, self.live):
            if observer is not None:
                observer.finish(reply, motion)


class _LiveView:
    def __init__(
        self,
        run_id: str,
        request: MotionRequest,
        viewer: str,
        group: PlanningGroup,
        scene: Scene,
        anchor: Anchor | None,
    ) -> None:
        from guidefield.planner.task.trace import EventLog
        from guidefield.recorder.live_view import LiveRun

        self._request, self._anchor, self._events = request, anchor, EventLog()
        self._run = LiveRun(viewer, run_id, group, scene)

    def observe(self, event: Event) -> None:
        from guidefield.planner.task.trace import Step

        self._events.add(event)
        if isinstance(event, Step):
            self._run.show_step(event.q)

    def finish(self, reply: MotionReply, motion: RecordedMotion) -> None:
        sent = reply if self._anchor is None else self._anchor.outward(reply)
        drawing = Drawing(self._request, sent, motion, self._events, describe_versions(), self._anchor)
        try:
            drawing.record(self._run.place)
        except Exception:
            _log.exception("run %s can't be shown", sent.run_id)


class _Recording:
    """The recording of a run: the planner's events until the end; failures to store it become warnings.

    Attributes:
        kept: Its place, for the reply; None until it is finished, and if it can't be stored.
    """

    def __init__(
        self,
        run_id: str,
        request: MotionRequest,
        destination: Destination,
        robot: RobotOrigin,
        scene: Scene,
        warnings: _Warnings,
        anchor: Anchor | None = None,
    ) -> None:
        from guidefield.planner.task.trace import EventLog

        self._run_id, self._request, self._destination = run_id, request, destination
        self._robot, self._scene, self._warnings, self._anchor = robot, scene, warnings, anchor
        self._steps_only = request.recording == "summary"
        self._events = EventLog()
        self.kept: str | None = None

    def observe(self, event: Event) -> None:
        from guidefield.planner.task.trace import Step

        if not self._steps_only or isinstance(event, Step):
            self._events.add(event)

    def finish(self, reply: MotionReply, motion: RecordedMotion) -> None:
        """Store the log of the run; draw the recording instead if that fails, or no log is wanted."""
        to = self._destination
        sent: MotionReply = msgspec.structs.replace(reply, recording=to.key)
        if self._anchor is not None:
            sent = self._anchor.outward(sent)
        try:
            if to.log is None or not self._store_log(*to.log, sent, motion):
                drawing = Drawing(self._request, sent, motion, self._events, describe_versions(), self._anchor)
                fault = drawing.write(to.file, to.bodies)
                if fault is not None:
                    self._warnings.add(f"the recording is not kept: {fault}")
                    return
            self.kept = to.key
        except OSError as error:
            self._warnings.add(f"the recording was not written: {strip_path(error)}")
        except Exception as error:
            _log.exception("the recorder failed")
            self._warnings.add(
                f"the recording was not written, because of a bug in guidefield: {type(error).__name__}: {error}"
            )

    def _store_log(self, recordings: Recordings, name: str, reply: MotionReply, motion: RecordedMotion) -> bool:
        """Store the log from which the recording is rendered later; return whether the disk took it."""
        from guidefield.run_log import write_log

        log, shared = write_log(
            self._run_id, self._request, reply, self._robot, self._scene, self._events, motion.pack(), self._anchor
        )
        try:
            recordings.store_log(name, log, shared)
        except OSError as error:
            _log.warning("run %s: its log can't be kept: %s", self._run_id, strip_path(error))
            return False
        return True
