"""The house itself: what its pages say, what a wheel of it holds, and the rules that no other tool keeps."""

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import NamedTuple, get_origin

import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from typer.main import get_command

from guidefield.cli import app
from guidefield.read_only import ReadOnly
from guidefield.robot.model import joints

HOUSE = Path(__file__).resolve().parent.parent
PACKAGE = HOUSE / "service" / "guidefield"
PROJECT = tomllib.loads((HOUSE / "pyproject.toml").read_text())
SOURCES = sorted(PACKAGE.rglob("*.py"))
PAGES = [*sorted(HOUSE.glob("*.md")), *sorted((HOUSE / "service" / "docs").glob("*.md"))]
CITATION = re.compile(r"([\w./-]*\w\.md)\b(?:,\s+\"([^\"]+)\")?")  # a document, and its section where one is named
FOREIGN_NAMES = {
    "get_cache_path",
    "get_call_template",
    "_get_module_for_linking",
    "get_mangle_string",
    "do_GET",
    "get_params",
}
"""Methods that other packages ask for by these names."""
IN_CMEEL = {"pinocchio": ["pin"], "coal": ["coal"]}
"""Packages below a folder of their own, which `importlib.metadata` doesn't look into."""
OPTIONAL = {
    "IPython",
    "rerun_notebook",
    "viser",
    "cryptography",
    "ray",
    "opentelemetry",
    "prometheus_client",
    "mcp",
    "mcp_types",
    "mujoco",
    "rosbags",
    "xacro",
}
"""Imported where the extra of that name is installed."""
UNIMPORTED = {"example-robot-data", "pycollada"}  # data, and what trimesh needs for the files that we give it
COMES_WITH_NUMBA = {"llvmlite"}  # numba demands the one version that fits
SHAPE = re.compile(r"\((?:[\w.+*/ -]|\.\.\.)+,(?:[\w.+*/, -]|\.\.\.)*\)|\(\d\)|shape")
"""How docstrings say shapes: (n, 3), (nq,), (3), or in words."""
SPACES = [name for name, kind in vars(joints).items() if get_origin(kind) is np.ndarray]
ARRAYS = re.compile(rf"ndarray|NDArray|Floats|Integers|\b({'|'.join(SPACES)})\b")  # how annotations say arrays
AS_ANOTHER = re.compile(r"`\w+`")  # another function, whose docstring says them
VAGUE = re.compile(r"^_?(?:get|compute|do|handle_data)_.*")
HOME_PATH = re.compile(r"(?<![\w.])/(?:root|home|Users)/\w+")


def _relative(path: Path) -> str:
    return str(path.relative_to(HOUSE))


def _ours() -> Iterator[Path]:
    """Every text file of the project."""
    for folder in ("service", "robots", "scenes", "tests", "tools", ".ci"):
        for path in sorted((HOUSE / folder).rglob("*")):
            if (
                path.is_file()
                and not {"__pycache__", "node_modules", "target"} & set(path.parts)
                and path.suffix in ("", ".py", ".json", ".md", ".xml")
            ):
                yield path
    yield from PAGES
    yield HOUSE / "pyproject.toml"


def test_the_packages_that_are_imported_are_those_that_are_declared() -> None:
    homes = {**packages_distributions(), **IN_CMEEL}
    imported = {name.split(".")[0] for file in _read().values() for name in file.imported}
    imported -= set(sys.stdlib_module_names) | OPTIONAL | {"guidefield"}
    used = {canonicalize_name(homes[name][0]) for name in imported}
    declared = {canonicalize_name(Requirement(line).name) for line in PROJECT["project"]["dependencies"]}
    assert declared - used == UNIMPORTED
    assert used - declared == COMES_WITH_NUMBA


class SourceFile(NamedTuple):
    """What the rules ask of a file, which is parsed once."""

    described: bool
    imported: list[str]
    vague: list[str]
    silent: list[str]


@cache
def _read() -> dict[Path, SourceFile]:
    return {path: _read_file(path) for path in SOURCES}


