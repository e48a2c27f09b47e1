"""The first start of a version on a machine: its kernels are compiled once, before anybody waits for an answer.

Asked without loading the compiler: the process of a service never does.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import platform
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path

KERNELS = Path(__file__).parent / "kernels"

EVERY = 2.0
"""Progress is told at most once in so long [s]."""

AT_FIRST = "compiling kernels 0 %, once for this version: the compiler is loaded"
"""What is told before the compiler tells anything itself, which takes a second or two."""

PATIENCE = 0.2
"""How often it is asked whether to stop [s]."""

CPUINFO = Path("/proc/cpuinfo")
"""Where Linux tells of the processor."""

OF_PROCESSOR = ("vendor_id", "cpu family", "model", "flags", "CPU implementer", "CPU part", "Features")
"""What there says for which processor machine code is made; the others are speeds, numbers and versions."""

CHOSEN = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES")
"""Variables of the environment that have numba compile for another processor."""

PLAIN = "GUIDEFIELD_PLAIN_NUMBA"
"""The variable of the environment that has kernels compiled without changes to what is inside numba."""

KNOWN = ("0.68.0", "0.68.1")
"""Versions of numba with which the changes to what is inside it were tried; any other stays as it is."""


def compile_kernels(told: Callable[[str], None], is_cancelled: Callable[[], bool] = lambda: False) -> None:
    """Compile what has no machine code yet, on all processors; at once if that was done for this version before.

    Args:
        told: Told, in one sentence each, how far it is.
        is_cancelled: Asks whether to end early; what is compiled by then is kept.

    Raises:
        RuntimeError: if a kernel can't be compiled.
    """
    done = compiled_mark()
    if done.exists():
        return
    told(AT_FIRST)
    last = -EVERY
    command = [sys.executable, "-m", "guidefield.kernels.jit.compile_ahead"]
    with (
        tempfile.TemporaryFile("w+") as log,  # a pipe that nobody empties meanwhile could fill up
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, process_group=0) as child,  # noqa: S603 - ourselves
    ):
        try:
            for line in _lines(child, is_cancelled):
                if time.monotonic() - last >= EVERY:
                    told(line)
                    last = time.monotonic()
            if is_cancelled():
                return
            child.wait()
        finally:
            if child.poll() is None:
                os.killpg(child.pid, signal.SIGKILL)  # it and those who compile for it
        log.seek(0)
        fault = log.read().strip()
    if child.returncode != 0:
        raise RuntimeError(fault.splitlines()[-1] if fault else "the kernels' compiler ended without a reason")
    done.parent.mkdir(parents=True, exist_ok=True)
    done.touch()


def compiled_mark() -> Path:
    """The file that is there once all kernels of this version are compiled."""
    return cache_parent() / "guidefield" / "kernels" / f"all-{kernels_fingerprint()}"


def _lines(child: subprocess.Popen[bytes], is_cancelled: Callable[[], bool]) -> Iterator[str]:
    """Yield what a child prints, line by line, until it ends or is to end."""
    assert child.stdout is not None, "it is piped"
    rest = b""
    while not is_cancelled():
        if select.select([child.stdout], [], [], PATIENCE)[0]:
            read = os.read(child.stdout.fileno(), 1 << 16)
            if not read:
                return
            *lines, rest = (rest + read).split(b"\n")
            yield from (line.decode() for line in lines)


def cache_parent() -> Path:
    """The folder that holds those of all caches: ``NUMBA_CACHE_DIR``, else ``XDG_CACHE_HOME``, else ``~/.cache``."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR", ""):
        return Path(chosen).absolute()
    # The specification of XDG has relative paths ignored.
    home = os.environ.get("XDG_CACHE_HOME", "")
    return Path(home) if Path(home).is_absolute() else Path.home() / ".cache"


def plain_numba() -> bool:
    """Return whether kernels are compiled by what numba offers to everybody: its version isn't known, or by `PLAIN`."""
    return version("numba") not in KNOWN or os.environ.get(PLAIN, "") not in ("", "0")


def kernel_compiler() -> str:
    """Name the compiler of kernels and the processor: machine code of another one is not used."""
    return f"{'plain ' if plain_numba() else ''}numba {version('numba')} for {processor()}"


@functools.cache
def processor(told: Path = CPUINFO) -> str:
    """The processor that numba compiles for, and what it can do, as eight hexadecimal digits after its family.

    Machines that share a home folder share no machine code unless their processors are of the same kind.

    Args:
        told: Where the system tells of it; where it doesn't, only the family counts.
    """
    lines: set[str] = set()
    with contextlib.suppress(OSError):
        for line in told.read_text().splitlines():
            name, _, value = line.partition(":")
            if name.strip() in OF_PROCESSOR:
                lines.add(f"{name.strip()} {' '.join(sorted(value.split()))}")
    lines |= {f"{name} {os.environ[name]}" for name in CHOSEN if name in os.environ}
    return f"{platform.machine()} {hashlib.sha256(chr(10).join(sorted(lines)).encode()).hexdigest()[:8]}"


@functools.cache
def kernels_fingerprint() -> str:
    """Sixteen hexadecimal digits that change with Python, what compiles kernels, the processor, and every kernel."""
    digest = hashlib.sha256(f"{sys.implementation.cache_tag} {kernel_compiler()}".encode())
    for source in sorted(KERNELS.rglob("*.py")):
        name = str(source.relative_to(KERNELS))
        digest.update(name.encode() + b"\0" + hashlib.sha256(source.read_bytes()).digest())
    return digest.hexdigest()[:16]
