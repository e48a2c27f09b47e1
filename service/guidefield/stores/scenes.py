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
        """List the scenes that can be read, in alphabetical order."""
        return sorted(library.names())

    def read(self, name: str, version: int | None = None) -> tuple[Scene, int | None]:
        """Return a version of a scene, or the newest, and its number; None for a packaged scene, which has no versions.

        Raises SceneInvalid if it is unknown, and lists those that can be read; if it has no such version; or if its
        file is damaged.
        """
        if name not in library.names():
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
        return library.read(name), None

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
    """The packaged scenes, and clients' own with their last versions in a folder, made if it isn't there.

    Several processes may share the folder. Where the disk refuses, OSError comes through.
    """

    def __init__(self, folder: Path, limit: int = 1_000) -> None:
        self._folder, self._limit = folder, limit
        self._mutex = threading.RLock()
        self._versions = BoundedMap[str, SceneVersions](READ_VERSIONS)
        folder.mkdir(parents=True, exist_ok=True)

    def names(self) -> list[str]:
        """List the scenes that can be read, in alphabetical order."""
        return sorted({*library.names(), *self.stored()})

    def stored(self) -> list[str]:
        """List those of them that clients stored, in alphabetical order."""
        names = os.listdir(self._folder)  # noqa: PTH208 - for each scene that is stored all names are read
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
        if name in library.names():
            raise SceneInvalid(
                f"scene {name!r} comes with the package and cannot be replaced; choose another name", scene=name
            )
        with self._alone():
            own = self.stored()
            if name not in own and len(own) >= self._limit:
                raise RequestTooLarge(f"{self._limit} scenes are stored already; delete one first", limit=self._limit)
            return self._of(name).store(scene)

    def change(self, name: str, diff: SceneDiff) -> tuple[Scene, int]:
        """As `PackagedScenes.change`."""
        with self._alone():
            after = self._of(name).change(diff)
        return super().change(name, diff) if after is None else after

    def delete(self, name: str) -> None:
        """As `PackagedScenes.delete`."""
        with self._alone():
            is_deleted = self._of(name).delete()
        if not is_deleted:
            super().delete(name)

    def _of(self, name: str) -> SceneVersions:
        return self._versions.find(name, lambda: SceneVersions(self._folder, checked_name(name, "scene")), lambda _: 0)

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        with self._mutex, alone(self._folder / ".lock"):
            yield
