"""Read the XML of robots: xacro files expanded, text decoded, elements and numbers checked, faults by line and element.

Text may come from clients: entities, DOCTYPEs and network access stay off (`_STRICT`). Expressions in a xacro file are
evaluated as Python by the package xacro: only local files are expanded, never text from a client. Packages are found as
meshes are (`meshes.py`).
"""

from __future__ import annotations

import codecs
import contextlib
import io
import math
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.messages.values import MAX_URDF_CHARACTERS
from guidefield.robot.mesh_files.numbers import MeshFault
from guidefield.robot.mesh_files.reading import content_of

MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
"""Byte order marks, the longer ones before those that they begin with, and the encoding that each means."""

WIDE = {b"<\x00": "utf-16-le", b"\x00<": "utf-16-be"}  # first bytes of XML in UTF-16 without a mark

_DECLARED = re.compile(r"""(?:\s|<!--.*?-->)*<\?xml[^>]*?\sencoding\s*=\s*["']([A-Za-z0-9._:-]+)["']""", re.DOTALL)
_LONGEST_DECLARATION = 1024

Element = Any  # an element of lxml, for which there are no types

LARGEST_LENGTH = 1e6
"""No part of a robot is larger, or further from the next one [m]; beyond, placements would lose all digits."""

_LATE_HEAD = re.compile(r"(?!<\?xml)\s*(?:<!--(?:(?!-->).)*-->\s*)*<\?xml\s[^>]*\?>", re.DOTALL)
"""An XML declaration behind blank lines or comments, where XML has none."""

_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")

_A = {"URDF": "a", "SRDF": "an", "MJCF": "an", "SDF": "an"}
EXPAND_IT = "expand it first (xacro robot.urdf.xacro > robot.urdf); a local file that ends in .xacro is expanded"
_XACRO = "http://www.ros.org/wiki/xacro"
_XACRO_DEFINITIONS = ("macro", "property", "arg")
_XACRO_CONTENT = ("include", "if", "unless", "insert_block", "call", "element", "attribute")
"""Elements of xacro that stand for parts of the robot: what isn't refused is left out of it, so take none away."""
_UNDECLARED = "NS_ERR_UNDEFINED_NAMESPACE"  # libxml2's name of the fault that a prefix isn't declared
_STRICT = {
    "encoding": "utf-8",
    "resolve_entities": False,
    "no_network": True,
    "load_dtd": False,
    "huge_tree": False,
    "remove_comments": True,
    "remove_pis": True,
}

XACRO_SUFFIX = ".xacro"
ArgumentValue = str | bool | int | float

_LOCK = threading.Lock()  # the package keeps its state in its module, so that one file is expanded at a time
_DECLARED_ARGUMENT = re.compile(r"""<xacro:arg\s[^>]*?\bname\s*=\s*["']([^"']+)["']""")
_USED_ARGUMENT = re.compile(r"""\$\(arg\s+([^\s)]+)\s*\)|xacro\.arg\(\s*["']([^"']+)["']\s*\)""")
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


def read_xml(path: Path) -> str:
    """Read a URDF or SRDF file, by its byte order mark or declaration, else as UTF-8.

    Raises:
        RobotInvalid: if it can't be opened, is empty or stands in for a file; if it isn't in the encoding that it
            declares: names the file, the line and the byte.
    """
    try:
        content = content_of(path)
    except MeshFault as error:
        raise RobotInvalid(f"{path.name!r} {error}", path=path.name) from None
    encoding = _encoding_of(content, path)
    mark = next((mark for mark, _ in MARKS if content.startswith(mark)), b"")
    body = content[len(mark) :] if encoding == "utf-8" else content
    try:
        return body.decode(encoding)
    except UnicodeDecodeError as error:
        start = error.start + len(content) - len(body)
        before = content[:start].decode(encoding, errors="ignore")
        line = before.count("\n") + 1
        raise RobotInvalid(
            f"line {line}: {path.name!r} isn't {encoding.upper()} at byte {start} ({content[start]:#04x}): its XML"
            ' declaration may name another encoding, such as <?xml version="1.0" encoding="ISO-8859-1"?>',
            line=line,
            byte=start,
            path=path.name,
        ) from None


