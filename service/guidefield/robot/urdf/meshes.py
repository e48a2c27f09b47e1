"""Find the files that mesh URIs of a URDF mean, confined to allowed folders.

For robots sent over the wire it is the barrier that no other file of this machine is read (`for_wire`): every path that
is returned has been resolved and compared with `folders`. Local files are searched more widely (`nearby_files.py`).
"""

from __future__ import annotations

import contextlib
import functools
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from urllib.parse import unquote

from guidefield.errors import RobotInvalid
from guidefield.robot.mesh_files.kinds import MESH_SUFFIXES
from guidefield.robot.urdf.nearby_files import (
    MANIFEST,
    MAX_ENTRIES,
    NearbyFiles,
    enclosing_folders,
    exists,
    is_text,
    levels_about,
    package_name,
    same_bytes,
)

PACKAGE_SCHEMES = ("package", "model")
FOLDERS_OF_ENVIRONMENT = ("ROS_PACKAGE_PATH", "GZ_SIM_RESOURCE_PATH", "GAZEBO_MODEL_PATH", "SDF_PATH")
"""Variables that name folders of packages or models."""
CATALOG_PACKAGE = "example-robot-data"
MAX_LISTED = 6  # files that an error lists

SEND_IT = "send it with the robot: `meshes` of `Client.store_robot`"
NAME_ITS_FOLDER = "name the folder of its package: `package_dirs`, or --package-dir"


@functools.cache
def catalog_share() -> Path:
    """Return the folder that holds the package `example-robot-data`: a wheel's, else that of a conda environment."""
    with contextlib.suppress(PackageNotFoundError):
        found = Path(str(distribution(CATALOG_PACKAGE).locate_file("cmeel.prefix/share"))).resolve()
        if found.is_dir():
            return found
    return Path(sys.prefix) / "share"


@dataclass(frozen=True)
class Remark:
    """A file that an unclear mesh URI is taken for; another one, if two packages have the same name; and that name."""

    file: Path
    other: Path | None = None
    package: str = ""


