"""Scenes by name: those of the package, and those that clients stored on disk, with their last versions.

`<name>.json` holds a version of the scene, `<name>.changes` a line for each later version: its change, or the scene
stored anew. A change costs a line, however large the scene is; now and then both files are written again. Changes are
made under a lock; reading needs none, because every line and file has the number of its version. `MAX_VERSIONS` last
versions are kept (`messages/scene_changes.py`).

The scenes that come with guidefield, by name: the files `scenes/<name>.json` of the checkout, `guidefield/scenes` of a
wheel; a new one is found.
"""

from __future__ import annotations

import contextlib
import functools
import os
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import msgspec

from guidefield.errors import MalformedRequest, RequestTooLarge, SceneInvalid
from guidefield.memory import READ_VERSIONS, BoundedMap
from guidefield.messages import codec
from guidefield.messages.faults import list_choices, suggest
from guidefield.messages.scene import Scene
from guidefield.messages.scene_changes import MAX_VERSIONS, SceneDiff, apply_change, freeze
from guidefield.stores.files import checked_name, decode_if_whole, lock_file
from guidefield.whole_file import write_whole

_PACKAGE = "guidefield.scenes"


@functools.cache
def list_packaged() -> tuple[str, ...]:
    """Names of the packaged scenes, in alphabetical order."""
    files = resources.files(_PACKAGE).iterdir()
    return tuple(sorted(file.name.removesuffix(".json") for file in files if file.name.endswith(".json")))


def read_packaged(name: str) -> Scene:
    """Read a packaged scene; raises SceneInvalid, which lists those there are, if there is none of that name."""
    available = list_packaged()
    if name not in available:
        raise SceneInvalid(
            f"no scene {name!r} comes with guidefield; there are {', '.join(available)}",
            scene=name,
            available=list(available),
        )
    return _read_file(name)


@functools.cache
def _read_file(name: str) -> Scene:
    scene: Scene = codec.decode(resources.files(_PACKAGE).joinpath(f"{name}.json").read_bytes(), Scene)
    return scene


MAX_CHANGES = 4 * MAX_VERSIONS
"""Changes after which files are written again (`MAX_VERSIONS` of them stay), if longer than the scene's file."""
MAX_SHORT_CHANGES = 64 * MAX_VERSIONS
"""The same if they are shorter: to write and read 10,000 boxes takes every process as long as a hundred changes."""
MAX_READINGS = 5  # attempts, 1 at least, to read files that others write; then they are damaged: `store` deletes them


class _SceneFile(msgspec.Struct):
    scene: Scene
    version: int = 1


class _VersionRecord(msgspec.Struct):
    version: int
    diff: SceneDiff | None = None
    scene: Scene | None = None


@dataclass
class _ReadFiles:
    """What was read of a scene's two files."""

    file: tuple[int, int]  # inode of its file, and time of writing [ns]
    size: int  # length of that file [bytes]
    first: int  # the version in that file
    changes: int  # inode of the file of changes; 0: there was none
    end: int  # length of it that was read [bytes]
    versions: dict[int, Scene]  # the last ones, the newest at the end; nobody changes them

    @property
    def newest(self) -> tuple[Scene, int]:
        version = next(reversed(self.versions))
        return self.versions[version], version

    def add(self, version: int, scene: Scene) -> None:
        self.versions[version] = scene
        while len(self.versions) > MAX_VERSIONS:
            del self.versions[next(iter(self.versions))]