def _encoding_of(content: bytes, path: Path) -> str:
    for mark, encoding in MARKS:
        if content.startswith(mark):
            return encoding
    wide = WIDE.get(content[:2])
    head = content[:_LONGEST_DECLARATION].decode(wide or "latin-1", errors="ignore")
    declared = _DECLARED.match(head)
    if declared is None and wide:
        raise RobotInvalid(
            f"line 1: {path.name!r} is UTF-16 from byte 0 on without saying so: it needs a byte order mark, or"
            ' <?xml version="1.0" encoding="UTF-16"?>',
            line=1,
            byte=0,
            path=path.name,
        )
    if declared is None:
        return "utf-8"
    try:
        encoding = codecs.lookup(declared[1]).name
        "<".encode(encoding)
    except (LookupError, ValueError, TypeError):
        raise RobotInvalid(
            f"line 1: {path.name!r} declares the unknown encoding {declared[1]!r}", line=1, path=path.name
        ) from None
    return wide if wide and encoding.startswith("utf-16") else encoding


def parse(text: str, warnings: list[str] | None = None) -> Element:
    """Parse a URDF to its root element, without comments and without leftovers of xacro, of which it warns.

    Raises:
        RobotInvalid: if the text is too long, isn't XML, has a DOCTYPE, is an unexpanded xacro file or isn't a <robot>.
    """
    warnings = [] if warnings is None else warnings
    root = root_of(text, "URDF", warnings)
    if "xmlns" in text or "xacro" in text:  # else there are none
        drop_xacro(root, warnings)
        _drop_default_namespace(root)
    if root.tag != "robot":
        raise fault(root, f"the root element of a URDF must be <robot>, it is <{root.tag}>")
    return root


def root_of(text: str, kind: str, warnings: list[str]) -> Element:
    """Parse a "URDF", "SRDF", "MJCF" or "SDF"; RobotInvalid if it is too long, isn't XML or has a DOCTYPE.

    Entities are neither declared nor expanded, nothing is fetched, and depth and size stay within libxml2's limits.
    Elements and attributes with a prefix that isn't declared, such as Gazebo's `sensor:camera`, are left out, with a
    warning.
    """
    if len(text) > MAX_URDF_CHARACTERS:
        limit = MAX_URDF_CHARACTERS
        raise RobotInvalid(f"the {kind} has {len(text)} characters, at most {limit} are read", limit=limit)
    before, doctype, _ = text.partition("<!DOCTYPE")
    if doctype:
        line = before.count("\n") + 1
        message = f"line {line}: {_A[kind]} {kind} must not have a <!DOCTYPE>, nor entities"
        raise RobotInvalid(message, line=line, element="!DOCTYPE")
    if late := _LATE_HEAD.match(text):
        warnings.append(f"line {late[0].count(chr(10)) + 1}: the XML declaration isn't at the start: it is left out")
        text = "\n" * late[0].count("\n") + text[late.end() :]
    parser = etree.XMLParser(**_STRICT)
    try:
        return etree.fromstring(text.encode(), parser)
    except etree.XMLSyntaxError as error:
        if {entry.type_name for entry in parser.error_log} == {_UNDECLARED}:
            root = etree.fromstring(text.encode(), etree.XMLParser(**_STRICT, recover=True))
            _drop_undeclared(root, warnings)
            return root
        why = re.sub(r", line \d+(, column \d+)$", r"\1", error.msg)
        named = text.strip().lower().endswith((".urdf", ".srdf", ".xacro", ".xml"))
        path = "; its text is asked for, not the name of a file" if named else ""
        raise RobotInvalid(f"line {error.lineno}: the {kind} is not XML: {why}{path}", line=error.lineno) from None
    except UnicodeEncodeError as error:
        line = text.count("\n", 0, error.start) + 1
        raise RobotInvalid(f"line {line}: the {kind} is not text: it has half a surrogate pair", line=line) from None


