"""Have machine code of all kernels once per version and machine: what is shipped, or what a child process compiles.

The wheel for one version of Python and one family of processors has an archive of machine code for each level of these.
Its name has the fingerprint that names the kernels of a version in the user's cache, and the hash of its content: an
archive of another version, level or compiler is left alone, and nothing that is damaged is unpacked.

This process never loads the compiler. Whoever makes one plan needn't wait for all kernels: the child says when what a
first plan needs is compiled, and goes on by itself with the rest, at low priority. A kernel that is called before its
turn waits for it (`jit.cache`).
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import hashlib
import io
import logging
import os
import platform
import select
import signal
import subprocess
import sys
import tarfile
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path

from guidefield.whole_file import write_whole

ARCHIVES = Path(__file__).parent / "machine_code"
"""The folder of the archives; only some wheels have it."""
ENDING = ".tar.xz"

_log = logging.getLogger(__name__)


def list_shipped(folder: Path = ARCHIVES) -> list[str]:
    """List the levels of processors that there is machine code for, of `LEVELS`."""
    return sorted(path.name.rsplit(".", 4)[0] for path in folder.glob(f"*{ENDING}"))


def find_shipped(fingerprint: str, folder: Path = ARCHIVES) -> Path | None:
    """Find the archive of a version's kernels; None if there is none that fits."""
    return next(folder.glob(f"*.{fingerprint}.*{ENDING}"), None)


def unpack(archive: Path, cache: Path) -> bool:
    """Unpack an archive into the folder of all kernels' machine code; return whether it was whole.

    Raises:
        OSError: if the folder takes no files.
    """
    content = archive.read_bytes()
    if _hash(content) != archive.name.removesuffix(ENDING).rpartition(".")[2]:
        _log.warning("%s is damaged, and the kernels are compiled instead: install guidefield again", archive)
        return False
    try:
        with tarfile.open(fileobj=io.BytesIO(content), mode="r:xz") as packed:
            for member in packed:
                file = packed.extractfile(member)
                assert file is not None, "only files are packed"
                path = cache / member.name
                path.parent.mkdir(parents=True, exist_ok=True)
                write_whole(path, file.read(), durable=False)
    except tarfile.CompressionError:  # a Python that was built without it
        _log.warning("this Python can't read .xz files, and the kernels are compiled instead")
        return False
    return True


def pack(names: Sequence[str], cache: Path, level: str, fingerprint: str, folder: Path) -> Path:
    """Pack files and folders of a cache into an archive, and return it.

    Args:
        names: Their names; of a folder numba's files are packed, and then what says that they are whole.
        cache: The folder of all kernels' machine code.
        level: The level of processors that it was compiled for.
        fingerprint: The fingerprint of the version's kernels.
        folder: Where the archive goes.
    """
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:xz") as archive:
        for name in names:
            within = [path for ending in ("*.nbc", "*.nbi", "whole") for path in sorted((cache / name).glob(ending))]
            for path in within or [cache / name]:
                member = tarfile.TarInfo(str(path.relative_to(cache)))
                member.size = path.stat().st_size
                with path.open("rb") as file:
                    archive.addfile(member, file)
    made = folder / f"{level}.{fingerprint}.{_hash(packed.getvalue())}{ENDING}"
    made.parent.mkdir(parents=True, exist_ok=True)
    made.write_bytes(packed.getvalue())
    return made


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


KERNELS = Path(__file__).parent / "kernels"

