"""Files for systemd, containers and releases: their own tools find nothing wrong, and they agree."""

import json
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from typer.main import get_command

from guidefield.cli import app

HOUSE = Path(__file__).resolve().parents[2]
UNIT = HOUSE / "tools" / "deploy" / "guidefield.service"
CONTAINER = HOUSE / "tools" / "deploy" / "Containerfile"


def _service() -> dict[str, list[str]]:
    """The settings of the unit's section about the service; some may be given more than once."""
    lines = UNIT.read_text().partition("[Service]\n")[2].partition("\n[")[0].splitlines()
    told: dict[str, list[str]] = {}
    for name, value in (line.split("=", 1) for line in lines if "=" in line and not line.startswith("#")):
        told.setdefault(name, []).append(value)
    return told


def _options(words: list[str]) -> dict[str, Any]:
    """What `guidefield serve` makes of some words."""
    assert words[0] == "serve"
    return get_command(app).commands["serve"].make_context("serve", words[1:]).params


def test_the_unit_starts_a_service_with_options_that_there_are() -> None:
    (start,) = _service()["ExecStart"]
    program, *words = shlex.split(start)
    assert program.endswith("/bin/guidefield")
    options = _options(words)
    assert options["data"] == Path("%S/guidefield")
    assert options["metrics"] == 9464


def test_systemd_finds_nothing_wrong(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd isn't here")
    unit = tmp_path / UNIT.name
    unit.write_text(UNIT.read_text().replace("/opt/guidefield/bin/guidefield", sys.executable))
    verified = subprocess.run(["systemd-analyze", "verify", unit], check=False, capture_output=True, text=True)
    assert (verified.returncode, verified.stdout + verified.stderr) == (0, "")
    wrong = tmp_path / "wrong.service"
    wrong.write_text(unit.read_text().replace("Restart=on-failure", "Restart=sometimes"))
    found = subprocess.run(["systemd-analyze", "verify", wrong], check=False, capture_output=True, text=True)
    assert "sometimes" in found.stderr


def test_the_container_file_has_nothing_that_its_linter_finds() -> None:
    linter = shutil.which("hadolint", path=str(Path(sys.executable).parent)) or shutil.which("hadolint")
    if linter is None:
        pytest.skip("hadolint isn't installed: it is in the extra dev")
    done = subprocess.run([linter, "--format", "json", CONTAINER], check=False, capture_output=True, text=True)
    assert json.loads(done.stdout) == []
    assert done.returncode == 0


def _instructions() -> list[tuple[str, str]]:
    text = re.sub(r"\\\n\s*", " ", CONTAINER.read_text())
    lines = [line.split(" ", 1) for line in text.splitlines() if line and not line.startswith("#")]
    return [(word, rest) for word, rest in lines]


def test_the_container_copies_what_the_package_is_made_of() -> None:
    """What setuptools needs: the project's file, what it names, and the folders of its packages."""
    copied = {
        name
        for word, rest in _instructions()
        if word == "COPY" and not rest.startswith("--")
        for name in rest.split()[:-1]
    }
    import tomllib

    project = tomllib.loads((HOUSE / "pyproject.toml").read_text())
    folders = {folder.split("/")[0] for folder in project["tool"]["setuptools"]["package-dir"].values()}
    assert copied == folders | {
        "pyproject.toml",
        "setup.py",
        project["project"]["readme"],
        *project["project"]["license-files"],
    }
    assert all((HOUSE / name).exists() for name in copied)


def test_the_container_starts_a_service_and_asks_for_its_health() -> None:
    told = dict(_instructions())
    (entry,) = json.loads(told["ENTRYPOINT"])
    options = _options(json.loads(told["CMD"]))
    assert entry == "guidefield"
    assert str(options["data"]) in json.loads(told["VOLUME"])
    assert options["listen"] == [f"tcp/0.0.0.0:{told['EXPOSE']}"]
    check = json.loads(told["HEALTHCHECK"].partition("CMD ")[2])
    assert f"http://127.0.0.1:{options['metrics']}/health" in check[-1]
    compile(check[-1], "health", "exec")
    assert told["USER"].isdecimal()


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
