"""Draw recordings of runs, at once or from their logs: for `renderer.py`'s process, for workers, and for commands.

A log is deleted only once its recording is there, or the reason why there will be none. Planner and recorder are loaded
where something is drawn.
"""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from guidefield.errors import GuidefieldError, UnknownObject
from guidefield.memory import RENDERED_SCENES
from guidefield.messages.replies import CertifyReply, MotionReply, PlanReply
from guidefield.messages.requests import CertifyRequest, MotionRequest, PlanRequest, UrdfFile
from guidefield.stores.recordings import LOG, NEEDED, Recordings

if TYPE_CHECKING:  # a command that renders nothing loads no planner
    from guidefield.handlers.recording import RecordedMotion
    from guidefield.planner.task.trace import EventLog
    from guidefield.recorder.stored import RecordingPlace
    from guidefield.robot.catalog import Catalog
    from guidefield.robot.model.model import RobotModel
    from guidefield.run_log import RunLog
    from guidefield.scene.anchor import Anchor
    from guidefield.scene.scene import BuiltScenes

_log = logging.getLogger(__name__)


LARGEST_RECORDING = 512 * 2**20
"""The largest recording or proof of a run that is stored, and the largest recording of a stream to be sent [bytes].

docs/stream.md tells it, and docs/wire.md by `endpoint/rules.py`: after a change, `tools/wire_page`.
"""


def whole_recording(recordings: Recordings, run_id: str) -> bytes:
    """Return the recording of a run as one file, with its robot's meshes.

    Raises UnknownObject if the run has no recording, or not yet, or a damaged one; raises OSError if the disk refuses.
    """
    from guidefield.recorder.stored import self_contained

    file = recordings.find(run_id)
    try:
        return self_contained(file, recordings.bodies_folder)
    except (ValueError, KeyError, RuntimeError) as error:
        _log.warning("the recording of run %s can't be read: %s", run_id, error)
        raise UnknownObject(f"the recording of run {run_id!r} is damaged", run_id=run_id) from None


@dataclass(frozen=True)
class Drawing:
    """All that the recording of a run is drawn from."""

    request: MotionRequest
    reply: MotionReply
    motion: RecordedMotion
    events: EventLog
    made_with: str  # versions of packages, as `describe_versions`
    anchor: Anchor | None = None  # the point that positions of the motion are relative to; None: the world's origin

    def write(self, file: Path, bodies: Path | None) -> str | None:
        """Write the recording, with robots' meshes in a folder, or in itself; return why it isn't stored, if it isn't.

        Raises OSError if the disk refuses.
        """
        from guidefield.recorder.bodies import cache_folder
        from guidefield.recorder.stored import RecordingPlace

        self.record(RecordingPlace(file, bodies or cache_folder(), whole=bodies is None))
        size = file.stat().st_size
        if size <= LARGEST_RECORDING:
            return None
        file.unlink()
        return f"it has {size} bytes, at most {LARGEST_RECORDING} are kept"

    def record(self, place: RecordingPlace) -> None:
        """Record the run at a place."""
        from guidefield.handlers.certify import JudgedMotion
        from guidefield.recorder.documents import RecordedRun
        from guidefield.recorder.recorder import record_judgement, record_plan

        request, reply, motion = self.request, self.reply, self.motion
        profile = motion.profile()
        group, scene = motion.view()
        if isinstance(request, PlanRequest):
            assert isinstance(reply, PlanReply), "a plan was answered"
            plan = RecordedRun(group, scene, request, reply, profile, self.made_with, self.anchor)
            record_plan(place, plan, self.events)
        else:
            assert isinstance(request, CertifyRequest), "only plans and judgements are recorded"
            assert isinstance(reply, CertifyReply), "a judgement was answered"
            assert isinstance(motion, JudgedMotion), "a motion was judged"
            judged = RecordedRun(group, scene, request, reply, profile, self.made_with, self.anchor)
            record_judgement(place, judged, motion.conditions.motion, motion.conditions.planned)


