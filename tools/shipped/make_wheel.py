"""Make the wheel that brings machine code along, of guidefield's wheel and an environment in which that is installed.

Usage: python tools/shipped/make_wheel.py WHEEL PYTHON FOLDER

PYTHON's version and this family of processors are those that the new wheel is for; it goes to FOLDER, and its path is
printed. Kernels without machine code are compiled, into the user's cache, for every level of processors: that compiles
for processors that this one isn't, too. Object files need no library but those that numba finds them when it loads
them, so the wheel is for any Linux that guidefield's dependencies are for.
"""

from __future__ import annotations

import base64
import hashlib
import os
import platform
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

LEVELS = """
import platform
from guidefield.first_start import LEVELS

print(*(level for level in LEVELS if level.startswith("x86-64") == (platform.machine() == "x86_64")))
"""
"""Print the levels that this family of processors has."""

PACK = """
import sys
from pathlib import Path
from guidefield.first_start import kernels_fingerprint, level
from guidefield.kernels.jit.cache import cache_folder, is_compiled, kernel_folder, sources
from guidefield.first_start import pack

fingerprint = kernels_fingerprint()
folders = [kernel_folder(name).name for name in sources().names if is_compiled(name)]
names = [f"fingerprints-{fingerprint}.json", *folders]
pack(names, cache_folder(), level(), fingerprint, Path(sys.argv[1]))
"""


def main(wheel: Path, python: str, folder: Path) -> Path:
    """Compile, pack, and write the wheel."""
    tag = _ask(python, "import sys; print('cp%d%d' % sys.version_info[:2])")
    with tempfile.TemporaryDirectory() as scratch:
        for level in _ask(python, LEVELS).split():
            environment = {**os.environ, "NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": ""}
            ahead = [python, "-m", "guidefield.kernels.jit.compile_ahead"]
            subprocess.run(ahead, check=True, env=environment, stdout=sys.stderr, cwd=scratch)
            subprocess.run([python, "-c", PACK, scratch], check=True, env=environment, cwd=scratch)
        archives = {
            f"guidefield/machine_code/{path.name}": path.read_bytes() for path in sorted(Path(scratch).iterdir())
        }
    return write_wheel(wheel, archives, f"{tag}-{tag}-manylinux2014_{platform.machine()}", folder)


def _ask(python: str, code: str) -> str:
    return subprocess.run([python, "-c", code], check=True, capture_output=True, text=True).stdout.strip()


def write_wheel(wheel: Path, more: dict[str, bytes], tag: str, folder: Path) -> Path:
    """Write a wheel with more files and another tag than one that is for all machines."""
    with zipfile.ZipFile(wheel) as whole:
        files = {name: whole.read(name) for name in whole.namelist()} | more
    record = next(name for name in files if name.endswith(".dist-info/RECORD"))
    about = record.replace("RECORD", "WHEEL")
    files[about] = files[about].replace(b"Tag: py3-none-any", f"Tag: {tag}".encode())
    del files[record]
    files[record] = "".join(
        [*(f"{name},{_hash(files[name])},{len(files[name])}\n" for name in files), f"{record},,\n"]
    ).encode()
    made = folder / wheel.name.replace("py3-none-any", tag)
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as written:
        for name, content in files.items():
            written.writestr(name, content)
    return made


def _hash(content: bytes) -> str:
    return "sha256=" + base64.urlsafe_b64encode(hashlib.sha256(content).digest()).decode().rstrip("=")


if __name__ == "__main__":
    print(main(Path(sys.argv[1]), str(Path(sys.argv[2]).absolute()), Path(sys.argv[3])))
