"""The tools that have several subjects list them, and refuse others."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[1] / "tools"


@pytest.mark.parametrize(("tool", "folder"), [("attack", "attacks"), ("bench", "benchmarks")])
def test_a_tool_lists_what_it_can_be_asked_with_a_line_on_each(tool: str, folder: str) -> None:
    done = subprocess.run(
        [sys.executable, str(TOOLS / tool), "nothing"], capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 2
    told = dict(line.split(maxsplit=1) for line in done.stdout.partition("\n\n")[2].splitlines()[4:] if line)
    subjects = {path.stem for path in (TOOLS / folder).glob("*.py") if "\ndef run(arguments" in path.read_text()}
    assert set(told) == subjects
    assert all(
        told[name] == ast.get_docstring(ast.parse((TOOLS / folder / f"{name}.py").read_text())).partition("\n")[0]
        for name in told
    )