class SceneVersions:
    """A stored scene by its files in a folder; once these are read, only later lines are read again."""

    def __init__(self, folder: Path, name: str) -> None:
        self._name = name
        self._file, self._changes = folder / f"{name}.json", folder / f"{name}.changes"
        self._known: _ReadFiles | None = None

    def read(self, version: int | None = None) -> tuple[Scene, int] | None:
        """Return a version, or the newest, with its number; None if nothing is stored.

        Raises SceneInvalid if the files are damaged, or there is no such version any more, or yet; it lists the others.
        """
        known = self._read()
        if known is None or version is None:
            return None if known is None else known.newest
        if version not in known.versions:
            there = list(known.versions)
            raise SceneInvalid(
                f"scene {self._name!r} has no version {version}; the last {len(there)} are kept, "
                f"{there[0]} to {there[-1]}",
                scene=self._name,
                available=there,
            )
        return known.versions[version], version

    def change(self, diff: SceneDiff) -> tuple[Scene, int] | None:
        """Change the newest version, under the lock; return the new one with its number, None if nothing is stored.

        Raises SceneInvalid if the change does not fit, or another version was meant.
        """
        known = self._read()
        if known is None:
            return None
        scene, before = known.newest
        if diff.version not in (None, before):
            raise SceneInvalid(
                f"scene {self._name!r} has version {before}, and version {diff.version} was to be changed; nothing "
                "was: read the scene again",
                scene=self._name,
                version=before,
            )
        after = self._append(known, scene, _VersionRecord(before + 1, diff=diff))
        if before + 1 - known.first >= (MAX_CHANGES if known.end > known.size else MAX_SHORT_CHANGES):
            self._write_again(known)
        return after, before + 1

    def store(self, scene: Scene) -> int:
        """Store a scene anew, in place of a damaged one too, under the lock; return the number of its version."""
        try:
            known = self._read()
        except SceneInvalid:
            self.delete()
            known = None
        if known is None:
            write_whole(self._file, codec.encode(_SceneFile(scene)))
            return 1
        before, version = known.newest
        self._append(known, before, _VersionRecord(version + 1, scene=scene))
        if version + 1 - known.first >= MAX_VERSIONS:
            self._write_again(known)
        return version + 1

    def delete(self) -> bool:
        """Delete it, under the lock; return whether there was anything."""
        there = self._file.exists()
        self._changes.unlink(missing_ok=True)
        self._file.unlink(missing_ok=True)
        self._known = None
        return there

    def _append(self, known: _ReadFiles, before: Scene, line: _VersionRecord) -> Scene:
        """Append the line of a version, and return the scene after it.

        The scene is made from the encoded line, because the caller may change its objects later. Raises
        MalformedRequest if that can't be read.
        """
        data = codec.encode(line)
        read = decode_if_whole(data, _VersionRecord)
        if read is None:
            raise MalformedRequest("what is to be stored holds what no message can", path="$")
        after = _apply(before, read)
        with self._changes.open("ab") as file:
            file.truncate(known.end)  # a line that was cut short was never answered
            try:
                file.write(data + b"\n")
                file.flush()
                os.fsync(file.fileno())
            except OSError:
                os.truncate(self._changes, known.end)  # a refused line is no version for anybody
                raise
            known.changes, known.end = os.fstat(file.fileno()).st_ino, file.tell()
        known.add(line.version, after)
        return after

    def _write_again(self, known: _ReadFiles) -> None:
        """Write the oldest version that is kept as the file of the scene, and the later changes as that of changes."""
        oldest = next(iter(known.versions))
        with contextlib.suppress(OSError):  # the change is made; the next one tries again
            lines = [line for line in _lines(self._changes.read_bytes())[0] or [] if line.version > oldest]
            write_whole(self._file, codec.encode(_SceneFile(known.versions[oldest], oldest)))
            write_whole(self._changes, b"".join(codec.encode(line) + b"\n" for line in lines))
            self._known = None

    def _read(self) -> _ReadFiles | None:
        """Read the files; None if nothing is stored; raises SceneInvalid if they are damaged."""
        for _ in range(MAX_READINGS):
            try:
                if self._is_known() or self._read_on():
                    return self._known
            except FileNotFoundError:
                self._known = None
                return None
        raise SceneInvalid(f"scene {self._name!r} can't be read: its file is damaged; store it again", scene=self._name)

    def _is_known(self) -> bool:
        known = self._known
        if known is None:
            return False
        return (known.file, (known.changes, known.end)) == (_identify(self._file), _extent(self._changes))

    def _read_on(self) -> bool:
        """Read later lines, or all; return whether the files are of one state: not while a process writes them."""
        file, (changes, _) = _identify(self._file), _extent(self._changes)
        known, self._known = self._known, None
        if known is None or (known.file, known.changes) != (file, changes):
            known = self._read_whole(file, changes)
        if known is None:
            return False
        lines, read = _lines(_read_from(self._changes, known.end))
        if lines is None:
            return False
        scene, version = known.newest
        for line in lines:
            if line.version <= version:
                continue
            if line.version != version + 1 or (line.diff is None) == (line.scene is None):
                return False
            scene, version = _apply(scene, line), line.version
            known.add(version, scene)
        known.end += read
        self._known = known
        return True

    def _read_whole(self, file: tuple[int, int], changes: int) -> _ReadFiles | None:
        """Read the file of the scene, without its changes; None if it is damaged."""
        data = self._file.read_bytes()
        whole = decode_if_whole(data, _SceneFile)
        if whole is None:
            scene = decode_if_whole(data, Scene)  # as 0.1 stored it
            if scene is None:
                return None
            whole = _SceneFile(scene)
        return _ReadFiles(file, len(data), whole.version, changes, 0, {whole.version: freeze(whole.scene)})


def _apply(scene: Scene, line: _VersionRecord) -> Scene:
    return apply_change(scene, line.diff) if line.diff is not None else freeze(line.scene or scene)


def _read_from(file: Path, begin: int) -> bytes:
    """Read a file from a place on [bytes]; nothing where there is none."""
    with contextlib.suppress(FileNotFoundError), file.open("rb") as opened:
        opened.seek(begin)
        return opened.read()
    return b""


def _lines(text: bytes) -> tuple[list[_VersionRecord] | None, int]:
    """Return the changes in whole lines, None if one is damaged, and their length together [bytes]."""
    end = text.rfind(b"\n") + 1
    lines = [decode_if_whole(line, _VersionRecord) for line in text[:end].splitlines()]
    whole = [line for line in lines if line is not None]
    return (whole if len(whole) == len(lines) else None), end


def _identify(file: Path) -> tuple[int, int]:
    stat = file.stat()
    return stat.st_ino, stat.st_mtime_ns


