import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from guidefield.kernels.jit.cache import sources, uncompiled
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
