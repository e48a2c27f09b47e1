"""The first start of a version: every kernel compiled once, in the order of who calls whom, and never asked again.

Machine code that comes with the package is taken where it fits, and never where it doesn't or is damaged.
"""

import json
import os
import re
import subprocess
import sys
import threading
import zipfile
from pathlib import Path

import pytest
from tools.shipped import make_wheel

from guidefield import first_start
from guidefield.kernels.jit import cache as kernel_cache, compile_ahead
from guidefield.kernels.timing import hermite
from tests.journeys.service import await_death
from tests.kernels.jit.copies import compiling_package

KERNEL = """
from guidefield.kernels.jit.decorators import compiled
from guidefield.kernels.jit.arrays import SCALAR
{imported}

@compiled(SCALAR(SCALAR))
def {name}(x):
    return {result}
"""

START = """
import sys
from guidefield import first_start
first_start.PROGRESS_PERIOD_S = 0.0
try:
    first_start.compile_kernels(print)
except RuntimeError as error:
    print("fault:", error)
print("numba" in sys.modules)
"""


def package(folder: Path, result: str) -> Path:
    """A copy of the package with two kernels, of which one calls the other from another file."""
    kernels = compiling_package(folder)
    imported = "from guidefield.kernels.callee import callee"
    (kernels / "a_caller.py").write_text(KERNEL.format(imported=imported, name="a_caller", result="callee(x) + 1.0"))
    (kernels / "callee.py").write_text(KERNEL.format(imported="", name="callee", result=result))
    return folder


def start(code: Path, cache: Path) -> list[str]:
    """What a start tells, with a cache folder of its own."""
    environment = {**os.environ, "PYTHONPATH": str(code), "NUMBA_CACHE_DIR": str(cache)}
    ran = subprocess.run([sys.executable, "-c", START], env=environment, capture_output=True, text=True, check=True)
    return ran.stdout.splitlines()


def test_everything_is_compiled_once_for_a_processor_and_what_is_called_first(tmp_path, monkeypatch):
    code, cache = package(tmp_path / "code", "2.0 * x"), tmp_path / "cache"
    before, first, second, compiler = start(code, cache)
    assert before == first_start.FIRST_PROGRESS
    assert first.startswith("compiling kernels 0 %")
    assert first.endswith("1 of 2 (callee)")
    share = re.fullmatch(r"compiling kernels (\d+) %, once for this version: 2 of 2 \(a_caller\)", second)
    assert 0 < int(share[1]) < 100
    assert compiler == "False"
    kept = sorted(path.name.partition("-")[0] for path in (cache / "guidefield" / "kernels").iterdir())
    assert kept == ["a_caller", "all", "callee", "fingerprints"]
    assert all(any(path.glob("*.nbi")) for path in (cache / "guidefield" / "kernels").iterdir() if path.is_dir())
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    monkeypatch.setenv("NUMBA_CPU_FEATURES", "")
    assert len(start(code, cache)) == 4, "machine code for another processor, where machines share a home folder"
    monkeypatch.undo()
    assert start(code, cache) == ["False"]
    kept = [path.name.partition("-")[0] for path in (cache / "guidefield" / "kernels").iterdir()]
    assert sorted(kept) == sorted(2 * ["a_caller", "all", "callee", "fingerprints"])
    source = code / "guidefield" / "kernels" / "a_caller.py"
    source.write_text(source.read_text() + "# an edit\n")
    _, only, _ = start(code, cache)
    assert "1 of 1 (a_caller)" in only


