"""How good whole plans are: certified, truly free, how far from everything, how long, how smooth, and their times.

Usage: tools/bench quality <folder> [--robots panda,ur5,fetch,baxter] [--every N] [--peers] [--worst N]

The folder is described in problems.py. Every trajectory is judged on the exact collision geometry, whoever made it:
the smallest distances are exact along it, whether it hits is sampled `JUDGED_STEP` apart. *inner* leaves out
`END_LENGTH` at each end; *at the ends* is the share of problems whose minimum over the whole motion is the
ends' own, less a millimetre; length is a multiple of VAMP's simplified path, from its rows in the folder. Times are
CPU times of one thread, the best of `REPEATS` [ms]; *whole* is connect to certify, the world, its tables and the checks
of the ends apart: those stand under *ends* and *load*.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import peers
from benchmarks.problems import ROBOTS, Problems, posed, scene_of
from guidefield.collision.clearance import clearance_at
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.errors import Status
from guidefield.planner.motion.waypoints import polyline
from guidefield.planner.plan import Plan, plan
from guidefield.planner.quality import END_LENGTH, measure_figures
from guidefield.planner.task.problem import ConfigurationGoal, Problem
from guidefield.planner.task.trace import Event, StageEntered, StageLeft
from guidefield.prove.certificate import smallest_along
from guidefield.prove.curve import Curve

JUDGED_STEP = 0.02
"""Joint distance between two configurations that are judged on the exact geometry [rad or m]."""

FINER = 40
"""Places on each piece between which its length is measured."""

SAMPLES = 50
"""Number of places, evenly apart in time, that the search for the smallest distances begins with."""

REPEATS = 3
SECONDS = 20.0
"""Budget of one problem."""

STAGES = ("ends", "connect", "relax", "parameterize", "certify")
AT_THE_ENDS = 1e-3
"""How much less than the ends' own clearance still counts as theirs [m]."""


@dataclass(frozen=True)
class Judged:
    """A motion on the exact geometry: smallest, inner and ends' clearance [m], length [rad], whether it hits."""

    minimum: float
    inner: float
    ends: float
    length: float
    hits: bool

    @property
    def at_the_ends(self) -> bool:
        """Whether nothing between the ends is closer than they are."""
        return self.minimum >= self.ends - AT_THE_ENDS


@dataclass
class Row:
    """One problem: who it is, what came of it, and the times by stage [ms]."""

    name: str
    problem_set: str
    status: str
    judged: Judged | None = None
    relative_length: float = np.nan
    smoothness: float = np.nan
    duration: float = np.nan
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def run(arguments: list[str]) -> None:
    """Print a table for each robot."""
    parser = argparse.ArgumentParser(prog="tools/bench quality", description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="the folder that `guidefield docs benchmarks` describes")
    parser.add_argument("--robots", default=",".join(ROBOTS[:3]), help="which, between commas")
    parser.add_argument("--every", type=int, default=1, help="take every n-th problem only")
    parser.add_argument("--peers", action="store_true", help="plan with the peers that are installed, too")
    parser.add_argument("--worst", type=int, default=0, help="name so many problems that were worst, and all warnings")
    options = parser.parse_args(arguments)
    for robot in options.robots.split(","):
        given = Problems.load(options.folder, robot, options.every)
        vamp = given.peers_rows()
        _row(given, given.problems[0], vamp)  # compiles and computes what is kept from then on
        rows = [_row(given, problem, vamp) for problem in given.problems]
        print(f"\n{robot}: {len(rows)} problems")
        _print("guidefield", rows)
        for name in dict.fromkeys(row.problem_set for row in rows):
            _print(f"  {name}", [row for row in rows if row.problem_set == name])
        if options.worst:
            _print_worst(rows, options.worst)
        _print_vamp(given, vamp)
        for name, solve in peers.installed().items() if options.peers else ():
            _print(name, [_peers_row(given, problem, vamp, name, solve) for problem in given.problems])


