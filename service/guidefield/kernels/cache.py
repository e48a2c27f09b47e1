"""Where numba keeps the machine code of the kernels: a folder of its own for every version of their sources.

numba compares a cached function with the file it stands in, but not with the files of the functions that it calls:
after an edit of a callee it runs the old machine code. A folder named after a hash of all sources cannot be stale.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numba

_OWNER = "guidefield"
_PREFIX = "kernels-"


def select_cache_folder() -> Path:
    """Make the folder for these sources, and have numba use it in this process and in those that it starts.

    The folder is ``<parent>/guidefield/kernels-<hash>``. Its parent is numba's configured cache folder
    (``NUMBA_CACHE_DIR``) if there is one, else ``XDG_CACHE_HOME``, else ``~/.cache``.

    Returns:
        The folder; it exists.

    Raises:
        OSError: if the folder cannot be made; set ``NUMBA_CACHE_DIR`` to a writable one.
    """
    folder = _parent() / _OWNER / (_PREFIX + fingerprint(Path(__file__).parent))
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    # Both, because numba reads the environment again when it finds it changed.
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    numba.config.CACHE_DIR = str(folder)
    return folder


def fingerprint(sources: Path) -> str:
    """Sixteen hexadecimal digits that change with numba's version and with any Python file of a folder."""
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(sources.rglob("*.py")):
        digest.update(b"\0" + path.relative_to(sources).as_posix().encode() + b"\0")
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


def _parent() -> Path:
    """The folder that the user chose, also when a process that started this one has already put its own below it."""
    if not numba.config.CACHE_DIR:
        # The specification of XDG has relative paths ignored.
        home = os.environ.get("XDG_CACHE_HOME", "")
        return Path(home) if Path(home).is_absolute() else Path.home() / ".cache"
    chosen = Path(numba.config.CACHE_DIR).absolute()
    if chosen.name.startswith(_PREFIX) and chosen.parent.name == _OWNER:
        return chosen.parent.parent
    return chosen