PROGRESS_PERIOD_S = 2.0  # shortest time between two progress messages [s]
FIRST_PROGRESS = "compiling kernels 0 %, once for this version: the compiler is loaded"
"""The first progress message, a second or two before the compiler's own."""
READY = "compiled what a first plan needs"
"""The line that the child prints then."""
UNTIL_READY = "--until-ready"
"""The child's option where nobody waits for more."""
POLL_PERIOD_S = 0.2  # period at which cancellation is checked [s]
CPUINFO = Path("/proc/cpuinfo")  # Linux's description of the processor
CPU_FIELDS = ("vendor_id", "cpu family", "model", "flags", "CPU implementer", "CPU part", "Features")
"""Its fields that determine machine code; the others are speeds, numbers and versions."""
TARGET_VARIABLES = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")
"""Environment variables that make numba compile for another processor."""
_V3 = "abm avx avx2 bmi1 bmi2 cx16 f16c fma lahf_lm movbe popcnt sse4_1 sse4_2 ssse3 xsave"
LEVELS = {
    "x86-64-v4": f"{_V3} avx512bw avx512cd avx512dq avx512f avx512vl",
    "x86-64-v3": _V3,
    "generic": "asimd fp",  # any aarch64
}
"""Levels of processors that kernels are compiled for, the highest of a family first: LLVM's name of each, and what
Linux calls the features that each of its processors has. With too few of these machine code would be run by processors
that can't."""
SHIPPED = "shipped"  # what the marker of kernels says whose machine code came with the package
PLAIN_VARIABLE = "GUIDEFIELD_PLAIN_NUMBA"  # the environment variable that disables the changes to numba's internals
KNOWN_NUMBA = ("0.68.0", "0.68.1")
"""Versions of numba whose internals `kernels/jit` changes; with others kernels are compiled by plain numba, slower."""


class CannotStart(RuntimeError):
    """A command or service can't begin its work; says why in one sentence."""


def compile_kernels(
    told: Callable[[str], None], is_cancelled: Callable[[], bool] = lambda: False, *, wholly: bool = True
) -> None:
    """Compile the kernels without machine code, on all processors; return at once if it is shipped or kept of all.

    Args:
        told: Takes progress messages of one sentence.
        is_cancelled: Asks whether to end early; kernels compiled by then stay.
        wholly: Whether to wait for all of them; else for those of a first plan, and the rest is compiled beside it,
            also after the end of this process.

    Raises:
        CannotStart: if a kernel can't be compiled.
    """
    if compiled_marker().exists() or _take_shipped():
        return
    command = [sys.executable, "-m", "guidefield.kernels.jit.compile_ahead", *([] if wholly else [UNTIL_READY])]
    if not wholly and ready_marker().exists():
        if not is_compiling():  # the rest was left, as its compiler was ended
            rest = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, process_group=0)  # noqa: S603 - ourselves
            threading.Thread(target=rest.wait, daemon=True).start()
        return
    told(FIRST_PROGRESS)
    last = -PROGRESS_PERIOD_S
    with tempfile.TemporaryFile("w+") as log:  # a pipe that nobody reads could fill up
        child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, process_group=0)  # noqa: S603 - ourselves
        is_left = False
        try:
            for line in _read_lines(child, is_cancelled):
                if line == READY and not wholly:
                    is_left = True
                    threading.Thread(target=child.wait, daemon=True).start()  # so that it is no zombie when it ends
                    return
                if line != READY and time.monotonic() - last >= PROGRESS_PERIOD_S:
                    told(line)
                    last = time.monotonic()
            if is_cancelled():
                return
            child.wait()
        finally:
            if not is_left and child.poll() is None:
                os.killpg(child.pid, signal.SIGKILL)  # and its own children
                child.wait()
            assert child.stdout is not None, "it is piped"
            child.stdout.close()
        log.seek(0)
        fault = log.read().strip()
    if child.returncode < 0:
        ended = signal.Signals(-child.returncode).name
        raise CannotStart(f"the kernels' compiler was ended by {ended}; what is compiled is kept: start again")
    if child.returncode != 0:
        raise CannotStart(fault.splitlines()[-1] if fault else "the kernels' compiler ended without a reason")


def _take_shipped() -> bool:
    """Unpack the machine code that came with the package, if some fits; return whether all is there then."""
    archive = find_shipped(kernels_fingerprint())
    if archive is None:
        return False
    try:
        if not unpack(archive, compiled_marker().parent):
            return False
        compiled_marker().write_text(SHIPPED)
    except OSError:
        return False  # the compiler says what can't be written
    return True


def compiled_marker() -> Path:
    """Return the file that exists once all kernels of this version are compiled; `SHIPPED` is in it if by others."""
    return cache_parent() / "guidefield" / "kernels" / f"all-{kernels_fingerprint()}"


def ready_marker() -> Path:
    """Return the file that exists from when a first plan's kernels are compiled until all are."""
    return compiled_marker().with_name(f"first-{kernels_fingerprint()}")


def compiling_lock() -> Path:
    """Return the file that a process locks as long as it compiles this version's kernels."""
    return compiled_marker().with_name(f"compiling-{kernels_fingerprint()}")


