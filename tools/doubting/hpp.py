"""Another house's judge: the continuous validation of HPP, from PyPI, in an environment and a process of its own.

It knows neither clearances nor limits, and only what rests. A contact that it finds is at a configuration, so it
counts. That it finds none counts for a robot against obstacles: its bound on two links that both move has the wrong
one's radius in 9.0.2. It may end with a fault of the process, so nothing of it is imported here.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from guidefield import case_file
from guidefield.engine import motions_of
from guidefield.messages.requests import CertifyRequest

HERE = Path(__file__).resolve().parent
VENV = HERE.parents[1] / ".venv-hpp"
WANTED = "hpp-python>=9,<10"


@dataclass(frozen=True)
class Heard:
    """HPP's answer about a motion.

    Attributes:
        answer: "contact", "free", "grazes" where nothing is deeper than 2 um, or "not judged".
        pair: The bodies that touch; empty without any.
        at: When [s]; along a path, how many segments in.
        seconds: CPU time of the validation [s].
        reason: Why it isn't judged.
    """

    answer: str
    pair: tuple[str, ...] = ()
    at: float = 0.0
    seconds: float = 0.0
    reason: str = ""


def is_installed() -> bool:
    """Return whether its environment is there."""
    return _libraries() is not None


def install() -> str:
    """Make its environment, 1.2 GB; why that isn't possible, in a sentence, or nothing."""
    if is_installed():
        return ""
    steps = [sys.executable, "-m", "venv", "--clear", VENV], [VENV / "bin" / "pip", "install", "--quiet", WANTED]
    for step in steps:
        try:
            done = subprocess.run([str(one) for one in step], capture_output=True, text=True, check=False)
        except OSError as error:
            return f"{WANTED} can't be installed: {error}"
        if done.returncode:
            return f"{WANTED} can't be installed: {(done.stderr.strip().splitlines() or ['no reason is told'])[-1]}"
    return "" if is_installed() else f"{WANTED} has no libraries where they are expected"


def case(request: CertifyRequest) -> dict[str, Any]:
    """The motion of a request as the referee's file has it."""
    return json.loads(json.dumps(case_file.make_cases(*motions_of(request))))[0]


def ask(cases: list[dict[str, Any]], seconds: float) -> list[Heard]:
    """Ask about cases as a referee's file has them.

    Args:
        cases: The cases; one that ends the process isn't judged, and the others are asked again.
        seconds: How long a process may take.
    """
    found: list[Heard] = []
    while len(found) < len(cases):
        lines, fault = _asked(cases[len(found) :], seconds)
        found += [Heard(**json.loads(line)) for line in lines]
        if len(found) < len(cases):
            found.append(Heard("not judged", reason=fault))
    return found


def _asked(cases: list[dict[str, Any]], seconds: float) -> tuple[list[str], str]:
    """Ask a process about cases; return a line for each, and its last words or how it ended."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "cases.json")
        file.write_text(json.dumps({"format": case_file.FORMAT, "cases": cases}))
        command = [str(VENV / "bin" / "python"), str(HERE / "hpp_validation.py"), str(file)]
        environment = {**os.environ, "LD_LIBRARY_PATH": str(_libraries())}
        try:
            done = subprocess.run(
                command, env=environment, capture_output=True, text=True, check=False, timeout=seconds
            )
            said, fault = done.stdout, (done.stderr.strip().splitlines() or [f"it ended with {done.returncode}"])[-1]
        except subprocess.TimeoutExpired as late:
            said, fault = (late.stdout or b"").decode(), "time was up"
    return [line for line in said.splitlines() if line.startswith("{")], fault


def _libraries() -> Path | None:
    """Return where its libraries are, if it is installed."""
    return next(VENV.glob("lib/python3*/site-packages/cmeel.prefix/lib"), None)
