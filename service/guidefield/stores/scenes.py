"""Scenes by name: those that come with the package, and those that clients stored on disk."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from pathlib import Path

from guidefield.bounded_map import READ_VERSIONS, BoundedMap
from guidefield.errors import RequestTooLarge, SceneInvalid
from guidefield.messages.faults import list_choices, suggest
from guidefield.messages.scene import Scene
from guidefield.messages.scene_changes import SceneDiff
from guidefield.scene import library
from guidefield.stores.files import alone, checked_name
from guidefield.stores.scene_versions import SceneVersions


class PackagedScenes:
    """The scenes that come with the package; keeps no other."""

    def names(self) -> list[str]:
        """The scenes that can be read, in alphabetical order."""
        return sorted(library.names())

    def read(self, name: str, version: int | None = None) -> tuple[Scene, int | None]:
        """One scene; it has no versions.

        Raises:
            SceneInvalid: if it is unknown, and lists those that can be read; or if a version is asked for.
        """
        if name not in library.names():
            raise _unknown(name, self.names())
        if version is not None:
            raise SceneInvalid(
                f"scene {name!r} comes with the package: it never changes and has no versions", scene=name
            )
        return library.read(name), None

    def write(self, scene: Scene) -> int:
        """Raise SceneInvalid: nothing can be stored here."""
        raise SceneInvalid(
            f"scene {scene.name!r} cannot be stored: scenes are kept only where there is a data folder; "
            "send the scene inside the request instead",
            scene=scene.name,
        )

    def change(self, name: str, _diff: SceneDiff) -> tuple[Scene, int]:
        """Raise SceneInvalid: a scene of the package stays as it is."""
        self.read(name)
        raise SceneInvalid(
            f"scene {name!r} comes with the package and cannot be changed; name it as the `base` of a request's scene, "
            "or store it under a name of your own",
            scene=name,
        )

    def delete(self, name: str) -> None:
        """Raise SceneInvalid: a scene of the package stays."""
        self.read(name)
        raise SceneInvalid(f"scene {name!r} comes with the package and cannot be deleted", scene=name)


class SceneStore:
    """The packaged scenes, and clients' own with their last versions in a folder.

    Several processes may share the folder. Where the disk refuses, OSError comes through.

    Args:
        folder: Made if it isn't there.
        limit: How many scenes clients may store.
    """

    def __init__(self, folder: Path, limit: int = 1_000) -> None:
        self._folder, self._lock = folder, folder / ".lock"
        self._limit = limit
        self._packaged = PackagedScenes()
        self._mutex = threading.RLock()
        self._versions = BoundedMap[str, SceneVersions](READ_VERSIONS)
        folder.mkdir(parents=True, exist_ok=True)

    def names(self) -> list[str]:
        """The scenes that can be read, in alphabetical order."""
        return sorted({*self._packaged.names(), *self._own()})

    def stored(self) -> list[str]:
        """Those of them that clients stored, in alphabetical order."""
        return sorted(self._own())

    def read(self, name: str, version: int | None = None) -> tuple[Scene, int | None]:
        """A version of a scene, or the newest, and its number; that of a packaged scene is None.

        Raises:
            SceneInvalid: if it is unknown, or has no such version, and lists those that can be read; or if its file is
                damaged.
        """
        with self._mutex:
            stored = self._of(name).read(version)
        if stored is not None:
            return stored[1], stored[0]
        if name in self._packaged.names():
            return self._packaged.read(name, version)
        raise _unknown(name, self.names())

    def write(self, scene: Scene) -> int:
        """Keep a scene under its own name, in place of an earlier one of that name; the number of its version.

        Raises:
            MalformedRequest: if the name can't be a file's.
            SceneInvalid: if the name is that of a packaged scene: it means the same everywhere.
            RequestTooLarge: if there are too many scenes already.
        """
        checked_name(scene.name, "scene")
        if scene.name in self._packaged.names():
            raise SceneInvalid(
                f"scene {scene.name!r} comes with the package and cannot be replaced; choose another name",
                scene=scene.name,
            )
        with self._alone():
            own = self._own()
            if scene.name not in own and len(own) >= self._limit:
                raise RequestTooLarge(f"{self._limit} scenes are stored already; delete one first", limit=self._limit)
            return self._of(scene.name).store(scene)

    def change(self, name: str, diff: SceneDiff) -> tuple[Scene, int]:
        """Change a stored scene; what it is from now on, and the number of that version.

        Raises:
            SceneInvalid: if it is unknown or comes with the package, the change does not fit, or another version was
                meant.
        """
        with self._alone():
            after = self._of(name).change(diff)
        if after is not None:
            return after[1], after[0]
        if name in self._packaged.names():
            return self._packaged.change(name, diff)
        raise _unknown(name, self.names())

    def delete(self, name: str) -> None:
        """Forget a stored scene, with its versions.

        Raises:
            SceneInvalid: if it is unknown, or comes with the package.
        """
        with self._alone():
            if self._of(name).delete():
                return
        if name not in self._packaged.names():
            raise _unknown(name, self.names())
        self._packaged.delete(name)

    def _own(self) -> list[str]:
        names = os.listdir(self._folder)  # noqa: PTH208 - for each scene that is stored all names are read
        return [name.removesuffix(".json") for name in names if name.endswith(".json") and not name.startswith(".")]

    def _of(self, name: str) -> SceneVersions:
        """A scene's files, whether there are any or not."""
        return self._versions.find(name, lambda: SceneVersions(self._folder, checked_name(name, "scene")), lambda _: 0)

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """One thread of one process at a time changes the store."""
        with self._mutex, alone(self._lock):
            yield


Scenes = PackagedScenes | SceneStore
"""What an engine reads scenes from, and keeps them in."""


def _unknown(name: str, names: list[str]) -> SceneInvalid:
    file = "a scene in a file is sent itself, as the file holds it; " if name.endswith(".json") else ""
    return SceneInvalid(
        f"there is no scene {name[:64]!r}; {suggest(name, names)}{file}there are {list_choices(names)}",
        scene=name[:64],
        available=names,
    )
