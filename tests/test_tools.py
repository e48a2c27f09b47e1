"""Every tool says how it is used and is in the table of CONTRIBUTING; those of several subjects list them."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[1] / "tools"
TABLE = (TOOLS.parent / "CONTRIBUTING.md").read_text().partition("## Run things")[2].partition("\n## ")[0]


def test_each_tool_says_how_it_is_used_and_is_in_the_table() -> None:
    tools = [path for path in TOOLS.iterdir() if path.is_file() and not path.suffix]
    asked = {
        tool.name: subprocess.Popen([tool, "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for tool in tools
    }
    told = {name: process.communicate(timeout=300)[0] for name, process in asked.items()}
    assert [name for name, process in asked.items() if process.returncode] == []
    assert [name for name, said in told.items() if f"usage: tools/{name}" not in said.lower()] == []
    assert [name for name in told if f"`tools/{name}" not in TABLE] == []


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
