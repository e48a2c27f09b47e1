"""Have a tool run in the project's own environment, where it can import from `tests` and `tools` too.

Imported first by the tools without an ending: whichever Python starts one, `.venv` runs it, which is made if it
isn't there.
"""

from __future__ import annotations

import ast
import importlib
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"

if Path(sys.prefix).resolve() != VENV.resolve():
    if not (VENV / "bin" / "python").exists():
        subprocess.run([ROOT / "tools" / "environment"], check=True, stdout=subprocess.DEVNULL)
    os.execv(VENV / "bin" / "python", [str(VENV / "bin" / "python"), *sys.argv])  # noqa: S606 - no shell is wanted
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]


def list_subjects(folder: str) -> dict[str, str]:
    """List the modules of a folder that have a function `run`, with the first line of what each does."""
    subjects = {}
    for path in sorted((ROOT / "tools" / folder).glob("*.py")):
        module = ast.parse(path.read_text())
        if any(isinstance(one, ast.FunctionDef) and one.name == "run" for one in module.body):
            subjects[path.stem] = (ast.get_docstring(module) or "").partition("\n")[0]
    return subjects


def run_subject(folder: str, usage: str | None) -> int:
    """Run the subject that the first argument names, and return its exit code; else list all of them."""
    subjects = list_subjects(folder)
    if len(sys.argv) < 2 or sys.argv[1] not in subjects:
        print(usage, *(f"{name:14s}{what}" for name, what in subjects.items()), sep="\n")
        return 0 if sys.argv[1:2] in (["-h"], ["--help"]) else 2
    module = importlib.import_module(f"{folder}.{sys.argv[1]}")
    sys.argv[0] = " ".join(sys.argv[:2])  # as its own usage names it
    return module.run(sys.argv[2:]) or 0