def test_kernels_are_compiled_for_the_highest_level_that_the_processor_has(tmp_path, monkeypatch):
    for number, (level, flags) in enumerate(first_start.LEVELS.items()):
        told = tmp_path / f"{number}"
        told.write_text(f"model\t: 85\nflags\t\t: fpu {flags} more\n")
        assert first_start.find_level(told) == level
        told.write_text(f"flags\t\t: {flags.rpartition(' ')[0]}\n")
        first_start.find_level.cache_clear()
        assert first_start.find_level(told) in {None, *list(first_start.LEVELS)[number + 1 :]}
    assert first_start.find_level(tmp_path / "nowhere") is None
    assert first_start.find_level(tmp_path) is None, "what can't be read"
    monkeypatch.setenv("NUMBA_CPU_NAME", "x86-64-v3")
    assert first_start.level() is None, "with features of this very processor"
    monkeypatch.setenv("NUMBA_CPU_FEATURES", "")
    assert first_start.level() == "x86-64-v3"
    assert "x86-64-v3" in first_start.kernel_compiler()
    monkeypatch.setenv("NUMBA_CPU_NAME", "haswell")
    assert first_start.target_variables() == {}


def test_a_kernel_that_cannot_be_compiled_ends_the_start_with_its_reason(tmp_path: Path) -> None:
    *_, fault, _ = start(package(tmp_path / "code", "x.nothing"), tmp_path / "cache")
    assert "callee: TypingError" in fault
    assert "nothing" in fault
    assert not any(path.name.startswith("all-") for path in (tmp_path / "cache" / "guidefield" / "kernels").iterdir())


def test_a_compile_under_way_does_not_hold_up_whoever_is_told_to_end(tmp_path, monkeypatch):
    """A compiler that would take for ever, and those who compile for it, are ended and leave no mark."""
    compiler, pids = tmp_path / "compiler", tmp_path / "pids"
    compiler.write_text(f"#!/bin/sh\nsleep 300 & echo $! $$ > {pids}\necho compiling\nwait\n")
    compiler.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(compiler))
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    told: list[str] = []
    first_start.compile_kernels(told.append, lambda: len(told) > 1)
    assert told == [first_start.FIRST_PROGRESS, "compiling"]
    for pid in map(int, pids.read_text().split()):
        await_death(pid)
    assert not (tmp_path / "cache").exists()


def test_a_compiler_that_is_killed_and_a_cache_that_takes_nothing_are_told_in_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file" / "cache"))
    (tmp_path / "file").touch()
    with pytest.raises(first_start.CannotStart, match=r"^machine code can't be kept: .*; set NUMBA_CACHE_DIR"):
        first_start.compile_kernels(lambda _: None)
    compiler = tmp_path / "compiler"
    compiler.write_text("#!/bin/sh\nkill -9 $$\n")
    compiler.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(compiler))
    with pytest.raises(first_start.CannotStart, match="ended by SIGKILL; what is compiled is kept"):
        first_start.compile_kernels(lambda _: None)


FIRST_ONLY = """
import sys
from guidefield import first_start
from guidefield.kernels.jit import compile_ahead
first_start.compile_kernels(print, wholly=False)
print("returned")
first_start.compile_kernels(print, wholly=False)
"""


def test_who_makes_one_plan_waits_for_what_that_needs_and_the_rest_is_compiled_after_its_end(tmp_path: Path) -> None:
    code, kept = package(tmp_path / "code", "2.0 * x"), tmp_path / "cache"
    ahead = code / "guidefield" / "kernels" / "jit" / "compile_ahead.py"
    ahead.write_text(ahead.read_text().replace("FIRST = (\n", 'FIRST = (\n    "callee",\n'))
    environment = {**os.environ, "PYTHONPATH": str(code), "NUMBA_CACHE_DIR": str(kept)}
    ran = subprocess.run(
        [sys.executable, "-c", FIRST_ONLY], env=environment, capture_output=True, text=True, check=True, timeout=120
    )
    assert ran.stdout.splitlines()[1:] == ["compiling kernels 0 %, once for this version: 1 of 1 (callee)", "returned"]
    assert "Exception" not in ran.stderr
    again = start(code, kept)  # waits for the one that goes on
    assert not any("fault" in line for line in again)
    kernels = kept / "guidefield" / "kernels"
    assert {path.parent.name.partition("-")[0] for path in kernels.glob("*/whole")} == {"a_caller", "callee"}
    assert not list(kernels.glob("compiling-*")), "nobody compiles any more"