def _read_file(path: Path) -> SourceFile:
    tree = ast.parse(path.read_text())
    imported, vague = list[str](), list[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imported += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            imported.append(node.module)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            vague += VAGUE.findall(node.name) if node.name not in FOREIGN_NAMES else []
        elif isinstance(node, ast.Raise) and isinstance(node.exc, ast.Name | ast.Call):
            raised = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
            vague += [raised.id] if isinstance(raised, ast.Name) and raised.id == "NotImplementedError" else []
    silent = [f"{holder}{function.name}" for holder, function in _public_functions(tree) if not _says_shapes(function)]
    return SourceFile(bool(ast.get_docstring(tree)), imported, vague, silent)


def _says_shapes(function: ast.FunctionDef) -> bool:
    annotations = [argument.annotation for argument in (*function.args.args, *function.args.kwonlyargs)]
    kinds = " ".join(ast.unparse(kind) for kind in (*annotations, function.returns) if kind is not None)
    said = (ast.get_docstring(function) or "").replace(f"`{function.name}`", "")
    return not ARRAYS.search(kinds) or bool(SHAPE.search(said) or AS_ANOTHER.search(said))


def test_the_top_level_holds_what_was_agreed() -> None:
    visible = {path.name for path in HOUSE.iterdir() if not path.name.startswith(".")}
    folders = {"service", "robots", "scenes", "tests", "tools"}
    pages = {"README.md", "LICENSE", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "CITATION.cff"}
    pages |= {"pyproject.toml", "setup.py", "pixi.toml"}
    assert folders | pages <= visible
    assert visible - folders - pages <= {"runs", "build", "dist"} | {n for n in visible if n.endswith(".egg-info")}


def test_a_file_says_what_it_holds() -> None:
    assert [_relative(path) for path, file in _read().items() if not file.described] == []


def test_names_say_what_things_are() -> None:
    vague = {"utils", "util", "helpers", "helper", "common", "misc", "manager"}
    assert [_relative(path) for path in SOURCES if path.stem in vague] == []
    assert {_relative(path): file.vague for path, file in _read().items() if file.vague} == {}


def test_a_public_function_says_the_shape_of_its_arrays() -> None:
    assert {_relative(path): file.silent for path, file in _read().items() if file.silent} == {}


def _public_functions(tree: ast.Module) -> Iterator[tuple[str, ast.FunctionDef]]:
    """Public functions and methods of public classes; before each the name of its class."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield "", node
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            for method in node.body:
                if isinstance(method, ast.FunctionDef) and not method.name.startswith("_"):
                    yield f"{node.name}.", method


def test_no_file_speaks_of_somebodys_home() -> None:
    told = {_relative(path): HOME_PATH.findall(path.read_text(errors="replace")) for path in _ours()}
    assert {path: paths for path, paths in told.items() if paths} == {}


def _layers(container: str) -> list[set[str]]:
    """The layers of the import contract for what is in a package, from the top down."""
    declared = tomllib.loads((HOUSE / "service" / "contracts.toml").read_text())
    contracts = declared["tool"]["importlinter"]["contracts"]
    (contract,) = (one for one in contracts if one.get("containers") == [container])
    return [set(re.findall(r"\w+", layer)) for layer in contract["layers"]]


def test_the_picture_of_the_layers_is_that_of_the_contract() -> None:
    page = (HOUSE / "CONTRIBUTING.md").read_text()
    pictured = {
        key: set(re.findall(r"<b>(\w+)</b>", words)) for key, words in re.findall(r"^    (\w+)\[(.*)\]$", page, re.M)
    }
    (order,) = re.findall(r"^    (\w+ -->.*)$", page, re.MULTILINE)
    assert [pictured[key] for key in order.split(" --> ")] == _layers("guidefield")[1:]  # less __main__


@pytest.mark.parametrize("package", ["planner", "collision", "robot", "kernels"])
def test_the_rooms_of_a_package_are_told_in_the_order_of_the_contract(package: str) -> None:
    (row,) = re.findall(rf"^\| `{package}` \| (.*) \|$", (HOUSE / "CONTRIBUTING.md").read_text(), re.MULTILINE)
    rooms = {path.parent.name for path in (PACKAGE / package).glob("*/__init__.py")}
    told = [set(re.findall(r"`(\w+)`", layer)) & rooms for layer in row.split(";")]
    ordered = [layer & rooms for layer in _layers(f"guidefield.{package}")]
    assert [layer for layer in told if layer] == [layer for layer in ordered if layer]
    assert set().union(*told) == rooms


def test_the_arrays_of_values_are_read_only() -> None:
    """What a planner or a certificate hands on nobody changes; named here is what is written by design."""
    written = {"Places", "_TreeMemory"}
    left = []
    for path in SOURCES:
        if not {"planner", "prove"} & set(path.relative_to(PACKAGE).parts):
            continue
        module = import_module(".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts))
        for name, kind in vars(module).items():
            if not (is_dataclass(kind) and isinstance(kind, type) and kind.__module__ == module.__name__):
                continue
            held = [field.type for field in fields(kind) if ARRAYS.search(field.type) and "Callable" not in field.type]
            if held and not issubclass(kind, ReadOnly) and name not in written:
                left.append(f"{_relative(path)}: {name}")
    assert left == []


def test_every_setting_says_what_it_is_and_what_chose_it() -> None:
    for path in (path for path in SOURCES if path.name == "settings.py"):
        lines = ["", *path.read_text().splitlines()]
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef):
                told = (ast.get_docstring(node) or "").partition("Attributes:")[2]
                for part in (part for part in node.body if isinstance(part, ast.AnnAssign)):
                    name, beside = ast.unparse(part.target), lines[part.lineno].partition("# ")[2]
                    above = lines[part.lineno - 1].strip().startswith("# ")
                    assert beside or above or re.search(rf"\b{name}\b.*:", told), (path, name)
                assert "frozen=True" in ast.unparse(node.decorator_list[0])


def test_a_stranger_reads_the_referee_in_ten_minutes() -> None:
    room = PACKAGE / "referee"
    assert len((room / "judge.py").read_text().splitlines()) <= 250
    imported = {name for path in room.glob("*.py") for name in _read()[path].imported}
    foreign = {name for name in imported if name.split(".")[0] not in sys.stdlib_module_names}
    assert {name for name in foreign if not name.startswith("guidefield.referee.")} == {"coal", "numpy", "pinocchio"}


def test_commands_tools_and_links_on_a_page_lead_somewhere() -> None:
    commands = get_command(app).commands
    for page in PAGES:
        text = page.read_text()
        blocks = "\n".join(re.findall(r"```(?:bash|sh|console)\n(.*?)```", text, re.DOTALL))
        for name in re.findall(r"^(?:\$ )?guidefield ([a-z]+)", blocks, re.MULTILINE):
            assert name in commands, (page, name)
        for tool in re.findall(r"(?:tools|\.ci)/[\w/.]+", text):
            assert (HOUSE / tool.rstrip(".")).exists(), (page, tool)
        for target in re.findall(r"\]\((?!https?://|#|mailto:)([^)#]+)", text):
            assert (page.parent / target).exists(), (page, target)


def test_no_text_cites_a_document_that_is_not_here() -> None:
    """A docstring may cite a page, and a section of it: both are in the project."""
    documents = {path.name: path for path in (*HOUSE.glob("*/README.md"), *(HOUSE / "tests").rglob("*.md"), *PAGES)}
    missing = []
    for path in sorted({*SOURCES, *(path for path in _ours() if path.suffix in ("", ".py"))}):
        for name, section in CITATION.findall(path.read_text(errors="replace")):
            document = documents.get(Path(name).name)
            headings = () if document is None else re.findall(r"^#+ (.+)$", document.read_text(), re.MULTILINE)
            if document is None or (section and " ".join(section.split()) not in headings):
                missing.append((_relative(path), name, section))
    assert missing == []


def test_tools_in_python_are_linted_like_the_rest() -> None:
    tools = [path for path in (HOUSE / "tools").iterdir() if path.is_file() and not path.suffix]
    written_in_python = {_relative(path) for path in tools if "python" in path.read_text().partition("\n")[0]}
    assert written_in_python <= set(PROJECT["tool"]["ruff"]["extend-include"])


def test_tools_can_be_run() -> None:
    for tool in ("tools/demo", "tools/test", "tools/environment", ".ci/run"):
        assert (HOUSE / tool).stat().st_mode & 0o111, tool


ROOT = Path(__file__).parents[1]
CONTRIBUTING_PACKAGE = ROOT / "service" / "guidefield"
TEXT = (ROOT / "CONTRIBUTING.md").read_text()
WALKS = TEXT.partition("## Three walks")[2].partition("## Where a change goes")[0]
CHANGES = TEXT.partition("## Where a change goes")[2].partition("\n## ")[0]


def defined(file: str) -> set[str]:
    """Functions and methods of a file."""
    nodes = ast.walk(ast.parse((CONTRIBUTING_PACKAGE / file).read_text()))
    return {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)}


def test_each_stop_of_a_walk_is_a_function_of_its_file() -> None:
    stops = re.findall(r"`([a-z_/]+\.py)` `(\w+)`", WALKS)
    assert len(stops) > 25
    assert [f"{file} {name}" for file, name in stops if name not in defined(file)] == []


def test_walks_and_changes_name_files_that_there_are() -> None:
    files = set(re.findall(r"`([a-z_/]+\.py)`", WALKS + CHANGES))
    assert sorted(file for file in files if not (CONTRIBUTING_PACKAGE / file).is_file()) == []
    assert WALKS.count("\n10. ") == 3


SETUPTOOLS = PROJECT["tool"]["setuptools"]
FOLDERS = {name: HOUSE / folder for name, folder in SETUPTOOLS["package-dir"].items()}


def _folder(package: str) -> Path:
    if package in FOLDERS:
        return FOLDERS[package]
    above, _, last = package.rpartition(".")
    return _folder(above) / last


def test_every_room_is_found() -> None:
    """setup.py finds folders that are packages."""
    holding_code = {path.parent for path in FOLDERS["guidefield"].rglob("*.py")} | set(FOLDERS.values())
    assert [folder for folder in holding_code if not (folder / "__init__.py").exists()] == []


@pytest.mark.parametrize("package", ["guidefield", "guidefield.docs", "guidefield.robots", "guidefield.scenes"])
def test_every_file_that_is_no_code_goes_along(package: str) -> None:
    folder, shipped = _folder(package), SETUPTOOLS["package-data"].items()
    matched = {path for owner, patterns in shipped for pattern in patterns for path in _folder(owner).glob(pattern)}
    data = {path for path in folder.rglob("*") if path.is_file() and path.suffix not in {".py", ".pyc"}}
    assert data
    assert data <= matched


def test_nothing_that_is_shipped_looks_outside_the_package() -> None:
    """`Path(__file__).parents[n]` may not climb out of the package: beside an installed one there is no checkout."""
    for path in FOLDERS["guidefield"].rglob("*.py"):
        depth = len(path.relative_to(FOLDERS["guidefield"]).parts)
        for n in range(depth, depth + 4):
            assert f"parents[{n}]" not in path.read_text(), path
