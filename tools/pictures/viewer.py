"""Rerun's viewer without a display: started, given a recording, moved in time, photographed, asked what it misses.

Needs a graphics driver; in software, on Debian: apt install mesa-vulkan-drivers libvulkan1 libegl1
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from rerun.experimental import ViewerClient

from guidefield.cli.serving import free_port

PATIENCE = 180.0
"""Time that a viewer may take to show a recording, and then to stop changing [s]."""

NO_GRAPHICS = 3
"""Exit code where there is no graphics driver."""

UNANSWERED = (OSError, RuntimeError)
"""Exceptions of a question that the viewer doesn't answer: a ConnectionError if it is gone, the others its own."""

ENDING = 10.0
"""Time that a viewer may take to end [s]."""

ASKED_AGAIN = 20.0
"""After how long without a recording the viewer is asked for it once more [s]."""

HARMLESS = "Software rasterizer"
"""The viewer's warning wherever there is no graphics hardware."""

WINDOW = (1920, 1080)
"""Width and height of the window that nobody sees [pixels]."""


@contextlib.contextmanager
def headless_viewer(window: tuple[int, int] = WINDOW):
    """A viewer without a window, reachable from this machine only; its picture is as large as `window` [pixels]."""
    command = [Path(sys.executable).with_name("rerun"), "--headless", "--bind", "127.0.0.1"]
    command += ["--hide-welcome-screen", "--window-size", f"{window[0]}x{window[1]}"]
    with free_port() as port, tempfile.TemporaryFile() as log:
        command += ["--port", str(port)]
        # a session of its own: the command starts the real viewer as a child, and both have to end
        process = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
        try:
            viewer = await_drawing(process, log, f"rerun+http://127.0.0.1:{port}/proxy")
            try:
                yield viewer
            except UNANSWERED:
                if not has_ended(process):
                    raise
                raise SystemExit(f"the viewer, which had drawn before, ended: {last_words(log)}") from None
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def await_drawing(process, log, url: str) -> ViewerClient:
    """A client of a viewer that has just been started and has drawn its empty window.

    Without a graphics driver a viewer may answer questions, but it ends before it has drawn anything; one that has
    drawn has a driver. So what ends until here ends for want of a driver, and what ends later is a failure.
    """
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        if process.poll() is not None:
            print(f"no graphics driver: the viewer ended before it drew: {last_words(log)}", file=sys.stderr)
            sys.exit(NO_GRAPHICS)
        try:
            viewer = ViewerClient.connect(url)
            viewer.take_screenshot()
            return viewer
        except UNANSWERED:
            time.sleep(0.2)
    raise SystemExit(f"the viewer drew nothing within {PATIENCE:.0f} s")


def has_ended(process) -> bool:
    """Return whether a viewer that didn't answer is gone; the command that started it notices a little later."""
    try:
        process.wait(ENDING)
    except subprocess.TimeoutExpired:
        return False
    return True


def last_words(log) -> str:
    """Read what the viewer said of its end."""
    log.seek(0)
    lines = log.read().decode(errors="replace").splitlines()
    return " ".join(line for line in lines if "panicked" in line or "rror" in line) or "it didn't say why"


def open_recording(viewer, recording: Path):
    """The viewer's state once a recording is loaded; asked for again if a viewer that was still starting forgot it."""
    asked = None
    deadline = time.monotonic() + PATIENCE
    while (now := time.monotonic()) < deadline:
        if asked is None or now - asked > ASKED_AGAIN:
            viewer.open(str(recording))
            asked = now
        state = viewer.get_state()
        if state.views and not state.loading and state.recordings and state.recordings[0].timelines:
            return state
        time.sleep(0.1)
    raise SystemExit(f"the viewer showed nothing within {PATIENCE:.0f} s")


def bring_forward(viewer, name: str) -> None:
    """Choose the tabs that show the container, or the view, of a name."""
    layout = viewer.get_blueprint("recording").blueprint
    kinds = ("ContainerBlueprint", "ViewBlueprint")
    names = {path: node[kind].get("display_name") for path, node in layout.items() for kind in kinds if kind in node}
    child = next((path.strip("/") for path, its_name in names.items() if its_name == name), None)
    if child is None:
        raise SystemExit(f"there is no {name!r}; there are {', '.join(filter(None, names.values()))}")
    while child is not None:
        above = None
        for path, node in layout.items():
            container = node.get("ContainerBlueprint", {})
            if child in container.get("contents", []):
                above = path.strip("/")
                if container["container_kind"] == "Tabs":
                    container["active_tab"] = child
        child = above
    viewer.set_blueprint(layout, "recording")
    time.sleep(1.0)


def steady_picture(viewer, view: str | None) -> bytes:
    """A picture that has stopped changing; the last one where none does in time."""
    deadline, before = time.monotonic() + PATIENCE, b""
    while True:
        try:
            picture = viewer.take_screenshot(view)
        except TimeoutError:  # drawn without a graphics card on a busy machine, one takes longer than the viewer waits
            if time.monotonic() >= deadline:
                raise
            continue
        if picture == before or time.monotonic() >= deadline:
            return picture
        before = picture
        time.sleep(0.5)


def complaints(viewer) -> list[str]:
    """List complaints of the views and the viewer, missing transforms among them."""
    lines = [f"{view.name}: {report.summary}" for view in viewer.get_state().views for report in view.reports]
    lines += [
        entry.message
        for entry in viewer.get_logs()
        if entry.level in ("WARN", "ERROR") and HARMLESS not in entry.message and not _was_taken_again(entry.message)
    ]
    return lines


def _was_taken_again(message: str) -> bool:
    """Return whether a message is about a picture that took too long, after which `steady_picture` took another."""
    return "Failed to render screenshot" in message and "timed out" in message