def test_a_kernel_that_is_called_before_its_turn_waits_for_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    function, name = hermite.piece_peaks.py_func, "timing.hermite"
    kernel_cache.await_machine_code(function)  # nobody compiles: the call does
    waits = threading.Thread(target=kernel_cache.await_machine_code, args=(function,))
    with kernel_cache.compile_alone() as alone:
        assert alone
        with kernel_cache.compile_alone() as second:
            assert not second
        waits.start()
        waits.join(0.3)
        assert waits.is_alive()
        assert kernel_cache.is_wanted(name)
        kernel_cache.note_compiled(name)
        waits.join(10.0)
        assert not waits.is_alive()
        kernel_cache.await_machine_code(function)


PLANNED = """
import guidefield, json, sys
from guidefield.kernels.jit.patched_compiler import Kernel
goal = {"type": "pose", "position": [0.4, 0.2, 0.5], "quaternion_xyzw": [1, 0, 0, 0]}
reply = guidefield.answer({"robot": "ur5", "scene": "table", "goal": goal, "guide_planes": [], "recording": "off"})
kernels = "guidefield.kernels."
loaded = {
    name.removeprefix(kernels)
    for name, module in list(sys.modules.items())
    if name.startswith(kernels)
    for one in vars(module).values()
    if isinstance(one, Kernel) and one.overloads and one.py_func.__module__ == name
}
print(json.dumps([reply.status.name, sorted(loaded)]))
"""


def test_a_first_plan_for_a_robot_that_nothing_is_kept_of_needs_what_is_compiled_first(tmp_path: Path) -> None:
    folder = tmp_path / "guidefield"
    folder.mkdir()
    (folder / "kernels").symlink_to(kernel_cache.cache_folder())
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}
    ran = subprocess.run([sys.executable, "-c", PLANNED], env=environment, capture_output=True, text=True, check=True)
    status, loaded = json.loads(ran.stdout.splitlines()[-1])
    assert status == "SUCCESS"
    assert len(loaded) > 30
    assert set(loaded) <= compile_ahead.find_needed_first()
    assert set(compile_ahead.FIRST) <= set(kernel_cache.sources().names)


DECORATED_KERNEL = """
from guidefield.kernels.jit.decorators import compiled
from guidefield.kernels.jit.arrays import SCALAR

@compiled(SCALAR(SCALAR))
def twice(x):
    return 2.0 * x
"""

COMPILED = """
from guidefield import first_start
told = []
first_start.compile_kernels(told.append)
print(len(told) > 0, first_start.compiled_marker().read_text() == first_start.SHIPPED)
"""

"""Prints whether something was compiled, and whether what is there is what was shipped."""

CALLED = """
from guidefield.kernels.twice import twice
print(twice(4.0), sum(twice.stats.cache_hits.values()))
"""

FOUND = """
from guidefield import first_start
print(first_start.find_shipped(first_start.kernels_fingerprint()) is not None)
"""

EARLIER = """
import numba
@numba.njit
def of_the_user(x):
    return x + 1.0
of_the_user(1.0)
"""


def run(script: str, code: Path, cache: Path, **environment: str) -> str:
    variables = {**os.environ, "PYTHONPATH": str(code), "NUMBA_CACHE_DIR": str(cache), "PYTHONDONTWRITEBYTECODE": "1"}
    ran = subprocess.run(
        [sys.executable, "-c", script], env=variables | environment, capture_output=True, text=True, check=True
    )
    return ran.stdout.strip()


