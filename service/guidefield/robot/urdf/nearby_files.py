"""Find files in the folders about a URDF by the end of their path, where a mesh isn't at its URI.

Only for robots in local files. Limits keep a search off large trees, and docs/robots.md states `MAX_ENTRIES`,
`MAX_SECONDS` and `MAX_LEVELS`; a looser match would take another robot's mesh.
"""

from __future__ import annotations

import enum
import filecmp
import os
import re
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import takewhile
from pathlib import Path

MANIFEST = "package.xml"
MAX_BYTES = 1 << 20  # no manifest is larger


def package_name(manifest: Path) -> str | None:
    """Return the name that a manifest declares; None if it has none or can't be read."""
    try:
        with manifest.open("rb") as file:
            text = file.read(MAX_BYTES).decode(errors="replace")
    except OSError:
        return None
    found = re.search(r"<name>\s*([^<\s]+)\s*</name>", text)
    return found.group(1) if found else None


MAX_ENTRIES = 20_000  # entries of folders that one search reads; a larger tree is no package
MAX_SECONDS = 10.0  # time that one search reads folders for [s]
MAX_LEVELS = 3  # folders above the URDF's that are searched where no package and no repository encloses it
MIN_DEPTH = 2  # folders of fewer names, such as / and /opt, are never searched
REPOSITORY_MARKS = (".git", ".hg", ".svn")
INNER_FOLDERS = ("cfg", "config", "description", "model", "models", "robot", "robots", "sdf", "urdf", "urdfs", "xacro")
"""Names of folders within a package that hold URDFs."""
MIN_COMMON = 3  # names that a path outside the robot's package must share with one that names no package
SKIPPED = ("node_modules", "__pycache__")  # folders that hold no robots; nor do those that are hidden


def enclosing_folders(folder: Path) -> list[Path]:
    """Return a folder and those above it in which its robot's files may be, the nearest first.

    They end at the repository, else beside the package (the nearest folder with a `package.xml`), else `MAX_LEVELS` up,
    and below the home folder. Neither the home folder nor one above it is ever among them.
    """
    try:
        home = Path.home().resolve()
    except RuntimeError:  # a user without one
        home = Path("/")
    barred = {home, *home.parents}
    usable = list(takewhile(lambda f: f not in barred and len(f.parts) > MIN_DEPTH, (folder, *folder.parents)))
    for number, above in enumerate(usable):
        if any(exists(above / mark) for mark in REPOSITORY_MARKS):
            return usable[: number + 1]
    for number, above in enumerate(usable):
        if exists(above / MANIFEST):
            return usable[: number + 2]
    return usable[: MAX_LEVELS + 1]


class Kind(enum.Enum):
    """The kind of a searched folder: the less it has to do with the robot, the more of a path must agree."""

    OWN = enum.auto()
    """In the robot's package: the file's name is enough."""
    GIVEN = enum.auto()
    """Given as a folder of packages: all but the package's name."""
    BEYOND = enum.auto()
    """Beside the robot's package, where other robots may be: the package's name too."""


@dataclass(frozen=True)
class Level:
    """A folder that is searched."""

    folder: Path
    kind: Kind

    def min_common(self, count: int, *, in_package: bool) -> int:
        """Return the least number of names that a file's path must share with a path of `count` names."""
        if self.kind is Kind.OWN:
            return 1
        if self.kind is Kind.GIVEN:
            return max(1, count - 1) if in_package else min(2, count)
        return count if in_package else MIN_COMMON


def levels_about(enclosing: Sequence[Path], given: Sequence[Path]) -> list[Level]:
    """Return the levels of a search: the folders of a URDF's package, given ones, then those about the package.

    The package is the nearest folder with a `package.xml`, else the one above folders such as `urdf` and `robots`, else
    the one above the URDF's.
    """
    manifests = (k for k, folder in enumerate(enclosing) if exists(folder / MANIFEST))
    inner = [folder.name.lower() in INNER_FOLDERS for folder in enclosing[:-1]]
    first = inner.index(True) if True in inner[:2] else 0
    own = next(manifests, first + max(1, sum(1 for _ in takewhile(bool, inner[first:]))))
    return [
        *(Level(folder, Kind.OWN) for folder in enclosing[: own + 1]),
        *(Level(folder, Kind.GIVEN) for folder in given),
        *(Level(folder, Kind.BEYOND) for folder in enclosing[own + 1 :]),
    ]


@dataclass(frozen=True)
class Match:
    """The files, each of other content, whose paths share the longest end with a path, and its number of names."""

    files: tuple[Path, ...] = ()
    common: int = 0


