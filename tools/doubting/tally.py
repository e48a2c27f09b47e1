"""Counts of units of work, one line of JSON for each: runs that go on add up."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HOUSE = Path(__file__).resolve().parents[2]
FILE = "units.jsonl"
GROUPS = (
    *("aligned", "robot", "joint", "obstacle", "plan", "status", "mutant"),
    *("verdict", "near", "left out", "referee", "proof", "hpp"),
)
"""Of counts that are told with their parts."""


@dataclass(frozen=True)
class Unit:
    """One unit of work that is done.

    Attributes:
        seed: Its own.
        seconds: How long it took [s].
        counts: What was done how often.
        found: Files of disagreements.
        commit: Of the code that did it; with "+" where that was changed.
    """

    seed: int
    seconds: float
    counts: dict[str, int]
    found: list[str]
    commit: str


def append(folder: Path, unit: Unit) -> None:
    """Add a unit: one write of one line, which is there whole or not at all."""
    line = json.dumps({**unit.__dict__}, sort_keys=True) + "\n"
    with (folder / FILE).open("ab+", buffering=0) as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        if end := file.seek(0, os.SEEK_END):
            file.seek(end - 1)
            line = line if file.read() == b"\n" else "\n" + line
        file.write(line.encode())


def units(folder: Path) -> list[Unit]:
    """All that are kept; a last line that isn't whole is none."""
    file, found = folder / FILE, []
    for line in file.read_text().splitlines() if file.exists() else []:
        try:
            plain: dict[str, Any] = json.loads(line)
        except ValueError:
            continue
        found.append(Unit(**plain))
    return found


def commit() -> str:
    """The commit of this checkout, with "+" if it is changed."""
    command = ["git", "describe", "--always", "--dirty=+"]
    said = subprocess.run(command, cwd=HOUSE, capture_output=True, text=True, check=False)
    return said.stdout.strip() or "unknown"


def format_totals(folder: Path) -> str:
    """The totals, for a person."""
    kept = units(folder)
    counts: Counter[str] = Counter()
    for unit in kept:
        counts.update(unit.counts)
    seconds = sum(unit.seconds for unit in kept)
    lines = [
        f"{len(kept)} units, {seconds / 3600:.2f} hours of work, commits {', '.join(sorted({u.commit for u in kept}))}",
        f"plans: {counts['plans']}, with a motion that was sampled: {counts['plans sampled']}",
        f"mutants: {counts['mutants']}, certified {counts['mutants certified']}, refused {counts['mutants refused']},"
        f" undecided {counts['mutants undecided']}",
        f"by the referee: {counts['referee plans']} plans, {counts['referee mutants']} mutants;"
        f" undecided {counts['referee undecided']}, not judged {counts['referee not judged']}",
        f"disagreements: {counts['disagreements']}",
    ]
    for group in GROUPS:
        rows = {key.partition(":")[2]: count for key, count in counts.items() if key.startswith(f"{group}:")}
        if rows:
            lines.append(f"{group}: " + ", ".join(f"{key} {rows[key]}" for key in sorted(rows, key=lambda k: -rows[k])))
    lines += [f"  {file}" for unit in kept for file in unit.found]
    return "\n".join(lines)
