"""Compile every kernel that has no machine code yet, in several processes, and tell how far that is.

Run as ``python -m guidefield.kernels.jit.compile_ahead`` it prints a line before each file; with ``--child`` it
compiles the files that it reads the names of, and answers each with its name. A process of its own: a program that only
plans doesn't share its memory with the compiler.
"""

from __future__ import annotations

import gc
import importlib
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable

from guidefield.kernels.jit.cache import sources, uncompiled
from guidefield.kernels.jit.compilers import load, quicken
from guidefield.system import usable_processors

Told = Callable[[str], None]  # told, in one sentence, how far it is

_CHILD = "--child"


def compile_missing(told: Told, processes: int | None = None) -> None:
    """Compile what is missing: a file when all that it calls is compiled, those at the head of the longest way first.

    Args:
        told: Told before each file; not at all if nothing is missing.
        processes: How many compile at once; None: as many as there are processors.

    Raises:
        RuntimeError: if a file can't be compiled; with the last line of why.
    """
    missing = uncompiled()
    if not missing:
        return
    work = _Work({name: sources().imported(name) & missing - {name} for name in missing}, told)
    threads = [
        threading.Thread(target=work.in_a_child, daemon=True)
        for _ in range(min(len(missing), processes or usable_processors()))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if work.fault is not None:
        raise RuntimeError(f"a kernel can't be compiled: {work.fault}")


class _Work:
    """Files to compile, and which of them each needs; handed out to threads that each have a child."""

    def __init__(self, needs: dict[str, set[str]], told: Told) -> None:
        self._needs, self._told = needs, told
        self._sizes = {name: _size_of(name) for name in needs}
        self._ahead = _ahead_of(needs, self._sizes)
        self._waiting, self._done = set(needs), set[str]()
        self._changed = threading.Condition()
        self.fault: str | None = None

    def in_a_child(self) -> None:
        """Have a child compile one file after the other until none is left."""
        command = [sys.executable, "-m", "guidefield.kernels.jit.compile_ahead", _CHILD]
        with (
            tempfile.TemporaryFile("w+") as log,  # a pipe that nobody empties meanwhile could fill up
            subprocess.Popen(  # noqa: S603 - it is ourselves
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True
            ) as child,
        ):
            assert child.stdin is not None, "it is piped"
            assert child.stdout is not None, "it is piped"
            known: set[str] = set()
            while (name := self._next(known)) is not None:
                child.stdin.write(f"{name}\n")
                child.stdin.flush()
                answered = child.stdout.readline().strip()
                if answered != name:  # it ends
                    child.wait()
                    log.seek(0)
                with self._changed:
                    if answered == name:
                        self._done.add(name)
                    else:
                        self.fault = (log.read().strip().splitlines() or [f"{name}: no reason told"])[-1]
                    self._changed.notify_all()
            child.stdin.close()

    def _next(self, known: set[str]) -> str | None:
        """The next file whose needs are met, waiting for one if need be; None if there is nothing left to do.

        Parts that it shares with files that the child knows needn't be compiled again: others wait longer.
        """
        with self._changed:
            while self._waiting and self.fault is None:
                ready = [name for name in self._waiting if self._needs[name] <= self._done]
                if ready:
                    name = max(ready, key=lambda one: (self._ahead[one] - 2 * _size_of(one, known), one))
                    known |= sources().imported(name)
                    self._waiting.remove(name)
                    self._told(self._progress(name))
                    return name
                self._changed.wait()
        return None

    def _progress(self, name: str) -> str:
        """How far it is when a file is begun; the share is that of the sources which are compiled."""
        share = 100 * sum(self._sizes[one] for one in self._done) // sum(self._sizes.values())
        begun = len(self._sizes) - len(self._waiting)
        return f"compiling kernels {share} %, once for this version: {begun} of {len(self._sizes)} ({name})"


def _size_of(name: str, known: Iterable[str] = ()) -> int:
    """How much there is to compile of a file [bytes of source], with the files of its parts but those known."""
    return sum(sources().path(one).stat().st_size for one in sources().imported(name).difference(known))


def _ahead_of(needs: dict[str, set[str]], sizes: dict[str, int]) -> dict[str, int]:
    """How much is left to compile from each file on: the longest way through those that need it, by their sizes."""
    found: dict[str, int] = {}
    for name in sorted(needs, key=lambda one: len(needs[one]), reverse=True):  # before what they need
        later = [found[one] for one, needed in needs.items() if name in needed]
        found[name] = sizes[name] + max(later, default=0)
    return found


def _compile_what_is_named() -> None:
    # here only: a program that imports kernels may have numba compile functions of its own
    quicken()
    gc.disable()  # the compiler makes millions of objects, and looking through them all is a fifth of its time
    for line in sys.stdin:
        try:
            load(importlib.import_module(f"guidefield.kernels.{line.strip()}"))
        except Exception as error:
            sys.exit(f"{line.strip()}: {type(error).__name__}: {' '.join(str(error).split())}")
        _tell(line.strip())
        gc.collect()
        gc.freeze()


def _tell(sentence: str) -> None:
    sys.stdout.write(f"{sentence}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    if _CHILD in sys.argv[1:]:
        _compile_what_is_named()
    else:
        compile_missing(_tell)
