from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from guidefield import kernels
from guidefield.kernels.cache import fingerprint

KERNELS = Path(kernels.__file__).parent

REPORT = """
import json, os
import guidefield.kernels
import numba
print(json.dumps([numba.config.CACHE_DIR, os.environ["NUMBA_CACHE_DIR"]]))
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
    for name in ("__init__.py", "cache.py", "signatures.py"):
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
    configured, exported = json.loads(run(REPORT, package, **{chosen: str(tmp_path / "caches")}))
    assert configured == exported
    assert Path(configured) == parent / "guidefield" / f"kernels-{fingerprint(package / 'guidefield/kernels')}"
    assert Path(configured).is_dir()


def test_a_process_that_it_starts_uses_the_same_folder(package: Path, tmp_path: Path) -> None:
    nested = (
        f"import guidefield.kernels, subprocess, sys\nsubprocess.run([sys.executable, '-c', {REPORT!r}], check=True)"
    )
    direct = json.loads(run(REPORT, package, NUMBA_CACHE_DIR=str(tmp_path)))
    assert json.loads(run(nested, package, NUMBA_CACHE_DIR=str(tmp_path))) == direct


def test_stale_machine_code_is_never_run(package: Path, tmp_path: Path) -> None:
    script = "from guidefield.kernels.caller import caller; print(caller(), sum(caller.stats.cache_hits.values()))"
    callee = package / "guidefield/kernels/callee.py"
    assert run(script, package, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["1", "0"]
    assert run(script, package, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["1", "1"]
    callee.write_text(callee.read_text().replace("return 1", "return 2"))
    assert run(script, package, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["2", "0"]
    callee.write_text(callee.read_text().replace("return 2", "return 1"))
    assert run(script, package, NUMBA_CACHE_DIR=str(tmp_path)).split() == ["1", "1"]


def test_fingerprint_changes_with_names_contents_and_numba(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.py").write_text("x")
    seen = [fingerprint(tmp_path)]
    (tmp_path / "deeper").mkdir()
    (tmp_path / "deeper/b.py").touch()
    seen.append(fingerprint(tmp_path))
    (tmp_path / "a.py").write_text("y")
    seen.append(fingerprint(tmp_path))
    (tmp_path / "a.py").rename(tmp_path / "c.py")
    seen.append(fingerprint(tmp_path))
    monkeypatch.setattr(numba, "__version__", "0")
    seen.append(fingerprint(tmp_path))
    assert len(set(seen)) == len(seen)
    assert fingerprint(tmp_path) == seen[-1]
