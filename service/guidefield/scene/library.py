"""The scenes that come with guidefield, by name: the files `guidefield/scenes/<name>.json`; a new one is found."""

from __future__ import annotations

import functools
from importlib import resources

from guidefield.errors import SceneInvalid
from guidefield.messages import codec
from guidefield.messages.scene import Scene

_PACKAGE = "guidefield.scenes"


@functools.cache
def names() -> tuple[str, ...]:
    """Names of the packaged scenes, in alphabetical order."""
    files = resources.files(_PACKAGE).iterdir()
    return tuple(sorted(file.name.removesuffix(".json") for file in files if file.name.endswith(".json")))


def read(name: str) -> Scene:
    """Read a packaged scene; raises SceneInvalid, which lists those there are, if there is none of that name."""
    available = names()
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
