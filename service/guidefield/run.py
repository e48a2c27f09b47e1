"""A run while it is made: its progress and its recording; a recording that can't be kept becomes a warning."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

import msgspec

from guidefield.errors import UnknownObject, without_path
from guidefield.later import Work
from guidefield.messages.replies import CertifyReply, PlanReply, Timing
from guidefield.messages.requests import CertifyRequest, MotionRequest, PlanRequest
from guidefield.progress import ProgressTold
from guidefield.stores.recordings import Recordings

if TYPE_CHECKING:
    from guidefield.handlers.recording import RecordingInPieces
    from guidefield.planner.motion.given_motion import GivenMotion
    from guidefield.planner.quality import ClearanceProfile
    from guidefield.planner.task.trace import Event
    from guidefield.recorder.place import Place
    from guidefield.robot.group.group import PlanningGroup
    from guidefield.scene.scene import Scene

LARGEST_RECORDING = 512 * 2**20
"""A recording that is larger is dropped [bytes]."""

Owe = Callable[[Work], None]
"""Takes work that is to be done after the answer."""

_log = logging.getLogger(__name__)

_R = TypeVar("_R", PlanReply, CertifyReply)


class Run:
    """One run, with its progress and its recording.

    Args:
        run_id: Its name.
        request: As it came.
        recordings: Where its recording goes, if anywhere.
        record_to: Where it goes in place of that.
        recording_key: What a reply says about where the recording is, if it is in `recordings`.
        progress: Tells somebody how far it is, if anybody listens.
        later: Takes the writing of a recording that goes to `recordings`; None: it is written before the reply.
    """

    def __init__(
        self,
        run_id: str,
        request: MotionRequest,
        recordings: Recordings | None,
        record_to: Path | None,
        recording_key: str,
        progress: ProgressTold | None = None,
        later: Owe | None = None,
    ) -> None:
        self.run_id = run_id
        self._later = later
        self._progress = progress
        self._request = request
        self._recordings = recordings
        self._warnings = _Warnings(run_id)
        self._recording: _Written | None = None
        self._record_to = record_to
        self._place = recording_key if record_to is None else str(record_to)

    def cancelled(self) -> bool:
        """Return whether a client asked the run to end; called at every iteration, it also lets progress be told."""
        return self._progress is not None and self._progress.pass_time_and_ask()

    def prepare(self, what: str) -> None:
        """Be told which part of the robot is prepared."""
        if self._progress is not None:
            self._progress.prepare(what)

    def record(
        self,
        group: PlanningGroup,
        scene: Scene,
        shown: Callable[[], tuple[PlanningGroup, Scene]] | None = None,
    ) -> _Observers[PlanReply]:
        """An observer of a plan: tells its progress, and writes its recording when it is finished, once.

        Args:
            group: The joints that move.
            scene: Where.
            shown: As the recorder's.
        """
        request = self._request
        assert isinstance(request, PlanRequest), "a plan is recorded"

        def recorder(place: Place) -> RecordingInPieces[PlanReply]:
            from guidefield.recorder.recorder import Recorder

            return Recorder(place, group, scene, request, self.run_id, shown)

        return self._observers(group, scene, recorder)

    def record_given(self, group: PlanningGroup, scene: Scene, motion: GivenMotion) -> _Observers[CertifyReply]:
        """The same of a motion that is judged."""
        request = self._request
        assert isinstance(request, CertifyRequest), "a judgement is recorded"

        def recorder(place: Place) -> RecordingInPieces[CertifyReply]:
            from guidefield.recorder.given_recorder import GivenRecorder

            return GivenRecorder(place, group, scene, request, self.run_id, motion)

        return self._observers(group, scene, recorder)

    def _observers(
        self, group: PlanningGroup, scene: Scene, recorder: Callable[[Place], RecordingInPieces[_R]]
    ) -> _Observers[_R]:
        """Who hears of progress, which is told what moves where, and what `recorder` makes if a recording is kept."""
        if self._progress is not None:
            self._progress.begin(group, scene)
        recording: _Recording[_R] | _OwedRecording[_R] | None = None
        if (place := self._where()) is not None:
            recording = _Recording(recorder(place), place.file, self._place, self._warnings)
            if self._later is not None and self._record_to is None and self._recordings is not None:
                recording = _OwedRecording(recording, self.run_id, self._recordings, self._later)
        self._recording = recording
        if self._progress is not None:
            self._progress.be_prepared()
        return _Observers(self._progress, recording)

    def _where(self) -> Place | None:
        """The place of the recording, if there is to be one."""
        recordings = self._recordings
        if self._request.recording == "off" or (self._record_to is None and recordings is None):
            return None
        from guidefield.recorder.bodies_file import cache_folder
        from guidefield.recorder.place import Place

        if self._record_to is not None:
            return Place(self._record_to, cache_folder(), whole=True)
        assert recordings is not None, "a recording goes somewhere"
        with contextlib.suppress(OSError):  # its writing tells it
            recordings.folder.mkdir(parents=True, exist_ok=True)
        return Place(recordings.path(self.run_id), recordings.bodies_folder, whole=False)

    def end(self, reply: _R, received: float | None = None) -> _R:
        """The reply as it is sent, with where its recording is, or why there is none.

        What came after its timing was told counts as measuring, unless a recording was written meanwhile.

        Args:
            reply: What the run came to.
            received: When it arrived, by `time.monotonic()` [s]; None: its timing stays as it is.
        """
        place = None if self._recording is None else self._recording.written
        timing = reply.timing
        if received is not None and self._recording is None:
            timing = _until(timing, time.monotonic() - received)
        warnings = [*reply.warnings, *self._warnings.texts]
        return msgspec.structs.replace(reply, recording=place, warnings=warnings, timing=timing)


def _until(timing: Timing, total: float) -> Timing:
    """The times of a run that took so long in all [s]."""
    return msgspec.structs.replace(timing, total=total, measure=timing.measure + max(0.0, total - timing.total))


class _Warnings:
    """Warnings about what could not be kept of a run.

    Its own object: a recording that knew its run would leave both, and the world that was planned in, lying about until
    cycles are collected.
    """

    def __init__(self, run_id: str) -> None:
        self._run_id = run_id
        self.texts: list[str] = []

    def add(self, text: str) -> None:
        """Log a warning, and keep it for the reply."""
        _log.warning("run %s: %s", self._run_id, text)
        self.texts.append(text)


def whole_recording(recordings: Recordings, run_id: str) -> bytes:
    """The recording of a run, with its robot's meshes: one file that anybody can open.

    Where it is still being written, this waits for it.

    Raises:
        UnknownObject: if the run has no recording, or not yet, or a damaged one.
        OSError: if the disk refuses.
    """
    from guidefield.recorder.whole import self_contained

    file = recordings.find(run_id)
    try:
        return self_contained(file, recordings.bodies_folder)
    except (ValueError, KeyError, RuntimeError) as error:
        _log.warning("the recording of run %s can't be read: %s", run_id, error)
        raise UnknownObject(f"the recording of run {run_id!r} is damaged", run_id=run_id) from None


@dataclass(frozen=True)
class _Observers(Generic[_R]):
    """Those who watch a run, as one."""

    progress: ProgressTold | None
    recording: _Recording[_R] | _OwedRecording[_R] | None

    def observe(self, event: Event) -> None:
        """Pass on what the planner tells."""
        for observer in (self.progress, self.recording):
            if observer is not None:
                observer.observe(event)

    def finish(self, reply: _R, profile: Callable[[], ClearanceProfile | None]) -> None:
        """Have the recording written, if there is one: nothing is measured for none."""
        if self.recording is not None:
            self.recording.finish(reply, profile)


class _Written(Protocol):
    """A recording whose place is known once it is written."""

    written: str | None


class _Recording(Generic[_R]):
    """A recorder whose failure to write is told, not raised.

    Attributes:
        written: Where the recording is, for the reply; None until it is finished, and where it was not kept.
    """

    def __init__(self, recorder: RecordingInPieces[_R], path: Path, place: str, warnings: _Warnings) -> None:
        self._recorder: RecordingInPieces[_R] = recorder
        self._path = path
        self.place = place
        self._warnings = warnings
        self.written: str | None = None

    @property
    def faults(self) -> list[str]:
        """Why it is not kept."""
        return self._warnings.texts

    def observe(self, event: Event) -> None:
        """Pass on what the planner tells."""
        self._recorder.observe(event)

    def finish(
        self, reply: _R, profile: Callable[[], ClearanceProfile | None], pause: Callable[[], None] = lambda: None
    ) -> None:
        """Write the recording; the reply in it says where it is. Between pieces of the work `pause` is called."""
        try:
            self._recorder.finish(msgspec.structs.replace(reply, recording=self.place), profile, pause)
            size = self._path.stat().st_size
            if size > LARGEST_RECORDING:
                self._path.unlink()
                self._warnings.add(
                    f"the recording is not kept: it has {size} bytes, at most {LARGEST_RECORDING} are kept"
                )
            else:
                self.written = self.place
        except OSError as error:
            self._warnings.add(f"the recording was not written: {without_path(error)}")
        except Exception as error:
            _log.exception("the recorder failed")
            self._warnings.add(
                f"the recording was not written, because of a bug in guidefield: {type(error).__name__}: {error}"
            )


class _OwedRecording(Generic[_R]):
    """A recording that is written after the reply has gone; who asks for it meanwhile waits.

    Attributes:
        written: Where the recording will be, for the reply; None until the run is finished.
    """

    def __init__(self, recording: _Recording[_R], run_id: str, recordings: Recordings, later: Owe) -> None:
        self._recording: _Recording[_R] = recording
        self._run_id, self._recordings, self._later = run_id, recordings, later
        self.written: str | None = None

    def observe(self, event: Event) -> None:
        """Pass on what the planner tells."""
        self._recording.observe(event)

    def finish(self, reply: _R, profile: Callable[[], ClearanceProfile | None]) -> None:
        """Owe the recording; where not even that can be kept, write it at once."""
        recording, recordings, run_id = self._recording, self._recordings, self._run_id

        def write(pause: Callable[[], None]) -> None:
            recording.finish(reply, profile, pause)
            recordings.settle(run_id, None if recording.written else "; ".join(recording.faults))

        try:
            recordings.owe(run_id)
        except OSError:
            recording.finish(reply, profile)
            self.written = recording.written
            return
        self._later(write)
        self.written = recording.place
