"""Versions of the packages that make a run, as a line of recordings and run logs.

Replays read lines of earlier versions back: the form of a line, `PACKAGE` and `PROCESSOR` stay. Another of `PACKAGES`
may be added.
"""

from __future__ import annotations

import functools
import platform
from importlib.metadata import PackageNotFoundError, version

from guidefield.first_start import processor

PACKAGE = "guidefield"  # the package that plans
PROCESSOR = "processor"  # name of the kind of processor among the versions: another kind may round differently
PACKAGES = (PACKAGE, "pin", "coal", "example-robot-data", "numpy", "numba", "rerun-sdk")
"""The packages whose versions are recorded."""


@functools.cache
def describe_versions() -> str:
    """Return the packages and their versions as one line of a recording."""
    return ", ".join(f"{name} {text}" for name, text in versions().items())


def parse_versions(text: str) -> dict[str, str]:
    """Parse a line of `describe_versions` into versions by package."""
    return dict(package.split(" ", 1) for package in text.split(", ")) if text else {}


def versions() -> dict[str, str]:
    """Return the versions of `PACKAGES` and of Python, and the kind of processor, its family first."""
    found = {"python": platform.python_version(), PROCESSOR: processor()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # run from the source tree
            found[package] = "unknown"
    return found
