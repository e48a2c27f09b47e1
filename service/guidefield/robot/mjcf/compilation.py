"""MuJoCo compiles an MJCF: defaults, includes, angles, orientations, frames and meshes are settled by it alone."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from guidefield.errors import RobotInvalid

INSTALL_IT = "MuJoCo reads MJCF: install the extra `mujoco` (pip install 'guidefield[mujoco]')"

_ROOT = re.compile(r"(?:\ufeff|\s+|<\?.*?\?>|<!--.*?-->)*+<mujoco(?:include)?[\s/>]", re.DOTALL)
_FILE = re.compile(r"""\bfile[a-z]*\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_ALONE = threading.Lock()
"""MuJoCo has one handler of warnings for the process."""


@dataclass(frozen=True, eq=False)
class CompiledModel:
    """An MJCF as MuJoCo has compiled it.

    Attributes:
        model: `mujoco.MjModel`.
        files: Every file that was read: the MJCF, what it includes, meshes, textures.
        warnings: MuJoCo's own.
    """

    model: Any
    files: tuple[Path, ...]
    warnings: tuple[str, ...]


def is_mjcf(text: str) -> bool:
    """Return True if the root element of a text is <mujoco>, or <mujocoinclude>."""
    return _ROOT.match(text) is not None


def compile_file(path: Path) -> CompiledModel:
    """Compile an MJCF file and all that it names.

    Raises:
        RobotInvalid: if the package `mujoco` is missing, or if MuJoCo refuses the file; with MuJoCo's reason.
    """
    mujoco = import_mujoco()
    model, warnings = _compiled(path.name, lambda: mujoco.MjModel.from_xml_path(str(path)))
    files = (Path(file) for file in mujoco.mju_getXMLDependencies(str(path)))
    return CompiledModel(model, tuple(path.parent / file for file in files), warnings)


def compile_text(text: str) -> CompiledModel:
    """Compile an MJCF that names no file.

    Raises:
        RobotInvalid: if the package `mujoco` is missing, if the text names a file, or if MuJoCo refuses it.
    """
    for double, single in _FILE.findall(text):
        file = (double or single)[:200]
        raise RobotInvalid(
            f"an MJCF that is sent as text must name no file, it names {file!r}; name the MJCF itself as a `urdf_file` "
            "on the machine that has its files",
            file=file,
        )
    mujoco = import_mujoco()
    model, warnings = _compiled("MJCF", lambda: mujoco.MjModel.from_xml_string(text))
    return CompiledModel(model, (), warnings)


def import_mujoco() -> Any:
    """The package `mujoco`.

    Raises:
        RobotInvalid: if it isn't installed.
    """
    try:
        import mujoco  # type: ignore[import-untyped]
    except ImportError:
        raise RobotInvalid(INSTALL_IT) from None
    return mujoco


def _compiled(name: str, load: Callable[[], Any]) -> tuple[Any, tuple[str, ...]]:
    """The model and MuJoCo's warnings, which it would write to a file in the working folder."""
    mujoco = import_mujoco()
    warnings: list[str] = []
    with _ALONE:
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(warnings.append)
        try:
            model = load()
        except (ValueError, mujoco.FatalError) as error:
            raise RobotInvalid(f"MuJoCo can't compile {name}: {' '.join(str(error).split())}") from None
        finally:
            mujoco.set_mju_user_warning(before)
    return model, tuple(f"MuJoCo: {' '.join(text.split())}" for text in dict.fromkeys(warnings))
