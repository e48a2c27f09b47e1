"""The light client: the rooms that it holds are all that it needs, and from nothing else than those it asks a service.

`tools/wheel` builds and installs it; here it is staged, and imported by a Python that sees nothing but what it needs.
"""

import ast
import json
import subprocess
import sys
import tomllib
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from packaging.requirements import Requirement

import guidefield
from tests.journeys.service import running_service

HOUSE = Path(__file__).resolve().parent.parent
PACKAGE = HOUSE / "service" / "guidefield"
PROJECT = tomllib.loads((HOUSE / "pyproject.toml").read_text())
CLIENT = PROJECT["tool"]["guidefield"]["client"]
MOST_BYTES = 500_000  # how large our own part of it may be [bytes]
ASK = """
import json, sys, guidefield
from guidefield import *
with Client.connect(sys.argv[1]) as client:
    scenes = client.scenes()
    placed = client.kinematics(json.loads(sys.argv[2]))
names = [name for name in guidefield.__all__ if name != "__version__" and getattr(guidefield, name) is None]
missing = []
for name in ("answer", "Engine", "serve", "run_arrays"):
    try:
        getattr(guidefield, name)
    except ImportError as error:
        missing.append(str(error))
loaded = sorted({name.split(".")[0] for name in sys.modules} - set(sys.stdlib_module_names))
assert __version__ == guidefield.__version__
print(json.dumps([scenes, placed.placements[0][0].position, names, missing, loaded, guidefield.__file__]))
"""


@pytest.fixture
def staged(tmp_path: Path, stage: ModuleType) -> Path:
    """The staged project of the light client."""
    stage.stage(tmp_path / "light")
    return tmp_path / "light"


@pytest.fixture
def stage(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(HOUSE / "tools"))
    from light import stage

    return stage


def _needed(tmp_path: Path) -> Path:
    """A folder with nothing in it but what the light client needs."""
    folder = tmp_path / "needed"
    folder.mkdir()
    for name in ("zenoh", "msgspec", "typing_extensions"):
        spec = find_spec(name)
        assert spec.origin is not None
        there = Path(spec.origin)
        there = there.parent if there.name == "__init__.py" else there
        (folder / there.name).symlink_to(there)
    return folder


def _run(script: str, path: list[Path], *arguments: str) -> subprocess.CompletedProcess[str]:
    """A script in a Python that sees nothing but its own library and these folders."""
    begin = f"import sys; sys.path[:0] = {[str(one) for one in path]!r}\n"
    return subprocess.run(
        [sys.executable, "-I", "-S", "-c", begin + script, *arguments], check=False, capture_output=True, text=True
    )


def test_it_asks_a_service_and_sees_nothing_else(staged: Path, tmp_path: Path) -> None:
    asked = {"type": "forward_kinematics", "robot": "ur5", "frames": ["tool0"], "configurations": [{}]}
    with running_service(tmp_path / "data", "--workers", "1") as service:
        done = _run(ASK, [staged, _needed(tmp_path)], service.endpoint, json.dumps(asked))
    assert done.returncode == 0, done.stderr
    scenes, position, unresolved, missing, loaded, file = json.loads(done.stdout)
    assert "table" in scenes
    here = guidefield.answer(asked)
    assert position == pytest.approx(list(here.placements[0][0].position), abs=1e-12)
    assert unresolved == []
    assert len(missing) == 4
    assert all("pip install guidefield" in words for words in missing)
    assert set(loaded) <= {"__main__", "guidefield", "zenoh", "msgspec", "typing_extensions"}
    assert Path(file) == staged / "guidefield" / "__init__.py"


def test_its_rooms_import_no_others() -> None:
    """By the words of the source, lazy imports too, beside those of the door, which has names for both."""
    rooms = {name.removesuffix(".py") for name in CLIENT["rooms"]}
    for name in CLIENT["rooms"]:
        source = PACKAGE / name
        for path in source.rglob("*.py") if source.is_dir() else [source]:
            if path == PACKAGE / "__init__.py" or path.suffix != ".py":
                continue
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("guidefield."):
                    assert node.module.split(".")[1] in rooms, (path, node.module)


def test_it_has_the_version_and_the_needs_of_the_whole(stage: ModuleType) -> None:
    project: dict[str, Any] = tomllib.loads(stage.describe())["project"]
    assert project["version"] == PROJECT["project"]["version"]
    assert project["name"] == "guidefield-client"
    assert {Requirement(line).name for line in project["dependencies"]} == set(CLIENT["needs"])
    assert set(project["dependencies"]) <= set(PROJECT["project"]["dependencies"])


def test_it_is_small_and_holds_no_data(staged: Path) -> None:
    ours = [path for path in (staged / "guidefield").rglob("*") if path.is_file()]
    assert {path.suffix for path in ours} == {".py", ".typed", ".txt"}
    assert sum(path.stat().st_size for path in ours) < MOST_BYTES


def test_both_in_one_folder_are_noticed(staged: Path, tmp_path: Path) -> None:
    both = staged / "guidefield"
    assert _run("import warnings; warnings.simplefilter('error'); import guidefield", [staged]).returncode == 0
    (both / "engine.py").touch()
    done = _run("import guidefield; from guidefield import GuidefieldError; print('goes on')", [staged])
    assert "`pip uninstall guidefield-client`" in done.stderr
    assert done.stdout == "goes on\n"