class Renderings:
    """Renders recordings; robots, by the folders of their packages, and scenes stay loaded from one to the next."""

    def __init__(
        self, catalogs: dict[tuple[Path, ...], Catalog] | None = None, scenes: BuiltScenes | None = None
    ) -> None:
        from guidefield.scene.scene import BuiltScenes

        self._catalogs = catalogs or {}
        self._scenes = scenes or BuiltScenes(RENDERED_SCENES)

    def render(self, recordings: Recordings, name: str, *, whole: bool = False) -> None:
        """Render a recording whose log is kept, unless it is rendered; raises OSError, and keeps the log.

        If nothing can be rendered from a log, the recording is marked as lost, with the reason. If `whole`, it holds
        its robot's meshes itself.
        """
        with contextlib.suppress(FileNotFoundError), recordings.file(name, LOG).open("rb") as file:
            state = os.fstat(file.fileno())
            done = recordings.path(name).exists()
            fault = None if done else self._draw(recordings, name, file.read(), whole=whole)
            if fault is not None:
                _log.warning("the recording of run %s is lost: %s", name, fault)
            recordings.settle(name, state, fault)

    def _draw(self, recordings: Recordings, name: str, data: bytes, *, whole: bool) -> str | None:
        """Render the recording of a log; return why it can't be, if it can't."""
        from guidefield.run_log import UnreadableLog

        try:
            with _read(recordings, name, data) as log:
                file, bodies = recordings.path(name), None if whole else recordings.bodies_folder
                drawing = Drawing(log.request, log.reply, self._motion(log), log.events, log.made_with, log.anchor)
                return drawing.write(file, bodies)
        except UnreadableLog as error:
            return f"{error}"
        except GuidefieldError as error:
            return f"it can't be rendered any more: {error.message}"
        except MemoryError:
            return "rendering it takes more memory than a worker may have"
        except OSError:
            raise
        except Exception as error:
            _log.exception("a recording could not be rendered")
            return f"it can't be rendered, because of a bug in guidefield: {type(error).__name__}: {error}"

    def _motion(self, log: RunLog) -> RecordedMotion:
        from guidefield.handlers.certify import restore_certify
        from guidefield.handlers.plan import restore_plan
        from guidefield.handlers.sequence import restore_steps

        robot, scene, request = self._robot(log), self._scenes.of(log.scene), log.request
        if log.anchor is not None:
            request, scene = log.anchor.inward(request), log.anchor.see(scene)
        if isinstance(request, PlanRequest):
            restore = restore_steps if request.steps else restore_plan
            return restore(request, robot, scene, log.motion)
        return restore_certify(request, robot, scene, log.motion)

    def _robot(self, log: RunLog) -> RobotModel:
        from guidefield.robot.catalog import Catalog
        from guidefield.run_log import UnreadableLog

        origin = log.robot
        catalog = self._catalogs.setdefault(origin.packages, Catalog(origin.packages))
        robot = catalog.load(origin.reference)
        if isinstance(origin.reference, UrdfFile) and catalog.origin(origin.reference)[1] != origin.fingerprint:
            raise UnreadableLog("the files of its robot have changed since")
        return robot


def render_recording(recordings: Recordings, run_id: str) -> bytes:
    """Return the self-contained recording of a run, rendered if only its log is kept; the folder may be read-only.

    Raises UnknownObject if there is none, or it is damaged; OSError if the disk refuses.
    """
    try:
        Renderings().render(recordings, run_id)
    except OSError:
        with tempfile.TemporaryDirectory(prefix="guidefield-") as folder:
            copied = Recordings(Path(folder) / "recordings")
            copied.folder.mkdir()
            for ending in (LOG, *NEEDED):
                with contextlib.suppress(FileNotFoundError):
                    shutil.copyfile(recordings.file(run_id, ending), copied.file(run_id, ending))
            Renderings().render(copied, run_id, whole=True)
            return whole_recording(copied, run_id)
    return whole_recording(recordings, run_id)


@contextlib.contextmanager
def _read(recordings: Recordings, name: str, data: bytes) -> Iterator[RunLog]:
    from guidefield.run_log import read_log

    with contextlib.ExitStack() as opened:

        def make_folder() -> Path:
            return Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="guidefield-")))

        yield read_log(data, partial(recordings.file, name), make_folder)
