"""Compile every kernel that has no machine code yet, in several processes, and tell how far that is.

Run as ``python -m guidefield.kernels.jit.compile_ahead`` it prints a line before each file, and one once all is
compiled that a first plan needs: that comes first, then what somebody waits for, then the rest. With ``--child`` it
compiles the files that it reads the names of, and answers each with its name. A process of its own: a program that only
plans doesn't share its memory with the compiler.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable

from guidefield.first_start import READY, UNTIL_READY, compiled_marker, ready_marker, target_variables
from guidefield.kernels.jit.cache import compile_alone, is_wanted, note_compiled, sources, uncompiled
from guidefield.kernels.jit.decorators import load, quicken
from guidefield.parallel import usable_processors

Told = Callable[[str], None]  # told, in one sentence, how far it is

FIRST = (
    "collide.batch_collision",
    "collide.layout",
    "collide.near_pairs",
    "collide.parts",
    "collide.primitive",
    "cover.ball_cover",
    "cover.crop_to_ball",
    "cover.cut_halves",
    "cover.enclosing_ball",
    "cover.inscribed",
    "cover.mesh_cleaning",
    "cover.pieces",
    "distance.distance",
    "distance.polygons",
    "distance.triangle_rows",
    "distance.winding",
    "kinematics.inverse_kinematics",
    "linalg.small_systems",
    "optimize.clearance_model",
    "optimize.newton_descent",
    "optimize.obstacle_barrier",
    "optimize.robot_barrier",
    "prove.placement",
    "prove.search",
    "timing.hermite",
    "timing.path_parameterization",
    "timing.torques",
    "timing.travel",
    "tree.rrt_connect",
    "tree.shortcut",
)
"""Files that, with all they call, a plan to a configuration or pose needs for a robot that nothing is kept of.

tests/test_first_start.py finds those that are missing; one too many delays the first plan."""
_CHILD = "--child"
_TURN_S = 0.5  # period at which a process looks whether another one is done compiling, and says that it waits [s]
_LATER = 10  # how nice the compilers are with what nobody waits for


def compile_missing(told: Told, processes: int | None = None, *, until_ready: bool = False) -> None:
    """Compile what is missing: a file when all that it calls is compiled.

    Of such files those come first after which most is left to compile, one after the other (`_ahead_of`).

    Args:
        told: Told before each file, and once a first plan can be made; not at all if nothing is missing.
        processes: How many compile at once; None: one for each processor.
        until_ready: Whether only the way to a first plan is announced.

    Raises:
        RuntimeError: if a file can't be compiled; with the last line of why.
    """
    missing = uncompiled()
    if not missing:
        return
    work = _Work({name: sources().called(name) & missing - {name} for name in missing}, told, until_ready)
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

    def __init__(self, needs: dict[str, set[str]], told: Told, until_ready: bool) -> None:
        self._needs, self._told = needs, told
        self._sizes = {name: _size_of(name) for name in needs}
        self._ahead = _ahead_of(needs, self._sizes)
        self._waiting, self._done = set(needs), set[str]()
        self._first = find_needed_first() & set(needs)
        self._counted = self._first if until_ready else set(needs)
        if not self._first:
            told(READY)
        self._changed = threading.Condition()
        self.fault: str | None = None

    def in_a_child(self) -> None:
        """Have a child compile one file after the other until none is left."""
        command = [sys.executable, "-m", "guidefield.kernels.jit.compile_ahead", _CHILD]
        with (
            tempfile.TemporaryFile("w+") as log,  # a pipe that nobody empties could fill up
            subprocess.Popen(  # noqa: S603 - it is ourselves
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                env={**os.environ, **target_variables()},
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
                        self._end(name)
                    else:
                        self.fault = (log.read().strip().splitlines() or [f"{name}: no reason told"])[-1]
                    self._changed.notify_all()
            child.stdin.close()

    def _next(self, known: set[str]) -> str | None:
        """The next file whose needs are met, waiting for one if need be; None if there is nothing left to do.

        Parts that it shares with files that the child knows needn't be compiled again: what would have to be counts
        against a file, twice (unrecorded), as its own size counts for it in `_ahead`.
        """
        with self._changed:
            while self._waiting and self.fault is None:
                ready = [name for name in self._waiting if self._needs[name] <= self._done]
                if ready:
                    urgent = self._first & self._waiting or self._find_wanted()
                    chosen = [name for name in ready if name in urgent] or ready
                    name = max(chosen, key=lambda one: (self._ahead[one] - 2 * _size_of(one, known), one))
                    known |= sources().imported(name)
                    self._waiting.remove(name)
                    if name in self._counted:
                        self._told(self._progress(name))
                    return name
                self._changed.wait()
        return None

    def _find_wanted(self) -> set[str]:
        """What somebody waits for, with all that it needs."""
        wanted = [name for name in self._waiting if is_wanted(name)]
        return set().union(wanted, *(self._needs[name] for name in wanted))

    def _end(self, name: str) -> None:
        """Note that a file is compiled; tell once a first plan can be made."""
        self._done.add(name)
        if name in self._first and self._first <= self._done:
            self._told(READY)

    def _progress(self, name: str) -> str:
        """How far it is when a file is begun; the share is that of the sources which are compiled."""
        done, counted = (sum(map(self._sizes.__getitem__, of & self._counted)) for of in (self._done, self._counted))
        begun = f"{len(self._counted - self._waiting)} of {len(self._counted)}"
        return f"compiling kernels {100 * done // counted} %, once for this version: {begun} ({name})"


def find_needed_first() -> set[str]:
    """Find all files that a first plan needs."""
    names = set(sources().names)
    return set().union(*(sources().called(name) for name in FIRST if name in names))


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
        note_compiled(line.strip())
        _tell(line.strip())
        gc.collect()
        gc.freeze()


def _tell(sentence: str) -> None:
    sys.stdout.write(f"{sentence}\n")
    sys.stdout.flush()


def _compile_for_all(until_ready: bool) -> None:
    """Compile what is missing, or wait until another process has; `until_ready`: for what a first plan needs."""

    def tell(sentence: str) -> None:
        if sentence == READY:
            ready_marker().touch()
        with contextlib.suppress(BrokenPipeError):  # the process that waited for a first plan may have ended
            _tell(sentence)
        if sentence == READY and until_ready:
            os.setpriority(os.PRIO_PGRP, 0, _LATER)

    while True:
        with compile_alone() as alone:
            if alone:
                compile_missing(tell, until_ready=until_ready)
                compiled_marker().touch()
                ready_marker().unlink(missing_ok=True)
                break
        missing = uncompiled()
        if until_ready and not find_needed_first() & missing:
            _tell(READY)
            break
        tell(f"another process compiles the kernels, once for this version: {len(missing)} files are left")
        time.sleep(_TURN_S)
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # nothing is flushed into a broken pipe at exit


if __name__ == "__main__":
    if _CHILD in sys.argv[1:]:
        _compile_what_is_named()
    else:
        try:
            _compile_for_all(UNTIL_READY in sys.argv[1:])
        except OSError as error:
            sys.exit(f"machine code can't be kept: {error}; set NUMBA_CACHE_DIR to another folder")
        except RuntimeError as error:
            sys.exit(str(error))
