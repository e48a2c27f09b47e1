"""Name to robot: the cards in `robots/`, every URDF of example-robot-data, any URDF file or text."""

from __future__ import annotations

import functools
import hashlib
import importlib.resources
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from guidefield.errors import RobotInvalid
from guidefield.messages.replies import RobotSummary
from guidefield.messages.requests import RobotReference, UrdfFile, UrdfText
from guidefield.robot import card as cards
from guidefield.robot.card import RobotCard
from guidefield.robot.loading import load
from guidefield.robot.meshes import CATALOG_PACKAGE, MeshResolver, catalog_share
from guidefield.robot.model import RobotModel, RobotSource
from guidefield.robot.summary import summarize

MAX_CACHED = 32
"""Robots kept loaded."""


@dataclass(frozen=True)
class Entry:
    """One name of the catalog: the card, and whether it is ours or found."""

    name: str
    card: RobotCard
    folder: Path
    source: str


class Catalog:
    """Loads robots and keeps those it has loaded.

    Args:
        package_dirs: Further folders from which robots sent as text may take meshes.
    """

    def __init__(self, package_dirs: Iterable[Path] = ()) -> None:
        self._package_dirs = tuple(package_dirs)
        self._loaded: dict[str, RobotModel] = {}

    def names(self) -> list[str]:
        """Names that `load` knows."""
        return sorted(_entries())

    def summaries(self) -> list[RobotSummary]:
        """A line about each name, in their order; robots with a problem say it."""
        return [summarize(e.name, e.source, e.folder, e.card) for _, e in sorted(_entries().items())]

    def load(self, reference: RobotReference) -> RobotModel:
        """The robot that a request means.

        Raises:
            RobotInvalid: if the name is unknown, or the description cannot be used.
        """
        key = _key(reference)
        if key not in self._loaded:
            while len(self._loaded) >= MAX_CACHED:
                del self._loaded[next(iter(self._loaded))]
            self._loaded[key] = self._build(reference)
        return self._loaded[key]

    def _build(self, reference: RobotReference) -> RobotModel:
        if isinstance(reference, str):
            return self._from_catalog(reference)
        if isinstance(reference, UrdfText):
            source = RobotSource(reference.text, None, reference.root_joint)
            return load("urdf", source, reference.srdf, cards.EMPTY, MeshResolver.for_wire(self._package_dirs))
        return _from_file(reference)

    def _from_catalog(self, name: str) -> RobotModel:
        entry = _entries().get(name)
        if entry is None:
            raise RobotInvalid(
                f"there is no robot {name!r}; `guidefield robots` lists those there are",
                robot=name,
                available=self.names(),
            )
        path = entry.folder / entry.card.urdf
        srdf = (entry.folder / entry.card.srdf).read_text() if entry.card.srdf else None
        source = RobotSource(path.read_text(), path, entry.card.root_joint)
        return load(name, source, srdf, entry.card, MeshResolver.for_file(path))


def _from_file(reference: UrdfFile) -> RobotModel:
    path = Path(reference.path).expanduser().resolve()
    if not path.is_file():
        raise RobotInvalid(f"there is no URDF file {reference.path!r}", path=reference.path)
    srdf_path = Path(reference.srdf_path).expanduser() if reference.srdf_path else None
    if srdf_path is not None and not srdf_path.is_file():
        raise RobotInvalid(f"there is no SRDF file {reference.srdf_path!r}", path=reference.srdf_path)
    resolver = MeshResolver.for_file(path, [Path(folder).expanduser().resolve() for folder in reference.package_dirs])
    source = RobotSource(path.read_text(), path, reference.root_joint)
    return load(path.stem, source, srdf_path.read_text() if srdf_path else None, cards.EMPTY, resolver)


def _key(reference: RobotReference) -> str:
    if isinstance(reference, str):
        return f"catalog:{reference}"
    if isinstance(reference, UrdfText):
        content = "\0".join((reference.text, reference.srdf or "", reference.root_joint))
        return f"text:{hashlib.sha256(content.encode()).hexdigest()}"
    path = Path(reference.path).expanduser()
    changed = path.stat().st_mtime_ns if path.is_file() else 0
    return f"file:{path.resolve()}:{changed}:{reference.srdf_path}:{reference.package_dirs}:{reference.root_joint}"


@functools.cache
def _entries() -> dict[str, Entry]:
    """Every name: found URDFs first, our cards over them."""
    robots = catalog_share() / CATALOG_PACKAGE / "robots"
    entries = {}
    urdfs = sorted(robots.glob("*/*/*.urdf"))
    stems = [path.stem for path in urdfs]
    for path in urdfs:
        package = path.parts[-3].removesuffix("_description")
        name = path.stem.removesuffix("_robot").lower()
        if stems.count(path.stem) > 1 or (name in entries):
            name = package.lower()
        srdf = robots / path.parts[-3] / "srdf" / f"{path.stem}.srdf"
        card = RobotCard(str(path.relative_to(robots)), str(srdf.relative_to(robots)) if srdf.is_file() else None)
        entries[name] = Entry(name, card, robots, "example-robot-data")
    ours = importlib.resources.files("guidefield.robots")
    for resource in sorted(ours.iterdir(), key=lambda r: r.name):
        if resource.name.endswith(".card.json"):
            name = resource.name.removesuffix(".card.json")
            card = cards.decode(resource.read_bytes())
            folder = robots if (robots / card.urdf).is_file() else Path(str(ours))
            origin = "example-robot-data" if folder is robots else "guidefield"
            entries[name] = Entry(name, card, folder, origin)
    return entries
