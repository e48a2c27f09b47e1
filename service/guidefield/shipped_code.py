"""Machine code of the kernels that comes with the package: unpacked into the user's cache where it fits.

The wheel for one version of Python and one family of processors has an archive for each level of these. The name of an
archive tells what it fits, by the fingerprint that names the kernels of a version in the cache, too, and the hash of
its content: machine code of another version, level or compiler is left alone, and nothing that is damaged is unpacked.
"""

from __future__ import annotations

import hashlib
import io
import logging
import tarfile
from collections.abc import Sequence
from pathlib import Path

from guidefield.whole_file import write_whole

SHIPPED = Path(__file__).parent / "machine_code"
"""The folder of the archives; only some wheels have it."""
ENDING = ".tar.xz"

_log = logging.getLogger(__name__)


def list_shipped(folder: Path = SHIPPED) -> list[str]:
    """List the levels of processors that there is machine code for, of `LEVELS` of `first_start.py`."""
    return sorted(path.name.rsplit(".", 4)[0] for path in folder.glob(f"*{ENDING}"))


def find_shipped(fingerprint: str, folder: Path = SHIPPED) -> Path | None:
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
