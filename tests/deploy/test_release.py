"""The files of a release agree with pyproject.toml, and with one another."""

import re
import tomllib
from pathlib import Path
from typing import Any

import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

HOUSE = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((HOUSE / "pyproject.toml").read_text())["project"]
CONDA_NAMES = {"pin": "pinocchio", "mapbox-earcut": "mapbox_earcut", "xxhash": "python-xxhash"}
"""Packages that conda-forge has by other names than PyPI."""


def _read(name: str) -> Any:
    return yaml.safe_load((HOUSE / name).read_text())


def _needed() -> dict[str, SpecifierSet]:
    needed = map(Requirement, PROJECT["dependencies"])
    return {CONDA_NAMES.get(one.name, one.name): one.specifier for one in needed}


def test_the_environment_of_conda_has_what_the_package_needs() -> None:
    environment = tomllib.loads((HOUSE / "pixi.toml").read_text())
    declared = environment["dependencies"] | environment["pypi-dependencies"]
    own = {name: SpecifierSet(declared.pop(name).replace("*", "")) for name in ("python", "pip", "setuptools")}
    assert own["python"].contains("3.11")
    assert {name: SpecifierSet(text) for name, text in declared.items()} == _needed()


def test_the_recipe_has_what_the_package_needs() -> None:
    recipe = _read("tools/deploy/recipe.yaml")
    lines = [line.partition(" ") for line in recipe["requirements"]["run"] if line != "__unix"]
    declared = {name: SpecifierSet(text) for name, _, text in lines}
    assert declared.pop("python") == SpecifierSet(PROJECT["requires-python"])
    assert declared == _needed()
    assert recipe["build"]["python"]["entry_points"] == [f"guidefield = {PROJECT['scripts']['guidefield']}"]


def test_one_version_stands_everywhere() -> None:
    told = {_read("CITATION.cff")["version"], _read("tools/deploy/recipe.yaml")["context"]["version"]}
    told.add(re.findall(r"^## (\S+)", (HOUSE / "CHANGELOG.md").read_text(), re.MULTILINE)[0])
    assert told == {PROJECT["version"]}
