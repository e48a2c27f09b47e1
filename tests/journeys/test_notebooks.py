"""The notebooks run from top to bottom, and replies show themselves in them."""

from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec
import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.util import run_sync

from guidefield.notebook import LEFT_ALIGNED, SHOWN, display_reply
from tests.replies import plan_reply

NOTEBOOKS = Path(__file__).resolve().parents[2] / "tools" / "examples" / "notebooks"


Run = Callable[[str], list[dict[str, Any]]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where notebooks run."""
    return tmp_path_factory.mktemp("notebooks")


@pytest.fixture(scope="module")
def run(folder: Path) -> Iterator[Run]:
    """Run a notebook in a namespace of its own, and return all that it displays; one process takes them all."""
    manager = NotebookClient(nbformat.v4.new_notebook()).create_kernel_manager()

    def executed(name: str) -> list[dict[str, Any]]:
        notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
        notebook.cells.insert(0, nbformat.v4.new_code_cell("%reset -f"))
        place = {"metadata": {"path": str(folder)}}
        NotebookClient(notebook, km=manager, timeout=600, resources=place).execute()
        return [one for cell in notebook.cells if cell.cell_type == "code" for one in cell.outputs]

    yield executed
    run_sync(manager.shutdown_kernel)(now=True)


def _tables(shown: list[dict[str, Any]]) -> list[str]:
    return [one["data"]["text/html"] for one in shown if "<table" in one.get("data", {}).get("text/html", "")]


def _printed(shown: list[dict[str, Any]]) -> str:
    return "".join(one["text"] for one in shown if one["output_type"] == "stream" and one["name"] == "stdout")


def test_displays_are_registered_for_the_modules_that_declare_their_messages() -> None:
    modules = {f"guidefield.messages.{module}": names for module, names in SHOWN.items()}
    declared = {
        module: [getattr(import_module(module), name).__module__ for name in modules[module]] for module in modules
    }
    assert declared == {module: [module] * len(names) for module, names in modules.items()}


def test_the_first_plan(run: Run, folder: Path) -> None:
    shown = run("first_plan")
    (table,) = _tables(shown)
    assert f"<th>certificate</th><td {LEFT_ALIGNED}>free: the trajectory" in table
    assert "20 mm: SUCCESS" in _printed(shown)
    assert "300 mm: SUCCESS" not in _printed(shown)
    assert "did you mean panda" in _printed(shown)
    assert (folder / "first_plan.rrd").stat().st_size > 100_000


def test_a_robot_of_ones_own(run: Run) -> None:
    shown = run("own_robot")
    (table,) = _tables(shown)
    assert "SUCCESS" in table
    assert "GOAL_IN_COLLISION" in _printed(shown)


def test_a_motion_is_judged(run: Run) -> None:
    refused, free = _tables(run("judge_a_motion"))
    assert "refused at" in refused
    assert f"<th>certificate</th><td {LEFT_ALIGNED}>collision-free" in free


def test_a_recording_plays_where_the_viewer_is_at_hand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The viewer gets the bytes of the file; without the file there is the table alone."""
    widget = pytest.importorskip("rerun_notebook", reason="the extra notebook isn't installed")
    shown: list[Any] = []
    monkeypatch.setattr("IPython.display.display", shown.append)
    recording = tmp_path / "run.rrd"
    recording.write_bytes(b"RRF2")
    display_reply(msgspec.structs.replace(plan_reply("r1"), recording=str(recording)))
    assert [type(one).__name__ for one in shown] == ["HTML", "Viewer"]
    assert isinstance(shown[1], widget.Viewer)
    assert shown[1]._event_queue == [({"type": "rrd"}, [b"RRF2"])]
    recording.unlink()
    display_reply(msgspec.structs.replace(plan_reply("r1"), recording=str(recording)))
    assert [type(one).__name__ for one in shown] == ["HTML", "Viewer", "HTML"]
