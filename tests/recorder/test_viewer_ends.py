"""A viewer that ends by itself: before it has drawn there is no graphics driver, afterwards it is a failure."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

TOOLS = Path(__file__).parents[2] / "tools"
NO_GRAPHICS = 3
PANIC = "thread 'main' panicked at 'Failed to get render context'"
AT_ONCE = f"""#!/bin/sh
echo "{PANIC}"
exit 102
"""
UNTIL_TOLD = f"""#!/bin/sh
end() {{ echo "{PANIC}"; exit 102; }}
trap end TERM
echo $$ > "$0.pid"
while :; do sleep 0.05; done
"""


@dataclass
class StandIn:
    """A viewer's client whose viewer ends when it has given so many answers, or drawn so many pictures."""

    pid: Path
    answers: int
    pictures: int = 0
    asked: list[str] = field(default_factory=list)

    def connect(self, _url: str) -> StandIn:
        if not self.pid.exists() or not self.pid.read_text().strip():
            raise ConnectionError("it has not started yet, or has ended")
        return self

    def get_state(self) -> Any:
        self._answer("state")
        ready = SimpleNamespace(timelines=["path_time"])
        return SimpleNamespace(views=["motion"], loading=[], recordings=[ready])

    def open(self, _recording: str) -> None:
        self._answer("open")

    def take_screenshot(self, _view: str | None = None) -> bytes:
        if self.asked.count("picture") >= self.pictures:
            self._end()
        self.asked.append("picture")
        return b"picture %d" % self.asked.count("picture")

    def _answer(self, question: str) -> None:
        if len(self.asked) - self.asked.count("picture") >= self.answers:
            self._end()
        self.asked.append(question)

    def _end(self) -> None:
        os.kill(int(self.pid.read_text()), signal.SIGTERM)
        self.pid.unlink()
        raise ConnectionError("transport error")


@pytest.fixture
def viewer(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(TOOLS))
    from pictures import viewer

    return viewer


def _replaced(
    viewer: ModuleType, monkeypatch: pytest.MonkeyPatch, folder: Path, script: str, answers: int, pictures: int = 0
) -> None:
    """Rerun's command starts a script in the viewer's place, and its client is the stand-in."""
    command = folder / "viewer"
    command.write_text(script)
    command.chmod(0o755)
    monkeypatch.setenv("RERUN_CLI_PATH", str(command))
    monkeypatch.setattr(viewer, "ViewerClient", StandIn(folder / "viewer.pid", answers, pictures))


def _pictured(viewer: ModuleType) -> bytes:
    with viewer.headless_viewer() as client:
        viewer.opened(client, Path("run.rrd"))
        picture: bytes = viewer.steady_picture(client, None)
        viewer.complaints(client)
        return picture


@pytest.mark.parametrize(
    ("script", "answers"),
    [
        pytest.param(AT_ONCE, 0, id="before it is asked"),
        pytest.param(UNTIL_TOLD, 0, id="before its first answer"),
        pytest.param(UNTIL_TOLD, 1, id="after its first answer"),
        pytest.param(UNTIL_TOLD, 2, id="while it opens a recording"),
        pytest.param(UNTIL_TOLD, 1000, id="in the middle of its first picture"),
    ],
)
def test_one_that_ends_before_it_has_drawn_has_no_graphics_driver(
    viewer: ModuleType,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    script: str,
    answers: int,
) -> None:
    _replaced(viewer, monkeypatch, tmp_path, script, answers)
    with pytest.raises(SystemExit) as ended:
        _pictured(viewer)
    assert ended.value.code == NO_GRAPHICS == viewer.NO_GRAPHICS
    assert PANIC in capsys.readouterr().err


@pytest.mark.parametrize(
    ("answers", "pictures"),
    [
        pytest.param(0, 1, id="before its first answer"),
        pytest.param(1, 1, id="while it opens a recording"),
        pytest.param(1000, 1, id="in the middle of a picture of the recording"),
        pytest.param(1000, 3, id="in the middle of a later picture"),
    ],
)
def test_one_that_ends_when_it_has_drawn_has_failed(
    viewer: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, answers: int, pictures: int
) -> None:
    _replaced(viewer, monkeypatch, tmp_path, UNTIL_TOLD, answers, pictures)
    with pytest.raises(SystemExit) as ended:
        _pictured(viewer)
    assert isinstance(ended.value.code, str), "a text: exit code 1"
    assert PANIC in ended.value.code


def test_what_goes_wrong_while_it_lives_is_told_as_it_is(
    viewer: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    _replaced(viewer, monkeypatch, tmp_path, UNTIL_TOLD, answers=0, pictures=1000)
    monkeypatch.setattr(viewer, "ENDING", 0.1)
    with pytest.raises(RuntimeError, match="no such view"), viewer.headless_viewer():
        raise RuntimeError("no such view")
