"""Every robot of the catalog: how long it takes to load, what it is, and one real plan among obstacles.

Options: [--output FOLDER] [--seconds N] [--planning N] [--memory GB] [name ..]. A line for each robot: time to load in
a fresh process with an empty cache on disk and with a full one, degrees of freedom, pairs of links by the reason for
which they aren't tested, time to find covers, time to cut meshes into convex parts with their trees and that to read
them back (CPU time, but for the time of planning), and a plan from its rest configuration to a random free one among
random boxes: certified, and looked at again by Coal at dense samples. A robot that can't be planned for has its error
instead. Each runs in processes of its own within limits of time and memory, so that none is left out. With --output,
the table is also written there as robots.md and robots.json.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from guidefield.kernels.jit.cache import cache_folder
from guidefield.robot.catalog.catalog import Catalog

BENCH = Path(__file__).resolve().parents[1] / "bench"

COLUMNS = {
    "name": "robot",
    "cold": "cold [s]",
    "cached": "cached [s]",
    "dof": "DoF",
    "planned": "planned",
    "shapes": "shapes",
    "spheres": "spheres",
    "overhang": "overhang [mm]",
    "covering": "covered [s]",
    "preparing": "cut [s]",
    "prepared": "cut, cached [s]",
    "pairs": "pairs",
    "left_out": "left out",
    "status": "plan",
    "planning": "planning [s]",
    "duration": "motion [s]",
    "clearance": "clearance [mm]",
    "dense": "free at dense samples",
}
"""Keys of a line to headings of the table."""

Line = dict[str, Any]


def run(arguments: list[str]) -> None:
    """Measure."""
    parser = argparse.ArgumentParser(prog="tools/bench robots", description=__doc__)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--seconds", type=float, default=300.0, help="limit for each robot")
    parser.add_argument("--planning", type=float, default=30.0, help="allowed planning time")
    parser.add_argument("--memory", type=float, default=6.0, help="limit for each robot [GB]")
    parser.add_argument("--one", action="store_true", help="one robot in this process, its line as JSON")
    parser.add_argument("--load", action="store_true", help="with --one: only load it")
    parser.add_argument("names", nargs="*")
    asked = parser.parse_args(arguments)
    if asked.one:
        from benchmarks.one.robot import measured

        print(json.dumps(measured(asked.names[0], None if asked.load else asked.planning, asked.memory)))
        return
    names = asked.names or Catalog().names()
    lines = []
    print(_heading(), flush=True)
    for name in names:
        try:
            lines.append(_in_process(name, asked))
        except (OSError, ValueError) as error:  # a process that can't be started, or says nothing that can be read
            lines.append({"name": name, "status": "NOT MEASURED", "message": str(error)})
        print(_row(lines[-1]), flush=True)
        if asked.output is not None:
            write(asked.output, lines)
    print(summary(lines))


def write(folder: Path, lines: Sequence[Line]) -> None:
    """Put the table, as far as it is, into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robots.json").write_text(json.dumps(lines, indent=1) + "\n")
    table = "\n".join([_heading(), *map(_row, lines)])
    (folder / "robots.md").write_text(f"{table}\n\n{summary(lines)}\n")


def summary(lines: Sequence[Line]) -> str:
    """How many are planned for, and what becomes of the others."""
    planned = [line for line in lines if line["status"] == "SUCCESS"]
    others = [f"- {line['name']}: {line['status']}: {line['message']}" for line in lines if line not in planned]
    return "\n".join([f"{len(planned)} of {len(lines)} robots: a certified plan", *others])


def _in_process(name: str, asked: argparse.Namespace) -> Line:
    """The line of one robot, in processes of its own: with an empty cache on disk, and then with what that left."""
    command = [sys.executable, str(BENCH), "robots", "--one", name]
    command += ["--planning", str(asked.planning), "--memory", str(asked.memory)]
    with tempfile.TemporaryDirectory(prefix="guidefield-bench-") as cache:
        # the geometry's cache is to be empty, but not the kernels'
        environment = {**os.environ, "XDG_CACHE_HOME": cache, "NUMBA_CACHE_DIR": str(cache_folder().parents[1])}
        line: Line = {"name": name}
        for only in (["--load"], []):
            try:
                done = subprocess.run(
                    [*command, *only],
                    check=False,
                    capture_output=True,
                    text=True,
                    timeout=asked.seconds,
                    env=environment,
                )
            except subprocess.TimeoutExpired:
                return {**line, "status": "TIME LIMIT", "message": f"not done within {asked.seconds:g} s"}
            if done.returncode:
                last = (done.stderr.strip().splitlines() or ["no word"])[-1]
                return {**line, "status": f"ENDED WITH {done.returncode}", "message": last}
            told = json.loads(done.stdout.strip().splitlines()[-1])
            line.update(_renamed(told, only == ["--load"]))
    return line


def _renamed(told: Line, cold: bool) -> Line:
    """What a process says of a robot, with the times of the first one and those of the second told apart."""
    if cold:
        return {("cold" if key == "load" else key): value for key, value in told.items()}
    second = {"load": "cached", "preparing": "prepared"}
    return {second.get(key, key): value for key, value in told.items() if key != "covering"}


def _heading() -> str:
    return f"| {' | '.join(COLUMNS.values())} |\n|{'---|' * len(COLUMNS)}"


def _row(line: Line) -> str:
    return f"| {' | '.join(_cell(line.get(key)) for key in COLUMNS)} |"


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "NO"
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, dict):
        return ", ".join(f"{count} {reason}" for reason, count in value.items())
    return str(value)
