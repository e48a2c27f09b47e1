"""Give links and joints neutral names while Pinocchio parses a URDF, and capture what its parser writes to stderr.

Pinocchio gives names of its own (`universe`, `root_joint`) and resolves frames by name while it builds a model. A fixed
joint called `universe` then loses its placement, and a joint called `root_joint` is merged with a moving root. With
names that nobody else uses every model is built alike; the names of the URDF are written back afterwards, by index.
"""

from __future__ import annotations

import fcntl
import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from lxml import etree

MAX_CAUGHT_BYTES = 64 * 1024  # most that is kept of what was written, from its beginning

_STDERR = 2
_FIRST_ORDINARY = 3
_ONE_AT_A_TIME = threading.RLock()
_SOURCE_LINE = re.compile(r"\s*at line \d+ in \S+")


class CapturedStderr:
    """The text written to stderr so far; readable within the capture and after it."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor: int | None = descriptor
        self._kept = b""

    def text(self) -> str:
        """Return everything that was written, as it was."""
        return self._bytes().decode(errors="replace")

    def reason(self) -> str:
        """Return it on one line: without severities, places in the library's source, and repetitions."""
        lines = (line.strip().removeprefix("Error:").strip() for line in self.text().splitlines())
        stated = dict.fromkeys(line for line in lines if line and not _SOURCE_LINE.fullmatch(line))
        return "; ".join(stated)

    def _bytes(self) -> bytes:
        if self._descriptor is None:
            return self._kept
        return os.pread(self._descriptor, MAX_CAUGHT_BYTES, 0)

    def _finish(self) -> None:
        self._kept = self._bytes()
        self._descriptor = None


@contextmanager
def capture_stderr() -> Iterator[CapturedStderr]:
    """Redirect file descriptor 2 to a temporary file while the block runs, to quote a C++ library's reason in errors.

    This is process-wide: whatever any thread writes to stderr then is caught too, and is not written anywhere else. So
    keep the block short. Captures of several threads wait for each other; they may be nested. If the process has no
    stderr, it has none afterwards either.
    """
    with _ONE_AT_A_TIME:
        _flush()
        saved = _duplicate(_STDERR)
        sink = _temporary_file()
        os.dup2(sink, _STDERR)
        captured = CapturedStderr(sink)
        try:
            yield captured
        finally:
            _flush()
            captured._finish()
            if saved is None:
                os.close(_STDERR)
            else:
                os.dup2(saved, _STDERR)
                os.close(saved)
            os.close(sink)


def _duplicate(descriptor: int) -> int | None:
    """Duplicate a descriptor, never as one of the three standard ones; None if it is closed."""
    try:
        return fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, _FIRST_ORDINARY)
    except OSError:
        return None


def _temporary_file() -> int:
    with tempfile.TemporaryFile() as file:  # where stderr is closed, this one may have got its number
        descriptor = _duplicate(file.fileno())
    assert descriptor is not None, "an open file can be duplicated"
    return descriptor


def _flush() -> None:
    if sys.stderr is not None and not sys.stderr.closed:
        try:
            sys.stderr.flush()
        except OSError:  # nobody reads it any more
            return


@dataclass(frozen=True)
class NeutralNames:
    """A URDF with neutral names, and its own names of links and joints by these."""

    text: str
    links: Mapping[str, str]
    joints: Mapping[str, str]

    def restore(self, model: Any, geometry: Any | None = None) -> None:
        """Write the URDF's own names into a Pinocchio model, and into its geometry model, in place."""
        both = {**self.links, **self.joints}
        for index in range(1, model.njoints):
            model.names[index] = both.get(model.names[index], model.names[index])
        for frame in model.frames:
            frame.name = both.get(frame.name, frame.name)
        for shape in geometry.geometryObjects if geometry is not None else ():
            link, _, number = shape.name.rpartition("_")
            shape.name = f"{self.links[link]}_{number}"

    def restore_text(self, message: str) -> str:
        """Return a message with the URDF's own names."""
        for neutral, name in (*self.links.items(), *self.joints.items()):
            message = message.replace(neutral, name)
        return message


def neutral_names(urdf: str) -> NeutralNames:
    """Give every link and joint of a checked URDF a neutral name; in the same order, as Pinocchio sorts joints."""
    root = etree.fromstring(urdf.encode())
    links = _rank("L", [link.get("name") for link in root.findall("link")])
    joints = _rank("J", [joint.get("name") for joint in root.findall("joint")])
    for link in root.findall("link"):
        link.set("name", links[link.get("name")])
    for joint in root.findall("joint"):
        joint.set("name", joints[joint.get("name")])
        for end in (joint.find("parent"), joint.find("child")):
            end.set("link", links[end.get("link")])
        for mimic in joint.findall("mimic"):
            mimic.set("joint", joints.get(mimic.get("joint"), ""))
    text = etree.tostring(root, encoding="unicode")
    return NeutralNames(text, {new: old for old, new in links.items()}, {new: old for old, new in joints.items()})


def _rank(kind: str, names: Iterable[str]) -> dict[str, str]:
    ordered = sorted(names, key=lambda name: name.encode())
    return {name: f"#{kind}{rank:05d}#" for rank, name in enumerate(ordered)}
