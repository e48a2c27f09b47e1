"""The narrow front door: every name is there, and coming in costs nothing heavy."""

import subprocess
import sys

import pytest

import guidefield

HEAVY = ("pinocchio", "coal", "numba", "rerun", "numpy", "trimesh", "scipy", "matplotlib")


@pytest.mark.parametrize("name", guidefield.__all__)
def test_every_public_name_resolves(name: str) -> None:
    assert getattr(guidefield, name) is not None
    assert name in dir(guidefield)


def test_the_names_are_distinct_and_others_are_refused() -> None:
    assert len(set(guidefield.__all__)) == len(guidefield.__all__)
    with pytest.raises(AttributeError, match="no attribute 'compute_everything'"):
        guidefield.compute_everything  # noqa: B018


def test_every_exception_of_the_wire_is_public() -> None:
    from guidefield.errors import ERRORS

    assert {kind.__name__ for kind in ERRORS.values()} <= set(guidefield.__all__)


def _loaded(statement: str) -> set[str]:
    """Heavy packages that a fresh process has loaded after a statement."""
    script = f"import sys\n{statement}\nprint(*[name for name in {HEAVY!r} if name in sys.modules])"
    return set(
        subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True).stdout.split()
    )


@pytest.mark.parametrize(
    "statement",
    [
        "import guidefield",
        "import guidefield.client",
        "from guidefield import Client, PlanRequest, PoseGoal, Scene, Box, RobotInvalid",
        "import guidefield.endpoint.service",
        "import guidefield.cli",
        "from guidefield.engine import Engine; Engine().answer({'type': 'scenes'})",
    ],
)
def test_a_light_import_loads_nothing_heavy(statement: str) -> None:
    assert _loaded(statement) == set()
