"""The wheel holds what the checkout has: every room, every robot and scene, and nothing that is found beside them."""

import tomllib
from pathlib import Path

import pytest

HOUSE = Path(__file__).parents[1]
SETUPTOOLS = tomllib.loads((HOUSE / "pyproject.toml").read_text())["tool"]["setuptools"]
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