@dataclass(frozen=True)
class MeshResolver:
    """Finds the file that a mesh URI means, if it is in an allowed folder; symbolic links count by their targets."""

    # folders that hold packages, or are packages, in the order in which they are searched
    package_dirs: tuple[Path, ...] = ()
    base: Path | None = None  # folder that relative paths start from
    # folder of each package that is known by name; these are looked in first
    packages: Mapping[str, Path] = field(default_factory=dict)
    # files that came with the robot, by the URIs that it has for them; these come before all others
    given: Mapping[str, Path] = field(default_factory=dict)
    enclosing: tuple[Path, ...] = ()  # the folders about the URDF that may hold packages too, the nearest first
    # files that are searched by the end of their path for what isn't where its URI says; None: no search
    nearby: NearbyFiles | None = None
    # what an error says is allowed; None: the folders. A client over the wire must not see folders of the service
    allowed: tuple[str, ...] | None = None
    advice: str = ""  # what an error says to do about a mesh that isn't there
    folders: tuple[Path, ...] = field(init=False)  # every allowed folder: those of the other attributes
    # files found elsewhere than their URIs say, or ambiguous, by URI: for a warning
    remarks: dict[str, Remark] = field(init=False, default_factory=dict, compare=False)

    def __post_init__(self) -> None:
        base = [] if self.base is None else [self.base]
        allowed = [*self.packages.values(), *self.package_dirs, *base, *self.enclosing[-1:]]
        object.__setattr__(self, "folders", tuple(dict.fromkeys(_fold(folder) for folder in allowed)))

    @classmethod
    def for_wire(cls, package_dirs: Iterable[Path] = (), given: Mapping[str, Path] | None = None) -> MeshResolver:
        """Take what a client sent with a robot, example-robot-data, and folders that the service allows.

        Nothing else is searched, and errors name no folder of this machine.
        """
        folders = tuple(package_dirs)
        own = ("further packages of the service",) if folders else ()
        allowed = ("meshes sent with the robot", f"package://{CATALOG_PACKAGE}/", *own)
        return cls(
            packages=_catalog_packages(), package_dirs=folders, given=given or {}, allowed=allowed, advice=SEND_IT
        )

    @classmethod
    def for_catalog(cls, urdf_path: Path) -> MeshResolver:
        """Take, for a URDF that comes with guidefield, its package alone, which has all that it needs."""
        folder = urdf_path.resolve().parent
        return cls(packages={**_catalog_packages(), **_enclosing_package(folder)}, base=folder)

    @classmethod
    def for_file(cls, urdf_path: Path, package_dirs: Iterable[Path] = ()) -> MeshResolver:
        """Take, for a URDF in a local file, more than the wire allows.

        The folders about the URDF (`enclosing_folders`), the package around it, and the folders of ROS_PACKAGE_PATH and
        AMENT_PREFIX_PATH. What isn't where its URI says is searched by the longest end of its path, in the folders
        about the URDF and then in `package_dirs`.
        """
        folder = urdf_path.resolve().parent
        given_dirs = tuple(package_dirs)
        enclosing = tuple(enclosing_folders(folder))
        levels = levels_about(enclosing, [_fold(given) for given in given_dirs])
        return cls(
            packages={**_catalog_packages(), **_enclosing_package(folder)},
            package_dirs=(*given_dirs, *_package_dirs_of_environment()),
            base=folder,
            enclosing=enclosing,
            nearby=NearbyFiles(levels),
            advice=NAME_ITS_FOLDER,
        )

    def resolve(self, uri: str, suffixes: Sequence[str] = MESH_SUFFIXES) -> Path:
        """Return the file of a URI (package://, model://, file:// or a path), as an absolute path without links.

        A URI may have escapes (`%20` is a blank); a file of the name as written comes first. A mesh that is found
        elsewhere than its URI says is noted in `remarks`; nothing else is searched.

        Raises:
            RobotInvalid: if the URI or its suffix is of another kind, the file is missing, lies outside the allowed
                folders, or may be any of several; names the URI and what is allowed.
        """
        if Path(uri).suffix.lower() not in suffixes:
            kinds = ", ".join(suffixes)
            raise RobotInvalid(f"mesh {uri!r} is not a mesh file; one ends in {kinds}: convert it", uri=uri)
        if uri in self.given:
            return self.given[uri].resolve()
        outside = False
        for written in dict.fromkeys((uri, unquote(uri))):
            candidates = self._candidates(written)
            inside = [path for path in candidates if _is_within(path, self.folders)]
            for path in filter(_is_file, inside):
                if self.nearby is not None:
                    self._compare(uri, path, inside)
                return self._confined(uri, path)
            outside = bool(candidates) and not inside
        found = self._search(uri) if suffixes is MESH_SUFFIXES else None
        if found is not None:
            return found
        if outside:
            raise self._make_refusal(uri, "lies outside what is allowed", self.advice)
        raise self._make_refusal(uri, "was not found", self.advice)

    def package_folder(self, name: str, paths: Sequence[str] = ()) -> Path | None:
        """Return a package's folder, by its own name or that in its `package.xml`; None if there is none.

        The first folder that has one of some paths is taken: if no package of the name has, the nearest folder of the
        robot's package, which is noted in `remarks`.
        """
        inside = tuple(folder.resolve() for folder in self.folders)
        named = [folder for folder in self._holders(name) if exists(folder) and _is_within(folder.resolve(), inside)]
        best = next((folder for folder in named if _has_one(folder, paths)), None)
        if best is not None:
            return best
        own: list[Path] = []
        if self.nearby is not None:
            named += self.nearby.packages(name)
            own = self.nearby.own_folders
        for folder in (*named, *own):
            if _has_one(folder, paths):
                if folder not in named:
                    self.remarks[f"package://{name}"] = Remark(folder)
                return folder
        return named[0] if named else None

    def _confined(self, uri: str, path: Path) -> Path:
        real = path.resolve()
        if not _is_within(real, (folder.resolve() for folder in self.folders)):
            raise self._make_refusal(uri, "is a link that leads outside what is allowed")
        if not is_text(str(real)):
            raise self._make_refusal(uri, f"is in a folder whose name isn't UTF-8: {_printable(real)!r}")
        return real

    def _compare(self, uri: str, taken: Path, candidates: Iterable[Path]) -> None:
        scheme, _, rest = uri.partition("://")
        if scheme in PACKAGE_SCHEMES:
            others = (path for path in candidates if path != taken and _is_file(path))
            other = next((path for path in others if not same_bytes(taken, path)), None)
            if other is not None:
                self.remarks[uri] = Remark(taken, other, rest.lstrip("/").partition("/")[0])

    def _search(self, uri: str) -> Path | None:
        if self.nearby is None:
            return None
        scheme, separator, rest = unquote(uri).partition("://")
        path = rest if separator else unquote(uri)
        declared: list[Path] = []
        if separator and scheme in PACKAGE_SCHEMES:
            name, _, path_in_package = rest.lstrip("/").partition("/")
            declared = [_fold(folder / path_in_package) for folder in self.nearby.packages(name)]
            inside = [file for file in declared if _is_within(file, self.folders) and _is_file(file)]
            if inside:
                self._compare(uri, inside[0], inside)
                return self._confined(uri, inside[0])
        match = self.nearby.find(path, in_package=scheme in PACKAGE_SCHEMES and bool(separator))
        if self.nearby.exhausted and not match.files:
            words = f"was not found, and the folders about it hold too much to search ({MAX_ENTRIES} entries at most)"
            raise self._make_refusal(uri, words, self.advice)
        if len(match.files) > 1:
            listed = ", ".join(map(str, match.files[:MAX_LISTED]))
            more = f" and {len(match.files) - MAX_LISTED} more" if len(match.files) > MAX_LISTED else ""
            raise self._make_refusal(
                uri, f"was not found, and may be any of these different files: {listed}{more}", self.advice
            )
        if not match.files:
            return None
        found = self._confined(uri, match.files[0])
        self.remarks[uri] = Remark(found)
        return found

    def warnings(self) -> list[str]:
        """Return a sentence about each folder in which something was found that its URI says elsewhere."""
        said: list[str] = []
        groups: dict[tuple[str, Path], list[tuple[str, Remark]]] = {}
        for uri, remark in self.remarks.items():
            if remark.other is not None:
                said.append(
                    f"two packages are called {remark.package!r}: mesh {uri!r} is taken from {str(remark.file)!r}, "
                    f"not from {str(remark.other)!r}, which is another file"
                )
            else:
                groups.setdefault((uri.rpartition("/")[0], remark.file.parent), []).append((uri, remark))
        for group in groups.values():
            uri, remark = group[0]
            others = f", {len(group) - 1} more of its folder likewise" if len(group) > 1 else ""
            what = _kind(uri) if Path(uri).suffix else "package"
            said.append(f"{what} {uri!r} is not there; {str(remark.file)!r} is taken for it{others}")
        return said

    def _candidates(self, uri: str) -> list[Path]:
        """Return the paths that a URI may mean, `..` folded; nothing is looked up on disk."""
        scheme, separator, rest = uri.partition("://")
        if separator and scheme in PACKAGE_SCHEMES:
            name, _, path = rest.lstrip("/").partition("/")
            return [_fold(folder / path.lstrip("/")) for folder in self._holders(name)]
        if separator and scheme != "file":
            raise RobotInvalid(
                f"{_kind(uri)} {uri!r} cannot be fetched; files are package://, model://, file:// or paths", uri=uri
            )
        path = rest if separator else uri
        if path.startswith("/"):
            return [_fold(Path(path))]
        return [_fold(start / path) for start in (self.base, *self.package_dirs) if start is not None]

    def _holders(self, name: str) -> list[Path]:
        named = [folder for package, folder in self.packages.items() if package == name]
        return [*named, *(f if f.name == name else f / name for f in (*self.package_dirs, *self.enclosing))]

    def _make_refusal(self, uri: str, why: str, advice: str = "") -> RobotInvalid:
        allowed = [_printable(folder) for folder in self.folders] if self.allowed is None else list(self.allowed)
        words = f"{_kind(uri)} {uri!r} {why} (allowed: {', '.join(allowed) or 'nothing'})"
        return RobotInvalid(f"{words}; {advice}" if advice else words, uri=uri, allowed=allowed)


