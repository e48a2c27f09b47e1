"""Expand xacro files by the package xacro, with packages found as meshes are (`meshes.py`).

Expressions in a xacro file are evaluated as Python: only local files are expanded, never text from a client.
"""

from __future__ import annotations

import contextlib
import io
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

from guidefield.errors import RobotInvalid

SUFFIX = ".xacro"
ArgumentValue = str | bool | int | float

_LOCK = threading.Lock()  # the package keeps its state in its module, so that one file is expanded at a time
_DECLARED = re.compile(r"""<xacro:arg\s[^>]*?\bname\s*=\s*["']([^"']+)["']""")
_USED = re.compile(r"""\$\(arg\s+([^\s)]+)\s*\)|xacro\.arg\(\s*["']([^"']+)["']\s*\)""")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


@dataclass(frozen=True)
class Expanded:
    """An expanded xacro file: its XML, all files that were read or optionally looked for, and xacro's warnings."""

    text: str
    files: tuple[Path, ...]
    warnings: tuple[str, ...]


def is_xacro(path: Path) -> bool:
    """Tell whether a file is to be expanded, by the end of its name."""
    return path.suffix.lower() == SUFFIX


def expand(
    path: Path,
    arguments: Mapping[str, ArgumentValue],
    find_package: Callable[[str, list[str]], Path | None],
    *,
    strict: bool = True,
) -> Expanded:
    """Expand a xacro file.

    Args:
        arguments: Values of its arguments by name.
        find_package: Returns the folder of a package, for `$(find name)`; gets the name and the paths in the package
            that the file names after it.
        strict: Refuse arguments that neither the file nor one that it includes has.

    Raises:
        RobotInvalid: if the package xacro is missing, or the file can't be expanded; names the file and the cause.
    """
    try:
        import xacro
        from xacro import substitution_args
    except ImportError:
        raise RobotInvalid(
            f"{path.name} is a xacro file, which the package xacro expands: pip install 'guidefield[xacro]'",
            path=str(path),
        ) from None

    def find(name: str) -> str:
        named = re.compile(rf"\$\(find\s+{re.escape(name)}\s*\)/([^\s\"'<>$]+)")
        files = dict.fromkeys((*reversed(xacro.filestack), *xacro.all_includes))
        folder = find_package(name, [path for file in files for path in named.findall(_read(Path(file)))])
        if folder is None:
            raise RobotInvalid(f"package {name!r} was not found; name its folder: `package_dirs`, or --package-dir")
        return str(folder)

    said = io.StringIO()
    with _LOCK, _patch(substitution_args, find), contextlib.redirect_stderr(said):
        xacro.all_includes.clear()
        xacro.init_stacks(str(path))
        try:
            document = xacro.parse(None, str(path))
            given = {name: str(arg).lower() if isinstance(arg, bool) else str(arg) for name, arg in arguments.items()}
            xacro.process_doc(document, mappings=given, verbosity=0)
            text = document.toprettyxml(indent="  ")
        except Exception as error:  # an expression in the file may raise anything
            raise _fault(path, xacro, error) from None
        finally:
            files = tuple(dict.fromkeys(Path(name).absolute() for name in (str(path), *xacro.all_includes)))
    if strict:
        _check_arguments(path, files, arguments)
    lines = [line.removeprefix("warning: ").strip() for line in said.getvalue().splitlines()]
    return Expanded(text, files, tuple(f"xacro: {line}" for line in dict.fromkeys(lines) if line))


@contextlib.contextmanager
def _patch(module: Any, find: Callable[[str], str]) -> Iterator[None]:
    """Let xacro find packages by our search, and not by that of an installed ROS."""
    before = module._eval_find, module._eval_dict["find"]
    module._eval_find = module._eval_dict["find"] = find
    try:
        yield
    finally:
        module._eval_find, module._eval_dict["find"] = before


def _fault(path: Path, xacro: Any, error: Exception) -> RobotInvalid:
    where = [Path(name) for name in xacro.filestack or [] if name] or [path]
    cause: BaseException = error
    while isinstance(getattr(cause, "exc", None), Exception):
        cause = cause.exc  # type: ignore[attr-defined]
    if isinstance(cause, xacro.substitution_args.ArgException):
        how = f"`xacro_args`, or --xacro-arg {cause}:=VALUE on the command line"
        reason = f"argument {str(cause)!r} has no value; give it: {how}"
    elif isinstance(cause, RobotInvalid):
        reason = cause.message
    elif isinstance(cause, OSError):
        reason = f"{cause.filename!r} can't be read: {cause.strerror}"
    elif isinstance(cause, ExpatError):
        reason = f"it is not XML: {cause}"
    elif isinstance(cause, RecursionError):
        reason = "it calls itself without end"
    else:
        said = cause if str(error).startswith("<class") else error  # the package repeats it behind its type
        reason = " ".join(str(said).split()) or type(cause).__name__
    inside = ""
    if xacro.macrostack:
        macro = xacro.macrostack[-1]
        inside = f", in macro {macro.body.getAttribute('name')!r} of {Path(macro.history[-1][-1]).name}"
    chain = f" (included by {where[-2].name})" if len(where) > 1 else ""
    return RobotInvalid(f"{where[-1]}{chain}{inside}: {reason}", path=str(where[-1]))


def _check_arguments(path: Path, files: tuple[Path, ...], arguments: Mapping[str, ArgumentValue]) -> None:
    if not arguments:
        return
    known: set[str] = set()
    for file in files:
        text = _COMMENT.sub("", _read(file))
        known.update(_DECLARED.findall(text))
        known.update(first or second for first, second in _USED.findall(text))
    for name in arguments:
        if name not in known:
            listed = f"it has {', '.join(sorted(known))}" if known else "it has none"
            raise RobotInvalid(f"{path.name} has no xacro argument {name!r}; {listed}", path=str(path), argument=name)


def _read(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
