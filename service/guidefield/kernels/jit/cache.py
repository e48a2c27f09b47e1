"""Cache of the kernels' machine code: a folder for every version of a file and of all that it calls.

numba compares a cached function with the file it stands in, but not with the files of the functions that it calls:
after an edit of a callee it runs the old machine code. A folder named after a fingerprint of a file and of every
definition that it depends on cannot be stale, and an edit compiles only what depends on it: that of a
comment or docstring its own file alone. The sources' place is not part of the name: all installations of one version
share their machine code.
"""

from __future__ import annotations

import ast
import contextlib
import fcntl
import functools
import hashlib
import inspect
import json
import logging
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from numba import config
from numba.core.caching import UserProvidedCacheLocator

from guidefield.first_start import (
    KERNELS,
    cache_parent,
    compiling_lock,
    is_compiling,
    kernel_compiler,
    kernels_fingerprint,
)
from guidefield.whole_file import write_whole

Symbol = tuple[str, str]  # a name that a file defines: the file's own name, with dots, and that name


@dataclass(frozen=True)
class Statement:
    """A statement of a file outside of any function."""

    text: str  # its syntax, without docstrings and comments
    names: frozenset[str]  # the names that it mentions
    is_kernel: bool  # whether it is a function whose machine code is kept


@dataclass(frozen=True)
class Source:
    """A kernel file."""

    content: bytes
    # names that it has from other kernel files: the file of each, and its name there; None: the file itself
    imports: dict[str, tuple[str, str | None]]
    definitions: dict[str, tuple[Statement, ...]]  # the statements that define each name
    effects: tuple[Statement, ...]  # Statements that do something when the file is imported


class Sources:
    """All files below a folder of kernels, by their names below it, with dots: each is read once.

    Args:
        folder: The folder.
        package: What it is imported as.
        others: Files of another package that these may import from; here they go by their full names.
    """

    def __init__(self, folder: Path, package: str, others: Sources | None = None) -> None:
        self.folder = folder
        self.package = package
        self._others = others
        self._read: dict[str, Source] = {}
        self._called: dict[str, set[str]] = {}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Every file's name, sorted."""
        paths = (path.relative_to(self.folder).with_suffix("") for path in self.folder.rglob("*.py"))
        return tuple(sorted(".".join(path.parts) for path in paths))

    def path(self, name: str) -> Path:
        """The file of a name."""
        if self._others is not None and name.startswith(f"{self._others.package}."):
            return self._others.path(name.removeprefix(f"{self._others.package}."))
        return self.folder.joinpath(*name.split(".")).with_suffix(".py")

    def source(self, name: str) -> Source:
        """What stands in a file."""
        if name not in self._read:
            self._read[name] = self._parsed(self.path(name).read_bytes())
        return self._read[name]

    def imported(self, name: str) -> set[str]:
        """The names of all files that are imported with one, its own among them."""
        found, waiting = {name}, [name]
        while waiting:
            new = {file for file, _ in self.source(waiting.pop()).imports.values()} - found
            found |= new
            waiting += new
        return found

    def called(self, name: str) -> set[str]:
        """The names of all files with kernels that those of one call, themselves or through parts; its own too."""
        found, waiting = {name}, [name]
        while waiting:
            new = self._called_directly(waiting.pop()) - found
            found |= new
            waiting += new
        return found

    def _called_directly(self, name: str) -> set[str]:
        if name not in self._called:
            needed = self._needed(name).items()
            self._called[name] = {file for (file, _), statements in needed if any(one.is_kernel for one in statements)}
        return self._called[name]

    def fingerprint(self, name: str, also: str = "") -> str:
        """Sixteen hexadecimal digits that change with a file and with every definition that its code depends on.

        Args:
            name: The file's name.
            also: What else they have to change with.
        """
        digest = hashlib.sha256(f"{also}\0{name}\0".encode() + self.source(name).content)
        for (file, defined), statements in sorted(self._needed(name).items()):
            texts = "\0".join(statement.text for statement in statements)
            digest.update(f"\0{file}\0{defined}\0{texts}".encode())
        return digest.hexdigest()[:16]

    def _needed(self, name: str) -> dict[Symbol, tuple[Statement, ...]]:
        """The statements that a file depends on, by what they define; what has effects by their place."""
        found: dict[Symbol, tuple[Statement, ...]] = {}
        waiting: list[Symbol] = [(name, defined) for defined in self.source(name).definitions]
        for file in self.imported(name):
            for index, effect in enumerate(self.source(file).effects):
                found[file, f"effect {index}"] = (effect,)
                waiting += self._mentioned(file, effect)
        while waiting:
            symbol = waiting.pop()
            if symbol in found:
                continue
            found[symbol] = self.source(symbol[0]).definitions[symbol[1]]
            for statement in found[symbol]:
                waiting += self._mentioned(symbol[0], statement)
        return found

    def _mentioned(self, file: str, statement: Statement) -> Iterator[Symbol]:
        """The definitions that a statement of a file mentions; of a file that it mentions as a whole, all."""
        source = self.source(file)
        for name in statement.names:
            if name in source.definitions:
                yield file, name
            if name in source.imports:
                yield from self._defined(*source.imports[name])

    def _defined(self, file: str, name: str | None) -> Iterator[Symbol]:
        """Where a name of a file, or all of them, are defined: the file may have it from another one."""
        source = self.source(file)
        if name is None:
            yield from ((file, one) for one in source.definitions)
        elif name in source.definitions:
            yield file, name
        elif name in source.imports:
            yield from self._defined(*source.imports[name])

    def _parsed(self, content: bytes) -> Source:
        tree = ast.parse(content)
        imports = dict(self._imports(tree))
        definitions: dict[str, tuple[Statement, ...]] = {}
        effects = []
        for node in tree.body:
            if isinstance(node, ast.Import | ast.ImportFrom) or _is_docstring(node):
                continue
            names = _defined_by(node, imports)
            if names is None:
                effects.append(_statement(node))
            for name in names or ():
                definitions[name] = (*definitions.get(name, ()), _statement(node))
        return Source(content, imports, definitions, tuple(effects))

    def _imports(self, tree: ast.Module) -> Iterator[tuple[str, tuple[str, str | None]]]:
        """The names that a file has from others of this folder, wherever in it they are imported."""
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    if (file := self._file(alias.name)) is not None:
                        yield alias.asname or self.package.partition(".")[0], (file, None)
            elif isinstance(node, ast.ImportFrom) and node.module is not None:
                for alias in node.names:
                    name = alias.asname or alias.name
                    if (file := self._file(f"{node.module}.{alias.name}")) is not None:
                        yield name, (file, None)
                    elif (file := self._file(node.module)) is not None:
                        yield name, (file, alias.name)

    def _file(self, module: str) -> str | None:
        """The name of a module's file, of this package or the other one; None if there is no such file."""
        if self._others is not None and self._others._file(module) is not None:
            return module
        if not module.startswith(f"{self.package}."):
            return None
        name = module.removeprefix(f"{self.package}.")
        return name if self.path(name).is_file() else None


