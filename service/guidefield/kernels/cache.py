"""Where numba keeps the machine code of the kernels: a folder for every version of a file and of all that it calls.

numba compares a cached function with the file it stands in, but not with the files of the functions that it calls:
after an edit of a callee it runs the old machine code. A folder named after a hash of a file and of every kernel file
that it imports, directly or not, cannot be stale, and an edit compiles only what depends on it. The sources' place
is not part of the name: all installations of one version share their machine code.
"""

from __future__ import annotations

import functools
import hashlib
import re
from collections.abc import Callable
from pathlib import Path

import numba
from numba.core.caching import CacheImpl, UserProvidedCacheLocator

from guidefield.first_start import cache_parent

_PACKAGE = "guidefield.kernels"
_KEPT = re.compile(r"^@(?:compiled|lane_kernel|lane_step)\(", re.MULTILINE)
_IMPORT = re.compile(
    rf"^\s*(?:from\s+{re.escape(_PACKAGE)}\.(\w+)\s+import"
    rf"|import\s+{re.escape(_PACKAGE)}\.(\w+)"
    rf"|from\s+{re.escape(_PACKAGE)}\s+import\s+(\([^)]*\)|.*))",
    re.MULTILINE,
)


class KernelCacheLocator(UserProvidedCacheLocator):  # type: ignore[misc]  # numba has no types
    """Tells numba the folder of a kernel's machine code; leaves every function outside this package alone."""

    def __init__(self, function: Callable[..., object], file: str) -> None:
        super().__init__(function, file)
        self._folder = kernel_folder(Path(file))

    @classmethod
    def from_function(cls, function: Callable[..., object], file: str) -> KernelCacheLocator | None:
        """A locator if the function is one of our kernels.

        Raises:
            OSError: if its folder cannot be made or written; set ``NUMBA_CACHE_DIR`` to a writable one.
        """
        if Path(file).parent != Path(__file__).parent:
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
    """The files with kernels that numba keeps that have no machine code, by name without a suffix."""
    sources = [source for source in Path(__file__).parent.glob("*.py") if _KEPT.search(source.read_text())]
    return {source.stem for source in sources if not any(kernel_folder(source).glob("*.nbi"))}


def kernel_folder(source: Path) -> Path:
    """The folder of one kernel file's machine code; it need not exist."""
    return cache_folder() / f"{source.stem}-{fingerprint(source)}"


def fingerprint(source: Path) -> str:
    """Sixteen hexadecimal digits that change with numba's version, a file, and what it imports of its folder."""
    digest = hashlib.sha256(numba.__version__.encode())
    for name in sorted(closure(source)):
        digest.update(b"\0" + name.encode() + b"\0" + _read(source.with_name(f"{name}.py"))[0])
    return digest.hexdigest()[:16]


def closure(source: Path) -> set[str]:
    """The file's own name and those of all files that it needs."""
    found = {source.stem}
    waiting = [source.stem]
    while waiting:
        _, imported = _read(source.with_name(f"{waiting.pop()}.py"))
        waiting.extend(imported - found)
        found |= imported
    return found


@functools.cache
def _read(source: Path) -> tuple[bytes, frozenset[str]]:
    """A file's hash and the names of the files beside it that it imports."""
    content = source.read_bytes()
    mentioned: set[str] = set()
    for first, second, several in _IMPORT.findall(content.decode()):
        mentioned.update({first, second} - {""}, re.findall(r"\w+", several))
    beside = frozenset(name for name in mentioned if source.with_name(f"{name}.py").exists())
    return hashlib.sha256(content).digest(), beside