def is_compiling() -> bool:
    """Return whether a process compiles this version's kernels; False where a file system has no locks."""
    try:
        with compiling_lock().open() as lock:
            fcntl.flock(lock, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _read_lines(child: subprocess.Popen[bytes], is_cancelled: Callable[[], bool]) -> Iterator[str]:
    assert child.stdout is not None, "it is piped"
    rest = b""
    while not is_cancelled():
        if select.select([child.stdout], [], [], POLL_PERIOD_S)[0]:
            read = os.read(child.stdout.fileno(), 1 << 16)
            if not read:
                return
            *lines, rest = (rest + read).split(b"\n")
            yield from (line.decode() for line in lines)


def cache_parent() -> Path:
    """Return the parent folder of all caches: ``NUMBA_CACHE_DIR``, else ``XDG_CACHE_HOME``, else ``~/.cache``."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR", ""):
        return Path(chosen).absolute()
    # The specification of XDG has relative paths ignored.
    home = os.environ.get("XDG_CACHE_HOME", "")
    return Path(home) if Path(home).is_absolute() else Path.home() / ".cache"


def plain_numba() -> bool:
    """Return whether numba's internals stay unchanged: its version isn't known, or `PLAIN_VARIABLE` is set."""
    return version("numba") not in KNOWN_NUMBA or os.environ.get(PLAIN_VARIABLE, "") not in ("", "0")


def kernel_compiler() -> str:
    """Name the compiler of kernels and the processor; machine code of another one isn't used."""
    compiler = f"{'plain ' if plain_numba() else ''}numba {version('numba')}"
    target = processor() if level() is None else f"{platform.machine()} {level()}"
    return f"{compiler} for {target}, by llvmlite {version('llvmlite')}"


def level() -> str | None:
    """Return the level in `LEVELS` that kernels are compiled for, which all of its processors share machine code of.

    None: this very processor, as it has no level, another one is asked for, or numba is plain.
    """
    if plain_numba():
        return None
    asked = [os.environ.get(name) for name in TARGET_VARIABLES]
    if asked != [None, None]:
        return asked[0] if asked[0] in LEVELS and asked[1] == "" else None
    return find_level(CPUINFO)


@functools.cache
def find_level(told: Path) -> str | None:
    """Find the highest level of a processor, by the system's description; None: it has none."""
    flags: set[str] = set()
    with contextlib.suppress(OSError):  # a sandbox may have none, or forbid to read it
        for line in told.read_text().splitlines():
            name, _, value = line.partition(":")
            if name.strip() in ("flags", "Features"):
                flags.update(value.split())
    return next((name for name, needed in LEVELS.items() if flags.issuperset(needed.split())), None)


def target_variables() -> dict[str, str]:
    """Return the environment variables that have numba compile for the level, if there is one."""
    name = level()
    return {} if name is None else dict(zip(TARGET_VARIABLES, (name, ""), strict=True))


@functools.cache
def processor() -> str:
    """Return `name_processor` of this machine."""
    return name_processor(CPUINFO)


def name_processor(told: Path) -> str:
    """Name the processor that numba compiles for: its family, and eight hexadecimal digits of its features.

    Machines that share a home folder share no machine code unless their processors are of the same kind.

    Args:
        told: The system's description; if there is none, only the family counts.
    """
    lines: set[str] = set()
    with contextlib.suppress(OSError):
        for line in told.read_text().splitlines():
            name, _, value = line.partition(":")
            if name.strip() in CPU_FIELDS:
                lines.add(f"{name.strip()} {' '.join(sorted(value.split()))}")
    lines |= {f"{name} {os.environ[name]}" for name in TARGET_VARIABLES if name in os.environ}
    return f"{platform.machine()} {hashlib.sha256(chr(10).join(sorted(lines)).encode()).hexdigest()[:8]}"


@functools.cache
def kernels_fingerprint() -> str:
    """Return sixteen hexadecimal digits that change with Python, the compiler, the processor, and every kernel."""
    digest = hashlib.sha256(f"{sys.implementation.cache_tag}{sys.abiflags} {kernel_compiler()}".encode())
    for source in sorted(KERNELS.rglob("*.py")):
        name = str(source.relative_to(KERNELS))
        digest.update(name.encode() + b"\0" + hashlib.sha256(source.read_bytes()).digest())
    return digest.hexdigest()[:16]
