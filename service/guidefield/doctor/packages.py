"""The distributions: guidefield and its light client share an import package, and exclude one another."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

from guidefield.doctor.finding import Finding, fine, wrong

WHOLE, LIGHT = "guidefield", "guidefield-client"


def packages() -> Finding:
    """Whether one distribution of ours is installed, and not both."""
    return packages_found(_version(WHOLE), _version(LIGHT))


def packages_found(whole: str | None, light: str | None) -> Finding:
    """What is said about the versions of both that are installed; None where one isn't."""
    if whole is not None and light is not None:
        return wrong(
            "packages",
            f"{WHOLE} {whole} and {LIGHT} {light} share their files",
            f"`pip uninstall {LIGHT}`, then `pip install --force-reinstall --no-deps {WHOLE}`",
        )
    return fine("packages", f"{WHOLE} {whole}" if whole is not None else "from a folder, not installed")


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None
