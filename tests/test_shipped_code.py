"""Machine code that comes with the package: taken where it fits, and never where it doesn't or is damaged."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from tools.shipped import make_wheel

from guidefield import first_start, shipped_code
from tests.kernels.jit.copies import compiling_package

KERNEL = """
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
from guidefield import first_start, shipped_code
print(shipped_code.find_shipped(first_start.kernels_fingerprint()) is not None)
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
    source.write_text(KERNEL)
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
    source.write_text(KERNEL + "# an edit\n")
    assert run(FOUND, code, made) == "False"
    source.write_text(KERNEL)
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
    return shipped_code.pack(["fingerprints.json", "kernel-1"], cache, "x86-64-v4", "0123", tmp_path / "shipped")


def test_an_archive_is_found_by_what_it_fits_and_unpacked_as_it_was(archive: Path, tmp_path: Path) -> None:
    assert shipped_code.find_shipped("0123", archive.parent) == archive
    assert shipped_code.find_shipped("0124", archive.parent) is None
    assert shipped_code.find_shipped("0123", tmp_path / "nowhere") is None
    assert shipped_code.list_shipped(archive.parent) == ["x86-64-v4"]
    assert shipped_code.unpack(archive, tmp_path / "cache")
    found = {str(p.relative_to(tmp_path / "cache")): p.read_bytes() for p in (tmp_path / "cache").rglob("*.*")}
    assert found == {"fingerprints.json": b"{}", "kernel-1/f.1.nbc": b"code", "kernel-1/f.nbi": b"index"}
    assert (tmp_path / "cache" / "kernel-1" / "whole").exists()
    assert not (tmp_path / "cache" / "kernel-1" / "wanted").exists()


@pytest.mark.parametrize("place", [0, 100, -1])
def test_of_an_archive_that_is_damaged_nothing_is_unpacked(
    archive: Path, tmp_path: Path, place: int, caplog: pytest.LogCaptureFixture
) -> None:
    content = bytearray(archive.read_bytes())
    content[place] ^= 1
    archive.write_bytes(content)
    assert not shipped_code.unpack(archive, tmp_path / "cache")
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