def _kind(uri: str) -> str:
    return "mesh" if Path(uri).suffix.lower() in MESH_SUFFIXES else "file"


def _catalog_packages() -> dict[str, Path]:
    return {CATALOG_PACKAGE: catalog_share() / CATALOG_PACKAGE}


def _enclosing_package(folder: Path) -> dict[str, Path]:
    """Return the package that a folder belongs to, by the names of its folder and of its manifest."""
    for above in (folder, *folder.parents):
        manifest = above / MANIFEST
        if exists(manifest):
            return dict.fromkeys((above.name, package_name(manifest) or above.name), above)
    return {}


def _package_dirs_of_environment() -> list[Path]:
    roots = os.pathsep.join(os.environ.get(name, "") for name in FOLDERS_OF_ENVIRONMENT).split(os.pathsep)
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [*(Path(root) for root in roots if root), *(Path(prefix) / "share" for prefix in prefixes if prefix)]


def _fold(path: Path) -> Path:
    """Return a path that is absolute and without `..`, by its letters alone: nothing is looked up on disk."""
    return Path(os.path.normpath(path.absolute()))


def _printable(path: Path) -> str:
    return str(path).encode(errors="backslashreplace").decode()


def _has_one(folder: Path, paths: Iterable[str]) -> bool:
    return any(path.is_relative_to(folder) and exists(path) for path in (_fold(folder / path) for path in paths))


def _is_within(path: Path, folders: Iterable[Path]) -> bool:
    return any(path.is_relative_to(folder) for folder in folders)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name too long, or with a NUL
        return False
