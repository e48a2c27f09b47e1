"""Render recordings from the logs of their runs: for `renderer.py`'s process, for workers, and for commands.

A log is deleted only once its recording is there, or the reason why there will be none.
"""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from guidefield.errors import GuidefieldError
from guidefield.memory import RENDERED_SCENES
from guidefield.messages.requests import PlanRequest, UrdfFile
from guidefield.robot.catalog import Catalog
from guidefield.robot.model.model import RobotModel
from guidefield.run import Drawing, whole_recording
from guidefield.run_log import RunLog, UnreadableLog, read_log
from guidefield.scene.scene import BuiltScenes
from guidefield.stores.recordings import LOG, NEEDED, Recordings

if TYPE_CHECKING:  # a command that renders nothing loads no planner
    from guidefield.handlers.recording import RecordedMotion

_log = logging.getLogger(__name__)


class Renderings:
    """Renders recordings; robots, by the folders of their packages, and scenes stay loaded from one to the next."""

    def __init__(
        self, catalogs: dict[tuple[Path, ...], Catalog] | None = None, scenes: BuiltScenes | None = None
    ) -> None:
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
    with contextlib.ExitStack() as opened:

        def make_folder() -> Path:
            return Path(opened.enter_context(tempfile.TemporaryDirectory(prefix="guidefield-")))

        yield read_log(data, partial(recordings.file, name), make_folder)
