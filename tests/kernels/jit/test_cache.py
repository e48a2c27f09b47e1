"""Machine code is kept for what its sources depend on, in whatever form they say so."""

import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from guidefield import kernels
from guidefield.kernels.jit.cache import Sources, sources, uncompiled
from tests.kernels.jit.copies import compiling_package

KERNEL = """
from numba import int64
from guidefield.kernels.jit.decorators import compiled
{}
@compiled(int64())
def {}():
    return {}
"""


def run(script: str, path: Path, **environment: str) -> str:
    inherited = {key: value for key, value in os.environ.items() if key not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    return subprocess.run(
        [sys.executable, "-c", script],
        env={**inherited, "PYTHONPATH": str(path), **environment},
        capture_output=True,
        text=True,
        check=True,
    ).stdout


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the package with two kernels, of which one calls the other from another file."""
    sources = compiling_package(tmp_path / "code")
    (sources / "callee.py").write_text(KERNEL.format("", "callee", "1"))
    imported = "from guidefield.kernels.callee import callee\n"
    (sources / "caller.py").write_text(KERNEL.format(imported, "caller", "callee()"))
    return tmp_path / "code"


CALLED = (
    "from guidefield.kernels.callee import callee\nfrom guidefield.kernels.caller import caller\n"
    "print(caller(), *(sum(kernel.stats.cache_hits.values()) for kernel in (caller, callee)))"
)
"""Tells what the caller returns, and for both kernels whether they were loaded."""


def test_machine_code_is_that_of_the_sources_wherever_they_are(package: Path, tmp_path: Path) -> None:
    def called(path: Path) -> list[str]:
        return run(CALLED, path, NUMBA_CACHE_DIR=str(tmp_path)).split()

    callee, caller = (package / f"guidefield/kernels/{name}.py" for name in ("callee", "caller"))
    assert called(package) == ["1", "0", "0"]
    assert called(shutil.copytree(package, tmp_path / "elsewhere")) == ["1", "1", "1"]
    callee.write_text(callee.read_text().replace("return 1", "return 2"))
    assert called(package) == ["2", "0", "0"]
    callee.write_text(callee.read_text().replace("return 2", "return 1"))
    caller.write_text(caller.read_text() + "# an edit\n")
    assert called(package) == ["1", "0", "1"]


def test_kernels_of_another_package_are_kept_by_what_they_depend_on(package: Path, tmp_path: Path) -> None:
    """Of tests, for instance: an edit of what they call is seen, one of something else costs nothing."""
    others, place = tmp_path / "others/others", "room/second"
    (others / place).parent.mkdir(parents=True)
    imported = "from guidefield.kernels.callee import callee\n"
    (others / f"{place}.py").write_text(KERNEL.format(imported, "mine", "callee() + 1"))
    module = ".".join(["others", *place.split("/")])
    script = (
        f"import sys; sys.path.insert(0, {str(others.parent)!r})\n"
        "from pathlib import Path; from guidefield.kernels.jit.cache import keep_kernels_of\n"
        f"keep_kernels_of('others', Path({str(others)!r}))\n"
        f"from {module} import mine; print(mine(), sum(mine.stats.cache_hits.values()))"
    )
    folder = package / "guidefield/kernels"
    callee, unrelated = folder / "callee.py", folder / "caller.py"
    assert run(script, package, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["2", "0"]
    unrelated.write_text(unrelated.read_text() + "# an edit\n")
    assert run(script, package, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["2", "1"]
    callee.write_text(callee.read_text().replace("return 1", "return 5"))
    assert run(script, package, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["6", "0"]
    kept = {path.name.partition("-")[0] for path in (tmp_path / "guidefield/kernels").iterdir()}
    assert module in kept


def test_every_kernel_is_known_to_be_compiled_once_it_is_imported() -> None:
    for name in sources().names:
        importlib.import_module(f"guidefield.kernels.{name}".removesuffix(".__init__"))
    assert not uncompiled()


USES = {
    "from": "from guidefield.kernels.{0} import {0}\n{1} = {0}\n",
    "from the room": "from guidefield.kernels import {0}\n{1} = {0}.{0}\n",
    "several": "from guidefield.kernels.{0} import (\n    other,\n    {0},\n)\n{1} = {0}\n",
    "renamed": "from guidefield.kernels.{0} import {0} as short\n{1} = short\n",
    "renamed from the room": "from guidefield.kernels import {0} as short\n{1} = short.{0}\n",
    "whole": "import guidefield.kernels.{0}\n{1} = guidefield.kernels.{0}.{0}\n",
    "in a function": "def {1}():\n    from guidefield.kernels.{0} import {0}\n    return {0}()\n",
    "called": "from guidefield.kernels.{0} import {0}\n@decorated\ndef {1}():\n    return {0}()\n",
    "of a room": "from guidefield.kernels.room.{0} import {0}\n{1} = {0}\n",
}


def fingerprint(folder: Path, name: str = "first", also: str = "") -> str:
    return Sources(folder, "guidefield.kernels").fingerprint(name, also)


@pytest.mark.parametrize("form", USES)
def test_every_form_of_use_is_followed_to_the_end(tmp_path: Path, form: str) -> None:
    def fresh(value: str) -> str:
        folder = tmp_path / value
        within = folder / "room" if form == "of a room" else folder
        within.mkdir(parents=True)
        (folder / "first.py").write_text(USES[form].format("second", "first"))
        (within / "second.py").write_text(USES[form].format("third", "second"))
        (within / "third.py").write_text(f"third = {value}\n")
        return fingerprint(folder)

    assert fresh("1") != fresh("2")


def test_an_import_alone_is_no_dependency(tmp_path: Path) -> None:
    (tmp_path / "first.py").write_text("from guidefield.kernels.second import KIND\ndef first(x: KIND):\n    pass\n")
    second = tmp_path / "second.py"
    second.write_text("KIND = int\ndef formula():\n    return 1\n")
    before = fingerprint(tmp_path)
    second.write_text("KIND = int\ndef formula():\n    return 2\n")
    assert fingerprint(tmp_path) == before
    second.write_text("KIND = float\ndef formula():\n    return 2\n")
    assert fingerprint(tmp_path) != before


@pytest.mark.parametrize(
    "effect",
    ["register({})", "@overload(len)\ndef _(x):\n    return {}", "if True:\n    register({})", "table[0] = {}"],
)
def test_what_a_file_does_while_it_is_imported_counts_for_all_who_import_it(tmp_path: Path, effect: str) -> None:
    (tmp_path / "first.py").write_text("from guidefield.kernels.second import KIND\n")
    (tmp_path / "second.py").write_text("import guidefield.kernels.third\nKIND = int\n")
    third = tmp_path / "third.py"
    third.write_text(effect.format(1))
    before = fingerprint(tmp_path)
    third.write_text(effect.format(2))
    assert fingerprint(tmp_path) != before


def test_a_number_in_forward_kinematics_is_no_reason_to_compile_everything() -> None:
    sources = Sources(Path(kernels.__file__).parent, "guidefield.kernels")
    for file, name in (
        ("kinematics.forward_kinematics", "joint_placements"),
        ("kinematics.batch_forward_kinematics", "batch_placements"),
    ):
        again = [one for one in sources.names if (file, name) in sources._needed(one)]
        assert file in again
        assert len(again) <= len(sources.names) / 3