def fault(element: Element, message: str, **details: Any) -> RobotInvalid:
    """Make the error for a fault of an element; its details name line, element, and the joint or link it is in."""
    owners = [element, *element.iterancestors()]
    named = {owner.tag: owner.get("name") for owner in owners if owner.tag in ("joint", "link") and owner.get("name")}
    where = "".join(f"{kind} {name!r}: " for kind, name in named.items())
    line = element.sourceline
    return RobotInvalid(f"line {line}: {where}{message}", line=line, element=element.tag, **{**named, **details})


def warning(element: Element, message: str) -> str:
    """Return the sentence of `fault`, for an oddity that is harmless."""
    return fault(element, message).message


def warn_of_repeated(element: Element, tag: str, warnings: list[str]) -> None:
    """Tell of children that may stand once and stand again: parsers read the first alone."""
    warnings += [warning(repeated, f"a second <{tag}> is left out") for repeated in element.findall(tag)[1:]]


@contextlib.contextmanager
def leaving_out(element: Element, end: str, warnings: list[str]) -> Iterator[None]:
    """Leave out an element that no verdict depends on if its check raises a fault, which becomes a warning."""
    try:
        yield
    except RobotInvalid as error:
        warnings.append(f"{error.message}; {end}")
        element.getparent().remove(element)


def name_of(element: Element) -> str:
    """Return the name of an element; a fault if it has none."""
    name: str = element.get("name", "")
    if not name.strip():
        raise fault(element, f"<{element.tag}> must have a name")
    return name


def numbers(element: Element, attribute: str, count: int, largest: float = math.inf) -> list[float] | None:
    """Return `count` finite numbers of an attribute, rewritten with single spaces, or None if it is left out."""
    text = element.get(attribute)
    if text is None:
        return None
    words = text.split()
    what = f"{attribute!r} of <{element.tag}> must be {'a finite number' if count == 1 else f'{count} finite numbers'}"
    if len(words) != count:
        raise fault(element, f"{what}, got {len(words)}: {text!r}", attribute=attribute)
    values = [float(word) if _NUMBER.fullmatch(word) else math.nan for word in words]
    for word, value in zip(words, values, strict=True):
        if not math.isfinite(value):
            hint = "; expand the file with xacro first" if "${" in text else ""
            raise fault(element, f"{what}, got {word!r}{hint}", attribute=attribute)
        if abs(value) > largest:
            raise fault(element, f"{what} of at most {largest:g}, got {word!r}", attribute=attribute)
    element.set(attribute, " ".join(words))
    return values


def number(element: Element, attribute: str, default: float | None = None, largest: float = math.inf) -> float:
    """Return one finite number; `default` where the attribute is left out, a fault where there is no default."""
    values = numbers(element, attribute, 1, largest)
    if values is not None:
        return values[0]
    if default is None:
        raise fault(element, f"<{element.tag}> must have {attribute!r}", attribute=attribute)
    return default


def check_origins(element: Element, version: tuple[int, int]) -> None:
    """Check the `<origin>` of a joint or part of a link; before version 1.1 a quaternion would be left out."""
    for origin in element.findall("origin"):
        numbers(origin, "xyz", 3, LARGEST_LENGTH)
        rpy, quaternion = numbers(origin, "rpy", 3), numbers(origin, "quat_xyzw", 4)
        if quaternion is None:
            continue
        if version < (1, 1):
            raise fault(origin, "'quat_xyzw' needs <robot version=\"1.1\">; before, it is 'rpy'", attribute="quat_xyzw")
        if rpy is not None:
            raise fault(origin, "<origin> must have 'rpy' or 'quat_xyzw', not both", attribute="quat_xyzw")
        if math.hypot(*quaternion) < 1e-9:
            raise fault(origin, "'quat_xyzw' of <origin> must not be zero", attribute="quat_xyzw")


