"""`tools/slice` and `tools/arm`: what they name is there, and packages are chosen by the machine that they are for."""

import ast
import platform
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

HOUSE = Path(__file__).parents[1]
TOOLS = HOUSE / "tools"
SLICE = (TOOLS / "slice").read_text()


def _wheels(machine: str, python: str) -> dict[str, str]:
    command = [sys.executable, str(TOOLS / "emulated" / "wheels.py"), machine, python]
    told = subprocess.run(command, check=True, capture_output=True, text=True, timeout=600).stdout
    return dict(line.split("==") for line in told.splitlines())


@pytest.mark.parametrize("named", re.findall(r"tests/\S+\.py\S*", SLICE))
def test_tests_that_are_named_exist(named: str) -> None:
    file, _, test = named.partition("::")
    functions = [node.name for node in ast.parse((HOUSE / file).read_text()).body if isinstance(node, ast.FunctionDef)]
    assert not test or test in functions


def test_wheels_are_those_that_the_other_machine_needs() -> None:
    """Of these packages, yourdfpy's optional ones are not for every processor."""
    there = _wheels("aarch64", "3.11")
    assert {"numba", "pin", "coal", "libcoal", "numpy", "pytest", "execnet"} <= set(there)
    assert there["numba"] == version("numba")
    assert not {"embreex", "mypy"} & set(there), "it has no embreex, and the slice needs no linters"
    if platform.machine() == "x86_64":
        assert "embreex" in _wheels("x86_64", "3.11")
