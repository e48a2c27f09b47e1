"""Where the mesh files of a URDF may come from: URIs to real files, confined to allowed folders."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import distribution
from pathlib import Path
from urllib.parse import unquote

from guidefield.errors import RobotInvalid

MESH_SUFFIXES = (".3mf", ".dae", ".glb", ".gltf", ".obj", ".off", ".ply", ".stl")
"""Kinds of mesh files that are read."""

PACKAGE_SCHEMES = ("package", "model")
CATALOG_PACKAGE = "example-robot-data"

SEND_IT = "send it with the robot: `meshes` of `Client.store_robot`"
NAME_ITS_FOLDER = "name the folder of its package: `package_dirs`, or --package-dir of `guidefield robots`"


@functools.cache
def catalog_share() -> Path:
    """The folder that holds the package `example-robot-data`."""
    return Path(str(distribution(CATALOG_PACKAGE).locate_file("cmeel.prefix/share"))).resolve()


@dataclass(frozen=True)
class MeshResolver:
    """Finds the file that a mesh URI means, if it lies in an allowed folder.

    A path with `..` or a link is judged by where it ends.

    Attributes:
        package_dirs: Folders that hold packages, or are packages, in the order in which they are searched.
        base: Folder that relative paths start from; None where there is none.
        packages: Folder of each package that is known by name; these are looked in first.
        given: Files that came with the robot, by the URIs that it has for them; these come before all others.
        folders: Every allowed folder: those of the other attributes.
        told: What an error says is allowed; None: the folders. Who asks over the wire is told no folder of ours.
        advice: What an error says to do about a mesh that isn't there.
    """

    package_dirs: tuple[Path, ...] = ()
    base: Path | None = None
    packages: Mapping[str, Path] = field(default_factory=dict)
    given: Mapping[str, Path] = field(default_factory=dict)
    told: tuple[str, ...] | None = None
    advice: str = ""
    folders: tuple[Path, ...] = field(init=False)

    def __post_init__(self) -> None:
        allowed = [*self.packages.values(), *self.package_dirs, *([] if self.base is None else [self.base])]
        object.__setattr__(self, "folders", tuple(dict.fromkeys(_folded(folder) for folder in allowed)))

    @classmethod
    def for_wire(cls, package_dirs: Iterable[Path] = (), given: Mapping[str, Path] | None = None) -> MeshResolver:
        """For robots that a client sends: what came with them, example-robot-data, and folders that the service allows.

        Its errors name no folder of this machine.
        """
        folders = tuple(package_dirs)
        own = ("further packages of the service",) if folders else ()
        told = ("meshes sent with the robot", f"package://{CATALOG_PACKAGE}/", *own)
        return cls(packages=_catalog_packages(), package_dirs=folders, given=given or {}, told=told, advice=SEND_IT)

    @classmethod
    def for_file(cls, urdf_path: Path, package_dirs: Iterable[Path] = ()) -> MeshResolver:
        """For a URDF in a local file.

        Besides what the wire allows: the URDF's folder, the package around it (the nearest folder above that has a
        `package.xml`), and the folders of ROS_PACKAGE_PATH and AMENT_PREFIX_PATH.
        """
        folder = urdf_path.resolve().parent
        packages = {**_catalog_packages(), **_enclosing_package(folder)}
        dirs = (*package_dirs, *_package_dirs_of_environment())
        return cls(packages=packages, package_dirs=dirs, base=folder, advice=NAME_ITS_FOLDER)

    def resolve(self, uri: str) -> Path:
        """The file that a mesh URI means, as an absolute path without links.

        Args:
            uri: `package://name/…`, `model://name/…`, `file://…`, or an absolute or relative path.

        Raises:
            RobotInvalid: if the URI is of another kind, the file isn't a mesh, is missing, or lies outside the allowed
                folders; names the URI and what is allowed.
        """
        if uri in self.given:
            return self.given[uri].resolve()
        if Path(uri).suffix.lower() not in MESH_SUFFIXES:
            raise self._refused(uri, f"is not a mesh file; one ends in {', '.join(MESH_SUFFIXES)}")
        candidates = self._candidates(uri)
        inside = [path for path in candidates if _is_within(path, self.folders)]
        for path in filter(_is_file, inside):
            real = path.resolve()
            if _is_within(real, (folder.resolve() for folder in self.folders)):
                return real
            raise self._refused(uri, "is a link that leads outside what is allowed")
        if candidates and not inside:
            raise self._refused(uri, "lies outside what is allowed", self.advice)
        raise self._refused(uri, "was not found", self.advice)

    def _candidates(self, uri: str) -> list[Path]:
        """Paths that a URI may mean, `..` folded; nothing is looked up on disk."""
        scheme, separator, rest = uri.partition("://")
        if separator and scheme in PACKAGE_SCHEMES:
            name, _, path = rest.lstrip("/").partition("/")
            named = [folder for package, folder in self.packages.items() if package == name]
            holders = [folder if folder.name == name else folder / name for folder in self.package_dirs]
            return [_folded(folder / path.lstrip("/")) for folder in (*named, *holders)]
        if separator and scheme != "file":
            raise self._refused(uri, "cannot be fetched; meshes are package://, model://, file:// or paths")
        path = unquote(rest) if separator else uri
        if path.startswith("/"):
            return [_folded(Path(path))]
        return [_folded(start / path) for start in (self.base, *self.package_dirs) if start is not None]

    def _refused(self, uri: str, why: str, advice: str = "") -> RobotInvalid:
        allowed = [str(folder) for folder in self.folders] if self.told is None else list(self.told)
        words = f"mesh {uri!r} {why} (allowed: {', '.join(allowed) or 'nothing'})"
        return RobotInvalid(f"{words}; {advice}" if advice else words, uri=uri, allowed=allowed)


def _catalog_packages() -> dict[str, Path]:
    return {CATALOG_PACKAGE: catalog_share() / CATALOG_PACKAGE}


def _enclosing_package(folder: Path) -> dict[str, Path]:
    """The package that a folder belongs to, by the names of its folder and of its manifest."""
    for above in (folder, *folder.parents):
        manifest = above / "package.xml"
        if manifest.is_file():
            declared = re.search(r"<name>\s*([^<\s]+)\s*</name>", manifest.read_text(errors="replace"))
            return dict.fromkeys((above.name, declared.group(1) if declared else above.name), above)
    return {}


def _package_dirs_of_environment() -> list[Path]:
    """Folders of packages that a ROS environment names; those of Pinocchio's own search."""
    roots = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [*(Path(root) for root in roots if root), *(Path(prefix) / "share" for prefix in prefixes if prefix)]


def _folded(path: Path) -> Path:
    """Absolute and without `..`, by its letters alone: nothing is looked up on disk."""
    return Path(os.path.normpath(path.absolute()))


def _is_within(path: Path, folders: Iterable[Path]) -> bool:
    return any(path.is_relative_to(folder) for folder in folders)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name too long, or with a NUL
        return False
