"""What a copy of the package needs that compiles kernels."""

import shutil
from pathlib import Path

from guidefield.first_start import KERNELS


def compiling_package(folder: Path) -> Path:
    """A copy, in a folder, of what compiles kernels and of no kernel; the folder of its kernels."""
    copied = folder / "guidefield" / "kernels"
    copied.mkdir(parents=True)
    (copied.parent / "__init__.py").touch()
    for name in ("first_start.py", "whole_file.py"):
        shutil.copy(KERNELS.parent / name, copied.parent)
    shutil.copy(KERNELS / "__init__.py", copied)
    shutil.copytree(KERNELS / "jit", copied / "jit")
    return copied
