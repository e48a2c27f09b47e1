"""Trials of many robots, each in a process of its own, as a table and as JSON."""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from guidefield.kernels.jit.cache import cache_folder
from guidefield.robot.catalog import Catalog

HOUSE = Path(__file__).resolve().parents[2]
SUFFIXES = (".urdf", ".xacro", ".xml")
ROOT = re.compile(rb"<\s*([A-Za-z][\w:.-]*)")
"""The first element of an XML file; comments and declarations begin otherwise."""
MOST_WORDS = 160
"""Characters of a message in the table."""

BROKEN = ("traceback", "false certificate")
"""Kinds of result that are bugs."""
KINDS = (*BROKEN, "contradiction", "time limit", "refused", "no free goal", "not planned", "planned", "no robot")
"""Kinds of result, worst first; a robot's is the worst of its plans'."""
COLUMNS = {
    "robot": "robot",
    "kind": "result",
    "dof": "DoF",
    "load_cpu": "load, CPU [s]",
    "first_cpu": "first answer, CPU [s]",
    "first_wall": "wall [s]",
    "second_cpu": "second answer, CPU [s]",
    "message": "message",
}

Line = dict[str, Any]


def main(arguments: Sequence[str], usage: str) -> int:
    """Try all robots that the arguments name."""
    parser = argparse.ArgumentParser(
        prog="tools/robots", description=usage, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?", help="folder of robots")
    parser.add_argument("--catalog", action="store_true", help="the robots that come with guidefield, instead")
    parser.add_argument("--output", type=Path, default=HOUSE / "build" / "robots.json", metavar="FILE")
    parser.add_argument("--seconds", type=float, default=120.0, help="limit for each robot")
    parser.add_argument("--allowed", type=float, default=5.0, metavar="SECONDS", help="planning time of each plan")
    parser.add_argument("--workers", type=int, default=1, help="robots at the same time")
    parser.add_argument("--seed", type=int, default=0, help="of the goals")
    parser.add_argument("--only", default="", metavar="TEXT", help="robots with this text in their path")
    parsed = parser.parse_args(arguments)
    if (parsed.folder is None) != parsed.catalog:
        parser.error("give either FOLDER or --catalog")
    folder = None if parsed.catalog else parsed.folder.resolve()
    named = Catalog().names() if folder is None else [str(f.relative_to(folder)) for f in robot_files(folder)]
    robots = [robot for robot in named if parsed.only in robot]
    lines = []
    print(heading(), flush=True)
    for line in run(robots, folder, parsed.seconds, parsed.workers, parsed.seed, parsed.allowed):
        lines.append(line)
        print(row(line), flush=True)
        parsed.output.parent.mkdir(parents=True, exist_ok=True)
        parsed.output.write_text(json.dumps(lines, indent=1) + "\n")
    print("\n" + summary(lines))
    return int(any(line["kind"] in BROKEN for line in lines))


def robot_files(folder: Path) -> list[Path]:
    """Files of a folder, at any depth, that describe a robot."""
    return [file for file in sorted(folder.rglob("*")) if file.suffix.lower() in SUFFIXES and _is_robot(file)]


def _is_robot(file: Path) -> bool:
    if not file.is_file():
        return False
    if file.suffix.lower() == ".urdf":
        return True
    found = ROOT.search(re.sub(rb"<!--.*?-->", b"", file.read_bytes(), flags=re.DOTALL))
    wanted = b"mujoco" if file.suffix.lower() == ".xml" else b"robot"
    return found is not None and found.group(1) == wanted


def run(
    robots: Sequence[str], folder: Path | None, seconds: float, workers: int, seed: int, allowed: float = 5.0
) -> Iterator[Line]:
    """Yield the line of each robot, in their order.

    Args:
        robots: Paths in the folder, or names of the catalog.
        folder: The folder; None: the catalog.
        seconds: Time limit of each.
        workers: Robots at the same time.
        seed: Of the goals.
        allowed: Planning time of each plan [s].
    """
    with ThreadPoolExecutor(max(1, workers)) as pool:
        yield from pool.map(lambda robot: _try_one(robot, folder, seconds, seed, allowed), robots)


def _try_one(robot: str, folder: Path | None, seconds: float, seed: int, allowed: float) -> Line:
    with tempfile.TemporaryDirectory(prefix="guidefield-robots-") as scratch:
        # the cache of geometry is empty, that of kernels is not
        environment = {**os.environ, "XDG_CACHE_HOME": scratch, "NUMBA_CACHE_DIR": str(cache_folder().parents[1])}
        environment["PYTHONPATH"] = os.pathsep.join([str(HOUSE), str(HOUSE / "tools")])
        written = Path(scratch) / "line.json"
        named = robot if folder is None else str(folder / robot)
        command = [sys.executable, "-m", "robot_trials.trial", named, "catalog" if folder is None else "file"]
        command += [str(seed), str(allowed), str(written)]
        end = ""
        try:
            done = subprocess.run(
                command,
                check=False,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                timeout=seconds,
                env=environment,
            )
            if done.returncode:
                words = done.stderr.decode(errors="replace").strip().splitlines()
                end = f"ended with {done.returncode}: {words[-1] if words else 'no word'}"
        except subprocess.TimeoutExpired:
            end = f"not done within {seconds:g} s"
        line: Line = json.loads(written.read_text()) if written.is_file() else {"plans": []}
    line = {"robot": robot, **line}
    if end:
        kind = "time limit" if end.startswith("not done") else "traceback"
        line["plans"].append({"kind": kind, "message": end})
    return {**line, **_overall(line)}


def _overall(line: Line) -> Line:
    """The worst result of a robot's plans, and the times of its answers."""
    plans = line["plans"] or [{"kind": "traceback", "message": "nothing came of it"}]
    worst = min(plans, key=lambda plan: KINDS.index(plan["kind"]))
    found: Line = {"kind": worst["kind"], "message": worst.get("message", "")}
    answered = [plan for plan in plans if "cpu" in plan]
    if "load_cpu" in line and answered:
        found["first_cpu"] = line["load_cpu"] + answered[0]["cpu"]
        found["first_wall"] = line["load_wall"] + answered[0]["wall"]
    if len(answered) > 1:
        found["second_cpu"], found["second_wall"] = answered[1]["cpu"], answered[1]["wall"]
    return found


def heading() -> str:
    """The head of the table."""
    return f"| {' | '.join(COLUMNS.values())} |\n|{'---|' * len(COLUMNS)}"


def row(line: Line) -> str:
    """One robot in the table."""
    return f"| {' | '.join(_cell(line.get(key)) for key in COLUMNS)} |"


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.2f}"
    return "" if value is None else " ".join(str(value).split())[:MOST_WORDS].replace("|", "/")


def summary(lines: Sequence[Line]) -> str:
    """Counts of each kind of result, and the spread of the first answer's time."""
    kinds = Counter(line["kind"] for line in lines)
    told = [f"{len(lines)} robots: " + ", ".join(f"{kinds[kind]} {kind}" for kind in KINDS if kinds[kind])]
    times = sorted(line["first_cpu"] for line in lines if line["kind"] == "planned")
    if times:
        middle, most = (times[min(int(share * len(times)), len(times) - 1)] for share in (0.5, 0.9))
        told.append(
            f"first answers of those, CPU time [s]: median {middle:.1f}, 90 % {most:.1f}, largest {times[-1]:.1f}"
        )
    return "\n".join(told)
