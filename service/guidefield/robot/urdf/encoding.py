"""Text of an XML file: its byte order mark or its declaration says the encoding, UTF-8 holds where neither does."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from guidefield.errors import RobotInvalid
from guidefield.robot.mesh_files.fault import MeshFault
from guidefield.robot.mesh_files.reading import content_of

MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
"""Byte order marks, the longer ones before those that they begin with, and the encoding that each means."""

WIDE = {b"<\x00": "utf-16-le", b"\x00<": "utf-16-be"}
"""First bytes of XML in UTF-16 without a mark."""

_DECLARED = re.compile(r"""(?:\s|<!--.*?-->)*<\?xml[^>]*?\sencoding\s*=\s*["']([A-Za-z0-9._:-]+)["']""", re.DOTALL)
_LONGEST_DECLARATION = 1024


def read_xml(path: Path) -> str:
    """Read a URDF or SRDF file.

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
