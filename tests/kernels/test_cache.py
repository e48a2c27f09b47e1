from __future__ import annotations

import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from guidefield import kernels
from guidefield.kernels.cache import fingerprint, uncompiled

KERNELS = Path(kernels.__file__).parent

REPORT = """
from pathlib import Path
from guidefield.kernels.cache import cache_folder
from guidefield.kernels.caller import caller
print(cache_folder(), caller._cache.cache_path)
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
    sources = tmp_path / "code/guidefield/kernels"
    sources.mkdir(parents=True)
    (sources.parent / "__init__.py").touch()
    shutil.copy(KERNELS.parent / "first_start.py", sources.parent)
    for name in ("__init__.py", "cache.py", "compilers.py", "quick_typing.py", "signatures.py"):
        shutil.copy(KERNELS / name, sources)
    (sources / "callee.py").write_text("import numba\n@numba.njit(cache=True)\ndef callee():\n    return 1\n")
    (sources / "caller.py").write_text(
        "import numba\n"
        "from guidefield.kernels.callee import callee\n"
        "@numba.njit(numba.int64(), cache=True)\n"
        "def caller():\n    return callee()\n"
    )
    return tmp_path / "code"


@pytest.mark.parametrize("chosen", ["NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME"])
def test_folder_is_below_the_one_that_the_user_chose(package: Path, tmp_path: Path, chosen: str) -> None:
    parent = tmp_path / "caches" / (".cache" if chosen == "HOME" else "")
    whole, used = run(REPORT, package, **{chosen: str(tmp_path / "caches")}).split()
    assert Path(whole) == parent / "guidefield" / "kernels"
    caller = package / "guidefield/kernels/caller.py"
    assert Path(used) == Path(whole) / f"caller-{fingerprint(caller)}"
    assert any(Path(used).glob("*.nbi"))


def test_another_place_of_the_same_sources_shares_the_machine_code(package: Path, tmp_path: Path) -> None:
    script = "from guidefield.kernels.caller import caller; print(caller(), sum(caller.stats.cache_hits.values()))"
    assert run(script, package, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["1", "0"]
    elsewhere = shutil.copytree(package, tmp_path / "elsewhere")
    assert run(script, elsewhere, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["1", "1"]


def test_other_packages_keep_numbas_own_folders(package: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.py"
    other.write_text(
        "import guidefield.kernels, numba\n@numba.njit(numba.int64(), cache=True)\ndef f():\n    return 1\n"
    )
    script = "import other; print(other.f._cache.cache_path)"
    used = run(f"import sys; sys.path.insert(0, {str(tmp_path)!r}); {script}", package, HOME=str(tmp_path)).strip()
    assert Path(used) == tmp_path / "__pycache__"


def test_stale_machine_code_is_never_run(package: Path, tmp_path: Path) -> None:
    script = "from guidefield.kernels.caller import caller; print(caller(), sum(caller.stats.cache_hits.values()))"
    callee = package / "guidefield/kernels/callee.py"
    assert run(script, package, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["1", "0"]
    assert run(script, package, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["1", "1"]
    callee.write_text(callee.read_text().replace("return 1", "return 2"))
    assert run(script, package, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["2", "0"]
    callee.write_text(callee.read_text().replace("return 2", "return 1"))
    assert run(script, package, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["1", "1"]


def test_an_edit_leaves_the_machine_code_of_what_does_not_call_it(package: Path, tmp_path: Path) -> None:
    script = "from guidefield.kernels.callee import callee; callee(); print(sum(callee.stats.cache_hits.values()))"
    assert run(script, package, NUMBA_CACHE_DIR=str(tmp_path)).strip() == "0"
    caller = package / "guidefield/kernels/caller.py"
    caller.write_text(caller.read_text() + "# an edit\n")
    assert run(script, package, NUMBA_CACHE_DIR=str(tmp_path)).strip() == "1"


IMPORTS = {
    "from": "from guidefield.kernels.{} import something\n",
    "from the room": "from guidefield.kernels import {}\n",
    "several": "from guidefield.kernels import (\n    other,\n    {},\n)\n",
    "renamed": "from guidefield.kernels import {} as short\n",
    "whole": "import guidefield.kernels.{}\n",
    "in a function": "def f():\n    from guidefield.kernels.{} import something\n",
}


@pytest.mark.parametrize("form", IMPORTS)
def test_fingerprint_follows_every_form_of_import_to_the_end(tmp_path: Path, form: str) -> None:
    def fresh(*, last: str) -> str:
        folder = tmp_path / last
        folder.mkdir()
        (folder / "first.py").write_text(IMPORTS[form].format("second"))
        (folder / "second.py").write_text(IMPORTS[form].format("third"))
        (folder / "third.py").write_text(last)
        return fingerprint(folder / "first.py")

    assert fresh(last="x") != fresh(last="y")


def test_fingerprint_changes_with_numba(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.py").write_text("x")
    before = fingerprint(tmp_path / "a.py")
    assert fingerprint(tmp_path / "a.py") == before
    monkeypatch.setattr(numba, "__version__", "0")
    assert fingerprint(tmp_path / "a.py") != before


def test_every_kernel_is_known_to_be_compiled_once_it_is_imported() -> None:
    for source in KERNELS.glob("*.py"):
        importlib.import_module(
            f"guidefield.kernels.{source.stem}" if source.stem != "__init__" else "guidefield.kernels"
        )
    assert not uncompiled()
