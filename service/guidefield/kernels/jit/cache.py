"""Where numba keeps the machine code of the kernels: a folder for every version of a file and of all that it calls.

numba compares a cached function with the file it stands in, but not with the files of the functions that it calls:
after an edit of a callee it runs the old machine code. A folder named after a fingerprint of a file and of every
definition that it depends on cannot be stale, and an edit compiles only what depends on it. The sources' place is not
part of the name: all installations of one version share their machine code.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import json
import re
from collections.abc import Callable
from pathlib import Path

from numba import config
from numba.core.caching import UserProvidedCacheLocator

from guidefield.first_start import KERNELS, cache_parent, kernel_compiler, kernels_fingerprint
from guidefield.kernels.jit.dependencies import Sources
from guidefield.whole_file import write_whole

_KEPT = re.compile(r"^@(?:compiled|lane_kernel|lane_step)\(", re.MULTILINE)

_NUMBAS_OWN = "UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator,IPythonCacheLocator,ZipCacheLocator"
"""Whom numba asks for folders, where the variable ``NUMBA_CACHE_LOCATOR_CLASSES`` says nothing else."""


class KernelCacheLocator(UserProvidedCacheLocator):  # type: ignore[misc]  # numba has no types
    """Tells numba the folder of a kernel's machine code; leaves every function that is none of ours alone."""

    def __init__(self, function: Callable[..., object], file: str, folder: Path) -> None:
        super().__init__(function, file)
        self._folder = folder

    @classmethod
    def from_function(cls, function: Callable[..., object], file: str) -> KernelCacheLocator | None:
        """A locator if the function is one of our kernels.

        Whether a folder can be written is asked where there is none yet, and by numba before it writes: of one on a
        disk that is only read kernels are loaded.

        Raises:
            OSError: if its folder cannot be made or written; set ``NUMBA_CACHE_DIR`` to a writable one.
        """
        folder = _folder_of(Path(file))
        if folder is None:
            return None
        locator = cls(function, file, folder)
        if not folder.is_dir():
            locator.ensure_cache_path()
        return locator

    def get_cache_path(self) -> str:
        """The folder of the machine code."""
        return str(self._folder)


def use_kernel_folders() -> None:
    """Have numba ask `KernelCacheLocator` first, in this process.

    Before every kernel: numba reads its settings again when a variable of the environment has changed.
    """
    ours, others = f"{__name__}.{KernelCacheLocator.__name__}", config.CACHE_LOCATOR_CLASSES or _NUMBAS_OWN
    if not others.startswith(ours):
        config.CACHE_LOCATOR_CLASSES = f"{ours},{others}"


def is_kept(function: Callable[..., object]) -> bool:
    """Whether a function is one of the kernels whose machine code is kept."""
    file = Path(inspect.getfile(function))
    return any(file.is_relative_to(folder) for folder in (KERNELS, *(known.folder for known in _OTHERS.values())))


def keep_kernels_of(package: str, folder: Path) -> None:
    """Keep machine code of the kernels of another package too, which may call ours; that of the tests, for instance.

    Args:
        package: Its name.
        folder: Where its files are.
    """
    _OTHERS[package] = Sources(folder, package, sources())


def cache_folder() -> Path:
    """The folder of all kernels' machine code: ``<parent>/guidefield/kernels``.

    The parent is that of all caches (`first_start`).
    """
    return cache_parent() / "guidefield" / "kernels"


def uncompiled() -> set[str]:
    """The files with kernels that numba keeps that have no machine code, by name."""
    known = sources()
    kept = [name for name in known.names if _KEPT.search(known.path(name).read_text())]
    return {name for name in kept if not any(kernel_folder(name).glob("*.nbi"))}


def kernel_folder(name: str) -> Path:
    """The folder of one kernel file's machine code; it need not exist."""
    return cache_folder() / f"{name}-{_fingerprints()[name]}"


_OTHERS: dict[str, Sources] = {}
"""Other packages whose kernels are kept, by name."""


def _folder_of(file: Path) -> Path | None:
    """The folder of a file's machine code; None for one that has no kernels of ours."""
    if file.is_relative_to(KERNELS):
        return kernel_folder(_name(file, KERNELS))
    for package, known in _OTHERS.items():
        if file.is_relative_to(known.folder):
            name = _name(file, known.folder)
            return cache_folder() / f"{package}.{name}-{known.fingerprint(name, kernel_compiler())}"
    return None


def _name(file: Path, folder: Path) -> str:
    """A file's name below a folder, with dots."""
    return ".".join(file.relative_to(folder).with_suffix("").parts)


@functools.cache
def sources() -> Sources:
    """The kernels' sources as they are when they are first asked for."""
    return Sources(KERNELS, "guidefield.kernels")


@functools.cache
def _fingerprints() -> dict[str, str]:
    """Every file's fingerprint, by name: worked out once for a version and kept with the machine code."""
    kept = cache_folder() / f"fingerprints-{kernels_fingerprint()}.json"
    with contextlib.suppress(OSError, ValueError):
        found: dict[str, str] = json.loads(kept.read_text())
        return found
    known = sources()
    made = {name: known.fingerprint(name, kernel_compiler()) for name in known.names}
    with contextlib.suppress(OSError):  # where nothing can be written, numba says so at the first kernel
        kept.parent.mkdir(parents=True, exist_ok=True)
        write_whole(kept, json.dumps(made).encode(), durable=False)
    return made
