"""Scenes by name: those that come with the package, and those that clients stored on disk."""

from __future__ import annotations

from pathlib import Path

from guidefield.errors import RequestTooLarge, SceneInvalid
from guidefield.messages import codec
from guidefield.messages.faults import MOST_NAMED, nearest
from guidefield.messages.scene import Scene
from guidefield.scene import library
from guidefield.stores.files import checked_name, decoded, read_if_any
from guidefield.whole_file import write_whole


class PackagedScenes:
    """The scenes that come with the package; keeps no other."""

    def names(self) -> list[str]:
        """The scenes that can be read, in alphabetical order."""
        return sorted(library.names())

    def read(self, name: str) -> Scene:
        """One scene.

        Raises:
            SceneInvalid: if it is unknown; lists those that can be read.
        """
        if name not in library.names():
            raise _unknown(name, self.names())
        return library.read(name)

    def write(self, scene: Scene) -> None:
        """Raise SceneInvalid: nothing can be stored here."""
        raise SceneInvalid(
            f"scene {scene.name!r} cannot be stored: scenes are kept only where there is a data folder; "
            "send the scene inside the request instead",
            scene=scene.name,
        )

    def delete(self, name: str) -> None:
        """Raise SceneInvalid: a scene of the package stays."""
        self.read(name)
        raise SceneInvalid(f"scene {name!r} comes with the package and cannot be deleted", scene=name)


class SceneStore:
    """The packaged scenes, and clients' own as `<name>.json` in a folder.

    Several processes may share the folder. Where the disk refuses, OSError comes through.

    Args:
        folder: Made if it isn't there.
        limit: How many scenes clients may store.
    """

    def __init__(self, folder: Path, limit: int = 1_000) -> None:
        self._folder = folder
        self._limit = limit
        self._packaged = PackagedScenes()
        folder.mkdir(parents=True, exist_ok=True)

    def names(self) -> list[str]:
        """The scenes that can be read, in alphabetical order."""
        return sorted({*self._packaged.names(), *self._own()})

    def read(self, name: str) -> Scene:
        """One scene.

        Raises:
            SceneInvalid: if it is unknown, and lists those that can be read; or if its file is damaged.
        """
        stored = read_if_any(self._path(name))
        if stored is not None:
            scene = decoded(stored, Scene)
            if scene is None:
                raise SceneInvalid(f"scene {name!r} can't be read: its file is damaged; store it again", scene=name)
            return scene
        if name in self._packaged.names():
            return self._packaged.read(name)
        raise _unknown(name, self.names())

    def write(self, scene: Scene) -> None:
        """Keep a scene under its own name, in place of an earlier one of that name.

        Raises:
            MalformedRequest: if the name can't be a file's.
            SceneInvalid: if the name is that of a packaged scene: it means the same everywhere.
            RequestTooLarge: if there are too many scenes already.
        """
        path = self._path(scene.name)
        if scene.name in self._packaged.names():
            raise SceneInvalid(
                f"scene {scene.name!r} comes with the package and cannot be replaced; choose another name",
                scene=scene.name,
            )
        if not path.exists() and len(self._own()) >= self._limit:
            raise RequestTooLarge(f"{self._limit} scenes are stored already; delete one first", limit=self._limit)
        write_whole(path, codec.encode(scene))

    def delete(self, name: str) -> None:
        """Forget a stored scene.

        Raises:
            SceneInvalid: if it is unknown, or comes with the package.
        """
        try:
            self._path(name).unlink()
        except FileNotFoundError:
            if name not in self._packaged.names():
                raise _unknown(name, self.names()) from None
            self._packaged.delete(name)

    def _own(self) -> list[str]:
        return [path.stem for path in self._folder.glob("*.json") if not path.name.startswith(".")]

    def _path(self, name: str) -> Path:
        return self._folder / f"{checked_name(name, 'scene')}.json"


Scenes = PackagedScenes | SceneStore
"""What an engine reads scenes from, and keeps them in."""


def _unknown(name: str, names: list[str]) -> SceneInvalid:
    near = nearest(name, names)
    meant = f"did you mean {' or '.join(near)}? " if near else ""
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    file = "a scene in a file is sent itself, as the file holds it; " if name.endswith(".json") else ""
    return SceneInvalid(
        f"there is no scene {name[:64]!r}; {meant}{file}there are {', '.join(names[:MOST_NAMED])}{more}",
        scene=name[:64],
        available=names,
    )
