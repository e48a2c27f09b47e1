"""Stage the light client as a project of its own in a folder, from which pip builds its wheel.

Usage: python tools/light/stage.py FOLDER

Which rooms it holds, its name and what it needs stand in `pyproject.toml` below `[tool.guidefield.client]`. Version,
license and the versions of what it needs are those of guidefield itself: they are told once.
"""

from __future__ import annotations

import json
import shutil
import sys
import tomllib
from pathlib import Path
from typing import Any

HOUSE = Path(__file__).resolve().parents[2]
PACKAGE = HOUSE / "service" / "guidefield"
PROJECT = tomllib.loads((HOUSE / "pyproject.toml").read_text())
CLIENT = PROJECT["tool"]["guidefield"]["client"]
MARK = "light_client.txt"
"""The file that only the light client has; it holds its version."""


def stage(folder: Path) -> None:
    """Write the project.

    Args:
        folder: Where; must be empty, or not be there.
    """
    package = folder / "guidefield"
    package.mkdir(parents=True)
    for name in CLIENT["rooms"]:
        source = PACKAGE / name
        if source.is_dir():
            shutil.copytree(source, package / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copyfile(source, package / name)
    (package / MARK).write_text(PROJECT["project"]["version"] + "\n")
    shutil.copyfile(HOUSE / "LICENSE", folder / "LICENSE")
    shutil.copyfile(HOUSE / CLIENT["readme"], folder / "README.md")
    (folder / "pyproject.toml").write_text(describe())


def describe() -> str:
    """The `pyproject.toml` of the light client."""
    whole = PROJECT["project"]
    project: dict[str, Any] = {
        "name": CLIENT["name"],
        "version": whole["version"],
        "description": CLIENT["description"],
        "readme": "README.md",
        "requires-python": whole["requires-python"],
        "license": whole["license"],
        "license-files": ["LICENSE"],
        "keywords": whole["keywords"],
        "classifiers": whole["classifiers"],
        "dependencies": [line for line in whole["dependencies"] if _name(line) in CLIENT["needs"]],
    }
    packages = ["guidefield", *(f"guidefield.{name}" for name in CLIENT["rooms"] if (PACKAGE / name).is_dir())]
    tables = {
        "build-system": PROJECT["build-system"],
        "project": project,
        "tool.setuptools": {"packages": packages},
        "tool.setuptools.package-data": {"guidefield": ["py.typed", MARK]},
    }
    return "\n".join(
        f"[{title}]\n" + "".join(f"{key} = {json.dumps(value, ensure_ascii=False)}\n" for key, value in table.items())
        for title, table in tables.items()
    )


def _name(requirement: str) -> str:
    return requirement.split(">", maxsplit=1)[0].split("<", maxsplit=1)[0].split("=", maxsplit=1)[0].strip()


if __name__ == "__main__":
    stage(Path(sys.argv[1]))