def _defined_by(node: ast.stmt, imports: dict[str, tuple[str, str | None]]) -> list[str] | None:
    """The names that a statement defines and does nothing else; None if it may do more.

    A function does nothing else where its decorators are of this folder.
    """
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        decorators = [one.func if isinstance(one, ast.Call) else one for one in node.decorator_list]
        plain = all(isinstance(one, ast.Name) and one.id in imports for one in decorators)
        return [node.name] if plain else None
    if isinstance(node, ast.Assign | ast.AnnAssign):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        within = [one for target in targets for one in ast.walk(target)]
        names = [one.id for one in within if isinstance(one, ast.Name)]
        plain = all(isinstance(one, ast.Name | ast.Tuple | ast.List | ast.expr_context) for one in within)
        return names if plain else None
    return None


def _is_docstring(node: ast.AST) -> bool:
    """Whether a statement is a text that nobody reads but people."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _statement(node: ast.stmt) -> Statement:
    for within in ast.walk(node):
        if isinstance(within, ast.FunctionDef | ast.ClassDef):
            within.body = [one for one in within.body if not _is_docstring(one)] or [ast.Pass()]
    names = frozenset(one.id for one in ast.walk(node) if isinstance(one, ast.Name))
    return Statement(ast.dump(node), names, isinstance(node, ast.FunctionDef) and _is_kernel(node))


def _is_kernel(node: ast.FunctionDef) -> bool:
    decorators = [one.func if isinstance(one, ast.Call) else one for one in node.decorator_list]
    return any(isinstance(one, ast.Name) and one.id in _KERNELS for one in decorators)


_KERNELS = ("kernel", "compiled", "inner_kernel", "exact_kernel", "vector_kernel", "vector_step")  # their decorators
_KEPT = re.compile(rf"^@(?:{'|'.join(_KERNELS)})\b", re.MULTILINE)

_WHOLE, _WANTED = "whole", "wanted"  # in a folder: all of its machine code is there; somebody waits for it
_POLL_S = 0.05  # period at which a waiting process looks [s]
_log = logging.getLogger(__name__)

_NUMBAS_OWN = "UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator,IPythonCacheLocator,ZipCacheLocator"
"""Whom numba asks for folders, where the variable ``NUMBA_CACHE_LOCATOR_CLASSES`` says nothing else."""


class KernelCacheLocator(UserProvidedCacheLocator):  # type: ignore[misc]  # numba has no types
    """Tells numba the folder of a kernel's machine code; leaves every function that is none of ours alone."""

    def __init__(self, function: Callable[..., object], file: str, folder: Path) -> None:
        super().__init__(function, file)
        self._folder = folder

    @classmethod
    def from_function(cls, function: Callable[..., object], file: str) -> KernelCacheLocator | None:
        """A locator if the function is one of our kernels.

        Whether a folder can be written is asked where there is none yet, and by numba before it writes: of one on a
        disk that is only read kernels are loaded.

        Raises:
            OSError: if its folder cannot be made or written; set ``NUMBA_CACHE_DIR`` to a writable one.
        """
        folder = _folder_of(Path(file))
        if folder is None:
            return None
        locator = cls(function, file, folder)
        if not folder.is_dir():
            locator.ensure_cache_path()
        return locator

    def get_cache_path(self) -> str:
        """The folder of the machine code."""
        return str(self._folder)