def _drop_undeclared(root: Element, warnings: list[str]) -> None:
    """Take out elements and attributes with an undeclared prefix; xacro's is declared, and handled as usual."""
    lines: dict[str, int] = {}
    for element in list(root.iter(etree.Element)):
        prefix, colon, local = element.tag.partition(":") if element.tag[0] != "{" else ("", "", "")
        if prefix == "xacro":
            element.tag = f"{{{_XACRO}}}{local}"
        elif colon:
            lines.setdefault(prefix, element.sourceline)
            _drop(element)
        for attribute in [name for name in element.attrib if ":" in name and name[0] != "{"]:
            lines.setdefault(attribute.partition(":")[0], element.sourceline)
            del element.attrib[attribute]
    for prefix, line in lines.items():
        warnings.append(f"line {line}: the prefix {prefix!r} isn't declared: what has it is left out")


def drop_xacro(root: Element, warnings: list[str]) -> None:
    """Take out leftovers of xacro that stand for nothing; RobotInvalid if the file isn't expanded.

    Definitions stand for nothing, and so do calls of macros that the file doesn't define and that hold nothing: other
    tools leave them out as well. Conditions, included files and calls of its own macros stand for parts of the robot.
    """
    found = [(element, etree.QName(element).localname) for element in root.iter(etree.Element) if _is_xacro(element)]
    defined = {element.get("name") for element, tag in found if tag == "macro"}
    calls: dict[str, list[int]] = {}
    for element, tag in found:
        if any(map(_is_xacro, element.iterancestors())):
            continue  # it goes with what it is in
        if tag in defined or tag in _XACRO_CONTENT or (len(element) and tag not in _XACRO_DEFINITIONS):
            raise fault(element, f"this is a xacro file (<xacro:{tag}>); {EXPAND_IT}")
        calls.setdefault(tag, []).append(element.sourceline)
    for tag, (line, *others) in calls.items():
        more = f" (and {len(others)} more)" if others else ""
        warnings.append(f"line {line}: <xacro:{tag}>{more} is left over from xacro: it is left out")
    for element, _ in found:
        _drop(element)


def _is_xacro(element: Element) -> bool:
    return isinstance(element.tag, str) and "xacro" in element.tag.partition("}")[0] and element.tag[0] == "{"


def _drop(element: Element) -> None:
    """Take an element out, but not a root element, which is refused for its name."""
    if (parent := element.getparent()) is not None:
        parent.remove(element)


def _drop_default_namespace(root: Element) -> None:
    for element in root.iter(etree.Element):
        name = etree.QName(element)
        if name.namespace and element.prefix is None:
            element.tag = name.localname
    etree.cleanup_namespaces(root)


@dataclass(frozen=True)
class Expanded:
    """An expanded xacro file: its XML, all files that were read or optionally looked for, and xacro's warnings."""

    text: str
    files: tuple[Path, ...]
    warnings: tuple[str, ...]


def is_xacro(path: Path) -> bool:
    """Tell whether a file is to be expanded, by the end of its name."""
    return path.suffix.lower() == XACRO_SUFFIX


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
        folder = find_package(name, [path for file in files for path in named.findall(_read_text(Path(file)))])
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
            raise _expansion_fault(path, xacro, error) from None
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


def _expansion_fault(path: Path, xacro: Any, error: Exception) -> RobotInvalid:
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
        text = _COMMENT.sub("", _read_text(file))
        known.update(_DECLARED_ARGUMENT.findall(text))
        known.update(first or second for first, second in _USED_ARGUMENT.findall(text))
    for name in arguments:
        if name not in known:
            listed = f"it has {', '.join(sorted(known))}" if known else "it has none"
            raise RobotInvalid(f"{path.name} has no xacro argument {name!r}; {listed}", path=str(path), argument=name)


def _read_text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
