"""Texts of a robot in local files, expanded where they are xacro."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from guidefield.errors import RobotInvalid
from guidefield.robot.urdf.encoding import read_xml
from guidefield.robot.urdf.meshes import MeshResolver
from guidefield.robot.urdf.xacro_files import ArgumentValue, Expanded, expand, is_xacro


@dataclass(frozen=True)
class Description:
    """A robot's texts.

    Attributes:
        urdf: Its URDF.
        srdf: Its SRDF; None without one.
        files: Files that they were made from, beside the two that are named.
        warnings: What xacro said.
    """

    urdf: str
    srdf: str | None
    files: tuple[Path, ...] = ()
    warnings: tuple[str, ...] = ()


def read_description(
    urdf: Path, srdf: Path | None, xacro_args: Mapping[str, ArgumentValue], resolver: MeshResolver
) -> Description:
    """Read a robot's files.

    Args:
        urdf: URDF, or the xacro file of one.
        srdf: SRDF, or the xacro file of one; it gets the arguments that it has.
        xacro_args: Arguments of xacro files.
        resolver: Finds packages.

    Raises:
        RobotInvalid: if a file can't be expanded, or there are arguments and none is a xacro file.
    """
    if xacro_args and not is_xacro(urdf):
        raise RobotInvalid(
            f"{urdf.name} takes no xacro arguments: only files that end in .xacro are expanded", path=str(urdf)
        )
    text = _expanded(urdf, xacro_args, resolver, strict=True)
    semantic = None if srdf is None else _expanded(srdf, xacro_args, resolver, strict=False)
    files = (*text.files, *(semantic.files if semantic else ()))
    warnings = (*text.warnings, *(semantic.warnings if semantic else ()))
    return Description(text.text, None if semantic is None else semantic.text, files, warnings)


def absolute(path: str) -> Path:
    """Return a path of a request as an absolute one without links, ~ being a home folder.

    Raises:
        RobotInvalid: if it can't be: it has a NUL, links that lead to each other, or a user who has no home.
    """
    try:
        return Path(path).expanduser().resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise RobotInvalid(f"{path!r} is no path: {error}", path=path) from None


def robot_name(urdf: Path) -> str:
    """Return what a robot is called that a file describes: the file's name without its endings."""
    return Path(urdf.stem).stem if is_xacro(urdf) else urdf.stem


def _expanded(path: Path, args: Mapping[str, ArgumentValue], resolver: MeshResolver, *, strict: bool) -> Expanded:
    if not is_xacro(path):
        return Expanded(read_xml(path), (), ())
    expanded = expand(path, args, resolver.package_folder, strict=strict)
    if strict and "<link" not in expanded.text and "<joint" not in expanded.text:
        raise RobotInvalid(
            f"{path.name} expands to no link: it only defines what other files use; name the xacro file that calls its "
            "macros",
            path=str(path),
        )
    return expanded