def use_kernel_folders() -> None:
    """Have numba ask `KernelCacheLocator` first, in this process.

    Before every kernel: numba reads its settings again when a variable of the environment has changed.
    """
    ours, others = f"{__name__}.{KernelCacheLocator.__name__}", config.CACHE_LOCATOR_CLASSES or _NUMBAS_OWN
    if not others.startswith(ours):
        config.CACHE_LOCATOR_CLASSES = f"{ours},{others}"


def is_kept(function: Callable[..., object]) -> bool:
    """Whether a function is one of the kernels whose machine code is kept."""
    file = Path(inspect.getfile(function))
    return any(file.is_relative_to(folder) for folder in (KERNELS, *(known.folder for known in _OTHERS.values())))


def keep_kernels_of(package: str, folder: Path) -> None:
    """Keep machine code of the kernels of another package too, which may call ours; that of the tests, for instance.

    Args:
        package: Its name.
        folder: Where its files are.
    """
    _OTHERS[package] = Sources(folder, package, sources())


def cache_folder() -> Path:
    """The folder of all kernels' machine code: ``<parent>/guidefield/kernels``.

    The parent is that of all caches (`first_start`).
    """
    return cache_parent() / "guidefield" / "kernels"


def uncompiled() -> set[str]:
    """The files with kernels that numba keeps that have no machine code, by name."""
    known = sources()
    kept = [name for name in known.names if _KEPT.search(known.path(name).read_text())]
    return {name for name in kept if not is_compiled(name)}


def is_compiled(name: str) -> bool:
    """Whether all machine code of a file is there."""
    return (kernel_folder(name) / _WHOLE).exists()


def note_compiled(name: str) -> None:
    """Note that all machine code of a file is there."""
    (kernel_folder(name) / _WHOLE).touch()


def is_wanted(name: str) -> bool:
    """Whether somebody waits for the machine code of a file."""
    return (kernel_folder(name) / _WANTED).exists()


@contextlib.contextmanager
def compile_alone() -> Iterator[bool]:
    """Keep others from compiling this version's kernels at the same time; yield whether nobody else does.

    Where a file system has no locks everybody compiles.
    """
    file = compiling_lock()
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        except OSError:
            yield True
            return
        try:
            yield True
        finally:
            file.unlink(missing_ok=True)


def await_machine_code(function: Callable[..., object]) -> None:
    """Wait for the machine code of a kernel's file as long as another process compiles this version's kernels."""
    file = Path(inspect.getfile(function))
    if not file.is_relative_to(KERNELS) or is_compiled(name := _name(file, KERNELS)) or not is_compiling():
        return
    _log.warning("waits until the kernels of %s are compiled, once for this version", name)
    with contextlib.suppress(OSError):
        kernel_folder(name).mkdir(parents=True, exist_ok=True)
        (kernel_folder(name) / _WANTED).touch()
    while not is_compiled(name) and is_compiling():
        time.sleep(_POLL_S)


def kernel_folder(name: str) -> Path:
    """The folder of one kernel file's machine code; it need not exist."""
    return cache_folder() / f"{name}-{_fingerprints()[name]}"


_OTHERS: dict[str, Sources] = {}  # other packages whose kernels are kept, by name


def _folder_of(file: Path) -> Path | None:
    """The folder of a file's machine code; None for one that has no kernels of ours."""
    if file.is_relative_to(KERNELS):
        return kernel_folder(_name(file, KERNELS))
    for package, known in _OTHERS.items():
        if file.is_relative_to(known.folder):
            name = _name(file, known.folder)
            return cache_folder() / f"{package}.{name}-{known.fingerprint(name, kernel_compiler())}"
    return None


def _name(file: Path, folder: Path) -> str:
    """A file's name below a folder, with dots."""
    return ".".join(file.relative_to(folder).with_suffix("").parts)


@functools.cache
def sources() -> Sources:
    """The kernels' sources, read when they are first asked for."""
    return Sources(KERNELS, "guidefield.kernels")


@functools.cache
def _fingerprints() -> dict[str, str]:
    """Every file's fingerprint, by name: worked out once for a version and kept with the machine code."""
    kept = cache_folder() / f"fingerprints-{kernels_fingerprint()}.json"
    with contextlib.suppress(OSError, ValueError):
        found: dict[str, str] = json.loads(kept.read_text())
        return found
    known = sources()
    made = {name: known.fingerprint(name, kernel_compiler()) for name in known.names}
    with contextlib.suppress(OSError):  # where nothing can be written, numba says so at the first kernel
        kept.parent.mkdir(parents=True, exist_ok=True)
        write_whole(kept, json.dumps(made).encode(), durable=False)
    return made
