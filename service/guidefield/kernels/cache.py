"""Where numba keeps the machine code of the kernels: a folder for every version of a file and of all that it calls.

numba compares a cached function with the file it stands in, but not with the files of the functions that it calls:
after an edit of a callee it runs the old machine code. A folder named after a fingerprint of a file and of every
definition that it depends on cannot be stale, and an edit compiles only what depends on it. The sources' place is not
part of the name: all installations of one version share their machine code.
"""

from __future__ import annotations

import contextlib
import functools
import json
import re
from collections.abc import Callable
from pathlib import Path

import numba
from numba.core.caching import CacheImpl, UserProvidedCacheLocator

from guidefield.first_start import KERNELS, cache_parent, kernels_fingerprint
from guidefield.kernels.dependencies import Sources
from guidefield.whole_file import write_whole

_KEPT = re.compile(r"^@(?:compiled|lane_kernel|lane_step)\(", re.MULTILINE)


class KernelCacheLocator(UserProvidedCacheLocator):  # type: ignore[misc]  # numba has no types
    """Tells numba the folder of a kernel's machine code; leaves every function outside this package alone."""

    def __init__(self, function: Callable[..., object], file: str) -> None:
        super().__init__(function, file)
        self._folder = kernel_folder(_name(Path(file)))

    @classmethod
    def from_function(cls, function: Callable[..., object], file: str) -> KernelCacheLocator | None:
        """A locator if the function is one of our kernels.

        Raises:
            OSError: if its folder cannot be made or written; set ``NUMBA_CACHE_DIR`` to a writable one.
        """
        if not Path(file).is_relative_to(KERNELS):
            return None
        locator = cls(function, file)
        locator.ensure_cache_path()
        return locator

    def get_cache_path(self) -> str:
        """The folder of the machine code."""
        return str(self._folder)


def use_kernel_folders() -> None:
    """Have numba ask `KernelCacheLocator` first, in this process."""
    if CacheImpl._locator_classes[0] is not KernelCacheLocator:
        CacheImpl._locator_classes.insert(0, KernelCacheLocator)


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


def _name(file: Path) -> str:
    """A kernel file's name below the folder of all kernels, with dots."""
    return ".".join(file.relative_to(KERNELS).with_suffix("").parts)


@functools.cache
def sources() -> Sources:
    """The kernels' sources as they are when they are first asked for."""
    return Sources(KERNELS, __package__)


@functools.cache
def _fingerprints() -> dict[str, str]:
    """Every file's fingerprint, by name: worked out once for a version and kept with the machine code."""
    kept = cache_folder() / f"fingerprints-{kernels_fingerprint()}.json"
    with contextlib.suppress(OSError, ValueError):
        found: dict[str, str] = json.loads(kept.read_text())
        return found
    known = sources()
    made = {name: known.fingerprint(name, numba.__version__) for name in known.names}
    with contextlib.suppress(OSError):  # where nothing can be written, numba says so at the first kernel
        kept.parent.mkdir(parents=True, exist_ok=True)
        write_whole(kept, json.dumps(made).encode(), durable=False)
    return made