class StageClock:
    """An observer that keeps the CPU time of every stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._entered = 0.0

    def observe(self, event: Event) -> None:
        """See `Observer`."""
        if isinstance(event, StageEntered):
            self._entered = time.thread_time()
        elif isinstance(event, StageLeft):
            self.seconds[event.name] += time.thread_time() - self._entered


def _row(given: Problems, problem: dict[str, Any], vamp: dict[tuple[str, int], dict[str, Any]]) -> Row:
    scene, (start, goal) = scene_of(problem), given.ends(problem)
    group = given.group
    seconds: dict[str, float] = {}
    for _ in range(REPEATS):
        clock, began = StageClock(), time.thread_time()
        q_start, to = group.from_chart(start), ConfigurationGoal((group.from_chart(goal),))
        asked = posed(group, scene, q_start, to, deadline=Deadline(time.monotonic() + SECONDS), observer=clock)
        loaded = time.thread_time() - began
        made = plan(asked)
        whole = sum(spent for name, spent in clock.seconds.items() if name != "ends")
        for name, spent in {**clock.seconds, "load": loaded, "whole": whole}.items():
            seconds[name] = min(seconds.get(name, np.inf), 1e3 * spent)
        if whole > 1.0:
            break
    return _measured(f"{problem['set']} {problem['index']}", asked, made, problem, vamp, seconds)


def _measured(
    name: str,
    asked: Problem,
    made: Plan,
    problem: dict[str, Any],
    vamp: dict[tuple[str, int], dict[str, Any]],
    seconds: dict[str, float],
) -> Row:
    row = Row(name, problem["set"], made.status.name, seconds=seconds, warnings=made.warnings)
    if made.trajectory is None or made.status is not Status.SUCCESS:
        return row
    row.judged = judged(asked.world, Curve(made.trajectory.bezier(), made.trajectory.piece_times()))
    row.relative_length = _relative(row.judged, problem, vamp)
    row.smoothness, row.duration = (
        measure_figures(made.trajectory, asked.kinematics).smoothness,
        made.trajectory.duration,
    )
    return row


def _peers_row(
    given: Problems,
    problem: dict[str, Any],
    vamp: dict[tuple[str, int], dict[str, Any]],
    name: str,
    solve: Callable[[peers.Task], peers.Answer],
) -> Row:
    start, goal = given.ends(problem)
    world, path = World.build(given.group, scene_of(problem)), given.folder / "robots" / given.robot / given.robot
    task = peers.Task(path, given.folder / "robots", world, problem["obstacles"], start, goal, SECONDS, 0)
    answer = solve(task)
    row = Row(f"{problem['set']} {problem['index']}", problem["set"], "SUCCESS" if answer.path is not None else name)
    row.seconds = {"load": 1e-3 * answer.scene, "connect": 1e-3 * answer.plan, "relax": 1e-3 * answer.simplify}
    row.seconds["whole"] = row.seconds["connect"] + row.seconds["relax"]
    if answer.path is not None:
        row.judged = judged(world, Curve(polyline(answer.path), np.arange(max(2.0, len(answer.path)))))
        row.relative_length = _relative(row.judged, problem, vamp)
    return row


def judged(world: World, curve: Curve) -> Judged:
    """A motion on the exact geometry: distances by branch and bound, hits `JUDGED_STEP` apart."""
    fine = np.unique(np.linspace(curve.times[:-1], curve.times[1:], FINER))
    points = curve.at(fine)
    lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    places = np.linspace(0.0, lengths[-1], max(2, int(np.ceil(lengths[-1] / JUDGED_STEP)) + 1))
    samples = np.column_stack([np.interp(places, lengths, column) for column in points.T])
    start, end = float(fine[0]), float(fine[-1])
    spans = [(start, end)]
    if lengths[-1] > 2.0 * END_LENGTH:
        since, until = np.interp([END_LENGTH, lengths[-1] - END_LENGTH], lengths, fine).tolist()
        spans.append((since, until))
    times = np.linspace(curve.times[0], curve.times[-1], SAMPLES)
    minimum, *inner = (found.distance for found in smallest_along(world, curve, times, spans).obstacle)
    ends = [clearance_at(world, world.group.expand_from_chart(z)).obstacle_distance for z in samples[[0, -1]]]
    return Judged(
        minimum=minimum,
        inner=inner[0] if inner else np.nan,
        ends=min(ends),
        length=float(lengths[-1]),
        hits=any(world.in_collision(world.group.expand_from_chart(z)) for z in samples),
    )


def _relative(motion: Judged, problem: dict[str, Any], vamp: dict[tuple[str, int], dict[str, Any]]) -> float:
    peer = vamp.get((problem["set"], problem["index"]))
    return motion.length / peer["cost"] if peer and peer["solved"] else np.nan


def _print(title: str, rows: list[Row]) -> None:
    done = [(row, row.judged) for row in rows if row.judged is not None]
    hits = sum(motion.hits for _, motion in done)
    print(f" {title}: {len(done)} of {len(rows)} found, {hits} hit on the exact meshes", end="")
    unsolved = [f"{row.name} ({row.status.lower()})" for row in rows if row.judged is None]
    print(f"; not: {', '.join(unsolved[:8])}" if unsolved else "")
    if not done:
        return
    share = np.mean([motion.at_the_ends for _, motion in done])
    print(
        f"    minimum {_spread(1e3 * m.minimum for _, m in done)} mm, {100 * share:.0f} % at the ends' own;"
        f" inner {_spread(1e3 * m.inner for _, m in done)} mm;"
        f" found motions not optimised: {sum(bool(row.warnings) for row, _ in done)};"
        f" length {_spread((row.relative_length for row, _ in done), 95, 2)} of VAMP's;"
        f" smoothness {_median(row.smoothness for row, _ in done):.2f};"
        f" duration {_median(row.duration for row, _ in done):.2f} s"
    )
    stages = [stage for stage in ("load", *STAGES, "whole") if any(stage in row.seconds for row, _ in done)]
    times = [f"{stage} {_spread((row.seconds.get(stage, 0.0) for row, _ in done), 95, 1)}" for stage in stages]
    print(f"    ms: {'; '.join(times)}")


def _print_worst(rows: list[Row], count: int) -> None:
    short = [row for row in rows if row.judged is not None and not row.judged.at_the_ends]
    short.sort(key=lambda row: row.judged.minimum - row.judged.ends if row.judged else 0.0)
    for row in rows:
        for warning in row.warnings:
            print(f"    {row.name}: {warning}")
    for row in short[:count]:
        if row.judged is not None:
            print(f"    {row.name} comes {1e3 * (row.judged.ends - row.judged.minimum):.1f} mm closer than its ends")
    for row in sorted(rows, key=lambda row: -row.seconds.get("whole", 0.0))[:count]:
        print(f"    {row.name}: " + ", ".join(f"{name} {spent:.1f}" for name, spent in row.seconds.items()) + " ms")


def _print_vamp(given: Problems, vamp: dict[tuple[str, int], dict[str, Any]]) -> None:
    chosen = [vamp[key] for p in given.problems if (key := (p["set"], p["index"])) in vamp]
    rows = [row for row in chosen if row["solved"] and row.get("clearance") is not None]
    if not rows:
        return
    hit = sum(row["clearance"] <= 0.0 for row in rows)
    inner = [1e3 * row["inner_clearance"] for row in rows if row.get("inner_clearance") is not None]
    print(
        f" VAMP's rows: {len(rows)} of {len(chosen)} found, {hit} hit;"
        f" minimum {_spread(1e3 * row['clearance'] for row in rows)} mm; inner {_spread(inner)} mm"
    )


def _spread(values: Iterable[float], quantile: int = 5, digits: int = 1) -> str:
    """Median and a quantile."""
    known = np.array([value for value in values if np.isfinite(value)])
    if not len(known):
        return "-"
    return f"{np.median(known):.{digits}f} / {np.percentile(known, quantile):.{digits}f}"


def _median(values: Iterable[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else np.nan