def _extent(file: Path) -> tuple[int, int]:
    try:
        stat = file.stat()
    except FileNotFoundError:
        return 0, 0
    return stat.st_ino, stat.st_size


class PackagedScenes:
    """The scenes that come with the package; keeps no other."""

    def names(self) -> list[str]:
        """List the scenes that can be read, in alphabetical order."""
        return sorted(list_packaged())

    def read(self, name: str, version: int | None = None) -> tuple[Scene, int | None]:
        """Return a version of a scene, or the newest, and its number; None for a packaged scene, which has no versions.

        Raises SceneInvalid if it is unknown, and lists those that can be read; if it has no such version; or if its
        file is damaged.
        """
        if name not in list_packaged():
            file = "a scene in a file is sent itself, as the file holds it; " if name.endswith(".json") else ""
            names = self.names()
            raise SceneInvalid(
                f"there is no scene {name[:64]!r}; {suggest(name, names)}{file}there are {list_choices(names)}",
                scene=name[:64],
                available=names,
            )
        if version is not None:
            raise SceneInvalid(
                f"scene {name!r} comes with the package: it never changes and has no versions", scene=name
            )
        return read_packaged(name), None

    def write(self, scene: Scene) -> int:
        """Keep a scene under its own name, in place of an earlier one of that name; return the number of its version.

        Raises MalformedRequest if the name can't be a file's; SceneInvalid if it is that of a packaged scene, which
        means the same everywhere, or nothing can be stored here; RequestTooLarge if there are too many scenes already.
        """
        raise SceneInvalid(
            f"scene {scene.name!r} cannot be stored: scenes are kept only where there is a data folder; "
            "send the scene inside the request instead",
            scene=scene.name,
        )

    def change(self, name: str, _diff: SceneDiff) -> tuple[Scene, int]:
        """Change a stored scene; return it with the number of the new version.

        Raises SceneInvalid if it is unknown or comes with the package, the change does not fit, or another version was
        meant.
        """
        PackagedScenes.read(self, name)
        raise SceneInvalid(
            f"scene {name!r} comes with the package and cannot be changed; name it as the `base` of a request's scene, "
            "or store it under a name of your own",
            scene=name,
        )

    def delete(self, name: str) -> None:
        """Delete a stored scene with its versions; raises SceneInvalid if it is unknown, or comes with the package."""
        PackagedScenes.read(self, name)
        raise SceneInvalid(f"scene {name!r} comes with the package and cannot be deleted", scene=name)


class SceneStore(PackagedScenes):
    """The packaged scenes, and clients' own with their last versions in a folder, made with the first one.

    Several processes may share the folder. Where the disk refuses, OSError comes through.
    """

    def __init__(self, folder: Path, limit: int = 1_000) -> None:
        self._folder, self._limit = folder, limit
        self._mutex = threading.RLock()
        self._versions = BoundedMap[str, SceneVersions](READ_VERSIONS)

    def names(self) -> list[str]:
        """List the scenes that can be read, in alphabetical order."""
        return sorted({*list_packaged(), *self.stored()})

    def stored(self) -> list[str]:
        """List those of them that clients stored, in alphabetical order."""
        try:
            names = os.listdir(self._folder)  # noqa: PTH208 - for each scene that is stored all names are read
        except FileNotFoundError:
            return []
        stored = (name.removesuffix(".json") for name in names if name.endswith(".json"))
        return sorted(name for name in stored if not name.startswith("."))

    def read(self, name: str, version: int | None = None) -> tuple[Scene, int | None]:
        """As `PackagedScenes.read`."""
        with self._mutex:
            stored = self._of(name).read(version)
        return super().read(name, version) if stored is None else stored

    def write(self, scene: Scene) -> int:
        """As `PackagedScenes.write`."""
        name = checked_name(scene.name, "scene")
        if name in list_packaged():
            raise SceneInvalid(
                f"scene {name!r} comes with the package and cannot be replaced; choose another name", scene=name
            )
        with self._lock():
            own = self.stored()
            if name not in own and len(own) >= self._limit:
                raise RequestTooLarge(f"{self._limit} scenes are stored already; delete one first", limit=self._limit)
            return self._of(name).store(scene)

    def change(self, name: str, diff: SceneDiff) -> tuple[Scene, int]:
        """As `PackagedScenes.change`."""
        with self._lock():
            after = self._of(name).change(diff)
        return super().change(name, diff) if after is None else after

    def delete(self, name: str) -> None:
        """As `PackagedScenes.delete`."""
        with self._lock():
            is_deleted = self._of(name).delete()
        if not is_deleted:
            super().delete(name)

    def _of(self, name: str) -> SceneVersions:
        return self._versions.find(name, lambda: SceneVersions(self._folder, checked_name(name, "scene")), lambda _: 0)

    @contextlib.contextmanager
    def _lock(self) -> Iterator[None]:
        with self._mutex:
            self._folder.mkdir(parents=True, exist_ok=True)
            with lock_file(self._folder / ".lock"):
                yield
