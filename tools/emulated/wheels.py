"""The packages that guidefield and its slice of tests need on another machine, in the versions that are here.

Usage: python tools/emulated/wheels.py MACHINE VERSION

MACHINE is what `platform.machine()` says there, VERSION is Python's there. pip can fetch wheels for another machine,
but decides by this one which packages are needed that not every machine needs; here the other one decides.
"""

import re
import sys
import tomllib
from importlib.metadata import distribution
from pathlib import Path

from packaging.requirements import Requirement

PROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"

OF_TESTS = ("hypothesis", "networkx", "pytest", "pytest-xdist", "rtree", "scipy")
"""Packages of the tests that the slice needs."""


def main() -> None:
    machine, python = sys.argv[1:]
    project = tomllib.loads(PROJECT.read_text())["project"]
    of_tests = map(Requirement, project["optional-dependencies"]["dev"])
    needed = [*map(Requirement, project["dependencies"]), *(one for one in of_tests if one.name in OF_TESTS)]
    there = {"platform_machine": machine, "python_version": python, "python_full_version": f"{python}.0"}
    for name, version in sorted(_with_theirs(needed, there).items()):
        print(f"{name}=={version}")


def _with_theirs(needed: list[Requirement], there: dict[str, str]) -> dict[str, str]:
    """The version of each package that is needed, itself or by others."""
    found: dict[str, str] = {}
    seen, waiting = set[tuple[str, frozenset[str]]](), list(needed)
    while waiting:
        one = waiting.pop()
        name = re.sub(r"[-_.]+", "-", one.name).lower()
        if (name, frozenset(one.extras)) in seen:
            continue
        seen.add((name, frozenset(one.extras)))
        here = distribution(one.name)
        found[name] = here.version
        for told in here.requires or ():
            other = Requirement(told)
            wanted = [{**there, "extra": extra} for extra in one.extras or {""}]
            if other.marker is None or any(other.marker.evaluate(each) for each in wanted):
                waiting.append(other)
    return found


if __name__ == "__main__":
    main()
