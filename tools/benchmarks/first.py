"""The time from the start of Python to the first answer about a robot, with nothing about it on disk.

Usage: tools/bench first [FOLDER ..] [--robots NAME ..] [--seconds N] [--dense N] [--profile] [--output FILE]

Robots are all of the catalog's that URDFs of example-robot-data describe, those that --robots names, or all URDF files
of folders. Each is answered in a process of its own, with an empty cache of geometry and with the compiled kernels of
the user's cache: a plan from rest to a random free configuration in an empty scene. The goal is chosen before, in
another process, which leaves Python's bytecode behind as an installation does. Times are of the processor, all threads
together, from the start of Python on, and on the clock; the latter mean something on an idle machine only. Both are
also given for a machine that takes Pinocchio's forward kinematics of a Panda 0.33 us. With --dense each triangle of the
meshes is split into N, a power of four. With --profile the slowest functions are printed. With --output the lines are
also written as JSON.
"""

from __future__ import annotations

import argparse
import json
import os
import pstats
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.connect_peers import kinematics_us
from guidefield.kernels.jit.cache import cache_folder
from guidefield.robot.catalog import Catalog

TOOLS = Path(__file__).resolve().parents[1]

README_KINEMATICS = 0.33
"""What one forward kinematics of a Panda takes the machine that goals are about [us]."""

_SCRIPT = f"import sys; sys.path.insert(0, {str(TOOLS)!r}); from benchmarks.one.first import main; main(sys.argv[1])"

Line = dict[str, Any]


def run(arguments: list[str]) -> None:
    """Print a line for each robot."""
    parser = argparse.ArgumentParser(prog="tools/bench first", description=__doc__.partition("\n")[0])
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--robots", nargs="*", default=[], help="names of the catalog")
    parser.add_argument("--seconds", type=float, default=600.0, help="limit for each robot")
    parser.add_argument("--dense", type=int, default=1, help="triangles for each of a mesh: 1, 4, 16, ..")
    parser.add_argument("--profile", action="store_true", help="print the slowest functions")
    parser.add_argument("--output", type=Path)
    asked = parser.parse_args(arguments)
    scale = README_KINEMATICS / _panda_kinematics()
    print(f"Pinocchio's forward kinematics of a Panda: {README_KINEMATICS / scale:.2f} us; scaled by {scale:.2f}")
    print("| robot | answer | CPU [s] | scaled | clock [s] | scaled | planning [s] | memory [GB] |\n|" + "---|" * 8)
    lines = []
    names = asked.robots or ([] if asked.folders else _catalog_names())
    robots: list[tuple[str, str | dict[str, Any]]] = [(name, name) for name in names]
    for folder in asked.folders:
        robots += [(str(file.relative_to(folder)), _of_file(file, folder)) for file in _files(folder)]
    for name, robot in robots:
        with tempfile.TemporaryDirectory(prefix="guidefield-bench-") as scratch:
            line = {"name": name, "scale": scale, **_measured(robot, asked, Path(scratch))}
        lines.append(line)
        print(_row(line), flush=True)
        if asked.output is not None:
            asked.output.write_text(json.dumps(lines, indent=1) + "\n")
    print(_summary(lines))


def _files(folder: Path) -> list[Path]:
    """The URDF files of a folder; the folder may be one itself."""
    return [folder] if folder.is_file() else sorted(folder.rglob("*.urdf"))


def _of_file(file: Path, folder: Path) -> dict[str, Any]:
    """A URDF file as a request names it: every folder above it may hold packages."""
    above = [parent for parent in file.resolve().parents if parent.is_relative_to(folder.resolve())]
    return {"type": "urdf_file", "path": str(file.resolve()), "package_dirs": [str(parent) for parent in above]}


def _catalog_names() -> list[str]:
    """The robots of the catalog but the chains, which are made of primitives alone."""
    return [name for name in Catalog().names() if not name.startswith("chain_")]


def _panda_kinematics() -> float:
    """What one forward kinematics of a Panda takes Pinocchio here [us]."""
    import pinocchio as pin

    from guidefield.robot.group.reduced_model import select

    robot = Catalog().load("panda")
    return kinematics_us(select(robot, None, None, robot.rest, pin.SE3.Identity()))


def _measured(robot: str | dict[str, Any], asked: argparse.Namespace, scratch: Path) -> Line:
    """The line of one robot."""
    if asked.dense > 1:
        from benchmarks.one.dense import write_dense_copy

        robot = write_dense_copy(robot, asked.dense, scratch / "robot")
    try:
        request = _in_process({"choose": robot}, dict(os.environ), asked.seconds)
        alone = {"XDG_CACHE_HOME": str(scratch), "NUMBA_CACHE_DIR": str(cache_folder().parents[1])}
        profile = scratch / "profile"
        question = {"answer": request, "profile": str(profile) if asked.profile else None}
        line = _in_process(question, {**os.environ, **alone}, asked.seconds)
    except subprocess.TimeoutExpired:
        return {"status": "TIME LIMIT", "message": f"not done within {asked.seconds:g} s"}
    except RuntimeError as error:
        return {"status": "FAILED", "message": str(error)}
    if asked.profile:
        pstats.Stats(str(profile)).sort_stats("cumulative").print_stats(60)
    return line


def _in_process(question: dict[str, Any], environment: dict[str, str], seconds: float) -> dict[str, Any]:
    """What a process of its own answers.

    Raises:
        RuntimeError: if it fails; its last words.
        subprocess.TimeoutExpired: if it takes longer.
    """
    done = subprocess.run(
        [sys.executable, "-c", _SCRIPT, json.dumps(question)],
        check=False,
        capture_output=True,
        text=True,
        timeout=seconds,
        env={name: value for name, value in environment.items() if name != "PYTHONDONTWRITEBYTECODE"},
    )
    if done.returncode:
        raise RuntimeError((done.stderr.strip().splitlines() or ["no word"])[-1])
    told: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return told


def _row(line: Line) -> str:
    if "cpu" not in line:
        return f"| {line['name']} | {line['status']}: {line['message']} | | | | | | |"
    scale = line["scale"]
    times = [line["cpu"], scale * line["cpu"], line["clock"], scale * line["clock"], line["planning"], line["memory"]]
    cells = ["" if value is None else f"{value:.2f}" for value in times]
    return f"| {' | '.join([line['name'], line['status'], *cells])} |"


def _summary(lines: list[Line]) -> str:
    """How long the first answers take all together."""
    times = sorted(line["scale"] * line["cpu"] for line in lines if "cpu" in line)
    if not times:
        return "nothing was measured"
    at = [times[int(share * (len(times) - 1))] for share in (0.5, 0.9, 1.0)]
    told = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in zip(("median", "90 %", "largest"), at, strict=True))
    return f"{len(times)} of {len(lines)} robots answered; CPU time, scaled: {told}"