def test_a_package_that_brings_machine_code_compiles_none(tmp_path: Path) -> None:
    """Nor does it write where it is installed; a user's own functions may have been compiled before."""
    if first_start.level() is None:
        pytest.skip("this processor has no level")
    code, made = tmp_path / "code", tmp_path / "made"
    source = compiling_package(code) / "twice.py"
    source.write_text(DECORATED_KERNEL)
    assert run(COMPILED, code, made) == "True False"
    run(f"import sys; sys.argv[1:] = [{str(code / 'guidefield' / 'machine_code')!r}]\n{make_wheel.PACK}", code, made)
    (archive,) = (code / "guidefield" / "machine_code").iterdir()
    before = sorted(code.rglob("*"))
    for number, earlier in enumerate(("", EARLIER)):
        assert run(COMPILED, code, tmp_path / f"{number}") == "False True"
        assert run(earlier + CALLED, code, tmp_path / f"{number}") == "8.0 1"
    assert sorted(code.rglob("*")) == before

    assert run(FOUND, code, made) == "True"
    assert run(FOUND, code, made, NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES="") == "False", "below its level"
    assert run(FOUND, code, made, GUIDEFIELD_PLAIN_NUMBA="1") == "False"
    source.write_text(DECORATED_KERNEL + "# an edit\n")
    assert run(FOUND, code, made) == "False"
    source.write_text(DECORATED_KERNEL)
    archive.write_bytes(archive.read_bytes()[:-1])
    assert run(COMPILED, code, tmp_path / "damaged") == "True False"


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    """One of a folder and of a file."""
    cache = tmp_path / "made"
    (cache / "kernel-1").mkdir(parents=True)
    for name, content in {"f.1.nbc": b"code", "f.nbi": b"index", "whole": b"", "wanted": b""}.items():
        (cache / "kernel-1" / name).write_bytes(content)
    (cache / "fingerprints.json").write_bytes(b"{}")
    return first_start.pack(["fingerprints.json", "kernel-1"], cache, "x86-64-v4", "0123", tmp_path / "shipped")


def test_an_archive_is_found_by_what_it_fits_and_unpacked_as_it_was(archive: Path, tmp_path: Path) -> None:
    assert first_start.find_shipped("0123", archive.parent) == archive
    assert first_start.find_shipped("0124", archive.parent) is None
    assert first_start.find_shipped("0123", tmp_path / "nowhere") is None
    assert first_start.list_shipped(archive.parent) == ["x86-64-v4"]
    assert first_start.unpack(archive, tmp_path / "cache")
    found = {str(p.relative_to(tmp_path / "cache")): p.read_bytes() for p in (tmp_path / "cache").rglob("*.*")}
    assert found == {"fingerprints.json": b"{}", "kernel-1/f.1.nbc": b"code", "kernel-1/f.nbi": b"index"}
    assert (tmp_path / "cache" / "kernel-1" / "whole").exists()
    assert not (tmp_path / "cache" / "kernel-1" / "wanted").exists()


@pytest.mark.parametrize("place", [0, 100, -1])
def test_of_an_archive_that_is_damaged_nothing_is_unpacked(archive, tmp_path, place, caplog):
    content = bytearray(archive.read_bytes())
    content[place] ^= 1
    archive.write_bytes(content)
    assert not first_start.unpack(archive, tmp_path / "cache")
    assert not (tmp_path / "cache").exists()
    assert "is damaged" in caplog.text


def test_the_wheel_for_a_platform_holds_what_the_plain_one_does_and_machine_code(tmp_path: Path) -> None:
    plain = tmp_path / "some-1.0-py3-none-any.whl"
    with zipfile.ZipFile(plain, "w") as written:
        written.writestr("some/code.py", "")
        written.writestr("some-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\nTag: py3-none-any\n")
        written.writestr("some-1.0.dist-info/RECORD", "")
    made = make_wheel.write_wheel(plain, {"some/machine_code/one": b"1"}, "cp311-cp311-manylinux2014_x86_64", tmp_path)
    assert made.name == "some-1.0-cp311-cp311-manylinux2014_x86_64.whl"
    with zipfile.ZipFile(made) as whole:
        assert whole.read("some-1.0.dist-info/WHEEL").endswith(b"Tag: cp311-cp311-manylinux2014_x86_64\n")
        record = whole.read("some-1.0.dist-info/RECORD").decode().splitlines()
        assert [line.partition(",")[0] for line in record] == whole.namelist()
    assert "some/machine_code/one,sha256=a4ayc_80_OGda4BO_1o_V0etpOqiLx1JwB5S3beHW0s,1" in record
