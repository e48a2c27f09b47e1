"""The walks through the code stop where there is something, and changes go to files that there are."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "service" / "guidefield"
TEXT = (ROOT / "CONTRIBUTING.md").read_text()
WALKS = TEXT.partition("## Three walks")[2].partition("## Where a change goes")[0]
CHANGES = TEXT.partition("## Where a change goes")[2].partition("\n## ")[0]


def defined(file: str) -> set[str]:
    """Functions and methods of a file."""
    nodes = ast.walk(ast.parse((PACKAGE / file).read_text()))
    return {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)}


def test_each_stop_of_a_walk_is_a_function_of_its_file() -> None:
    stops = re.findall(r"`([a-z_/]+\.py)` `(\w+)`", WALKS)
    assert len(stops) > 25
    assert [f"{file} {name}" for file, name in stops if name not in defined(file)] == []


def test_walks_and_changes_name_files_that_there_are() -> None:
    files = set(re.findall(r"`([a-z_/]+\.py)`", WALKS + CHANGES))
    assert sorted(file for file in files if not (PACKAGE / file).is_file()) == []
    assert WALKS.count("\n10. ") == 3