@dataclass
class NearbyFiles:
    """Files of folders, read from disk when they are first needed; links to folders are not followed.

    Levels are folders in the order in which they are searched; one may hold those before it.
    """

    levels: Sequence[Level]
    exhausted: bool = False
    """True if a limit ended the reading: what is beyond the levels read by then isn't known."""
    _files: list[dict[str, list[Path]]] = field(default_factory=list)
    _packages: list[dict[str, list[Path]]] = field(default_factory=list)
    _read: set[Path] = field(default_factory=set)
    _entries: int = 0
    _seconds: float = 0.0

    @property
    def own_folders(self) -> list[Path]:
        """The folders of the robot's package, the nearest first."""
        return [level.folder for level in self.levels if level.kind is Kind.OWN]

    def packages(self, name: str) -> Iterator[Path]:
        """Yield the folders whose `package.xml` declares a name, those of nearer levels first."""
        for number in range(len(self.levels)):
            if not self._has_level(number):
                return
            yield from self._packages[number].get(name, ())

    def find(self, path: str, *, in_package: bool) -> Match:
        """Find the files whose paths share the longest end with a path, whatever the letters' case.

        The nearest level decides in which at least two names are shared, or all that the path has, and so does a
        given folder; else the nearest in which the file's name is. Files of equal bytes are one.
        """
        names = [name for name in path.replace("\\", "/").split("/") if name not in ("", ".", "..")]
        weak, within = Match(), list[Path]()
        for number, level in enumerate(self.levels if names else ()):
            if not self._has_level(number):
                return Match()  # what wasn't read may hold a better one
            within += self._files[number].get(names[-1].lower(), [])
            match = _longest(names, [file for file in within if file.is_relative_to(level.folder)])
            if match.common < level.min_common(len(names), in_package=in_package):
                continue
            if match.common >= min(2, len(names)) or level.kind is Kind.GIVEN:
                return match
            weak = weak if weak.files else match
        return weak

    def _has_level(self, number: int) -> bool:
        """Read a level and those before it, unless the limits are reached."""
        while len(self._files) <= number and not self.exhausted:
            began = time.monotonic()
            files, packages = defaultdict[str, list[Path]](list), defaultdict[str, list[Path]](list)
            for file in self._walk(self.levels[len(self._files)].folder, began):
                files[file.name.lower()].append(file)
                if file.name == MANIFEST and (declared := package_name(file)):
                    packages[declared].append(file.parent)
            self._seconds += time.monotonic() - began
            if not self.exhausted:
                self._files.append(files)
                self._packages.append(packages)
        return len(self._files) > number

    def _walk(self, top: Path, began: float) -> Iterator[Path]:
        folders = [top]
        while folders:
            folder = folders.pop()
            if folder in self._read:
                continue
            self._read.add(folder)
            try:
                with os.scandir(folder) as listed:
                    entries = sorted((entry for entry in listed if is_text(entry.name)), key=lambda entry: entry.name)
            except OSError:
                continue
            self._entries += len(entries)
            if self._entries > MAX_ENTRIES or self._seconds + time.monotonic() - began > MAX_SECONDS:
                self.exhausted = True
                return
            inner = [entry for entry in entries if entry.is_dir(follow_symlinks=False)]
            folders += [Path(e.path) for e in reversed(inner) if not e.name.startswith(".") and e.name not in SKIPPED]
            yield from (Path(entry.path) for entry in entries if _is_file(entry))


def _longest(names: Sequence[str], files: Sequence[Path]) -> Match:
    """Keep the files that share the longest end with names; of these, any that have the same letters' case."""
    lengths = [_common(names, file.parts, exact=False) for file in files]
    common = max(lengths, default=0)
    longest = [file for file, length in zip(files, lengths, strict=True) if length == common]
    exact = [file for file in longest if _common(names, file.parts, exact=True) == common]
    return Match(_different(exact or longest), common)


def _common(names: Sequence[str], parts: Sequence[str], *, exact: bool) -> int:
    pairs = zip(reversed(names), reversed(parts), strict=False)
    same = takewhile(lambda pair: pair[0] == pair[1] or (not exact and pair[0].lower() == pair[1].lower()), pairs)
    return sum(1 for _ in same)


def _different(files: Sequence[Path]) -> tuple[Path, ...]:
    kept: list[Path] = []
    for file in files:
        if not any(same_bytes(file, other) for other in kept):
            kept.append(file)
    return tuple(kept)


def is_text(path: str) -> bool:
    """Tell whether a path can stand in XML: names of files may be bytes that are no UTF-8."""
    return not any("\ud800" <= character <= "\udfff" for character in path)


def _is_file(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_file()
    except OSError:  # links that lead to each other
        return False


def exists(path: Path) -> bool:
    """Tell whether there is something at a path; False if that can't be found out."""
    try:
        return path.exists()
    except (OSError, ValueError):  # no permission, a name too long, or with a NUL
        return False


def same_bytes(first: Path, second: Path) -> bool:
    """Tell whether two files hold the same; False if one can't be read."""
    try:
        return first.samefile(second) or filecmp.cmp(first, second, shallow=False)
    except OSError:
        return False
