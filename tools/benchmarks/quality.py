"""Quality of whole plans: certificate, contacts, clearance, length, smoothness, duration, and their times.

Usage: tools/bench quality <folder> [--robots panda,ur5,fetch,baxter] [--every N] [--peers] [--worst N]
       [--poses] [--acceleration A] [--jerk J] [--objective balanced]

The folder is described in problems.py. Every trajectory is judged on the exact collision geometry, whoever made it:
the smallest distances are exact along it, whether it hits is sampled `JUDGED_STEP` apart. *inner* leaves out
`END_LENGTH` at each end; *at the ends* is the share of problems whose minimum over the whole motion is the
ends' own, less a millimetre; length is a multiple of VAMP's simplified path, from its rows in the folder. Times are
CPU times of one thread, the best of `REPEATS` [ms]; *whole* is connect to certify, the world, its tables and the checks
of the ends apart: those stand under *ends* and *load*.

With --poses goals are the poses of the problems' goals. Numbers of the planner are chosen without every third problem,
by index, which has a row of its own. cuRobo publishes durations of 1.361 (mean), 1.330, 1.420 (75 %) and 2.292 s (98 %)
at 15 rad/s² and 500 rad/s³, of its own 800 problems to poses.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks import peers
from benchmarks.problems import ROBOTS, Problems, problems_parser, scene_of
from guidefield.collision.clearance import clearance_at
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.errors import Status
from guidefield.planner.plan import plan
from guidefield.planner.quality import END_LENGTH, measure_figures
from guidefield.planner.task.problem import ConfigurationGoal, Goal, Objective, Problem, TipGoal
from guidefield.planner.task.trace import Event, StageEntered, StageLeft
from guidefield.potential import Precision, RobotField
from guidefield.prove.certificate import smallest_along
from guidefield.prove.curve import Curve, polyline
from guidefield.robot.group.inverse_kinematics import PoseTarget
from guidefield.robot.group.kinematics import Kinematics

JUDGED_STEP = 0.02
"""Joint distance between two configurations that are judged on the exact geometry [rad or m]."""

FINER = 40
"""Places on each piece between which its length is measured."""

SAMPLES = 50
"""Number of places, evenly apart in time, that the search for the smallest distances begins with."""

REPEATS = 3
SECONDS = 20.0
"""Budget of one problem."""

LEFT_OUT = 3
"""Numbers of the planner are chosen without every problem whose index is a multiple of this."""

STAGES = ("load", "ends", "connect", "relax", "parameterize", "certify", "whole")
AT_THE_ENDS = 1e-3
"""A clearance less than the ends' own by at most this counts as theirs [m]."""

VampRows = dict[tuple[str, int], dict[str, Any]]


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
        """Return whether nothing between the ends is closer than they are."""
        return self.minimum >= self.ends - AT_THE_ENDS


@dataclass
class Row:
    """One problem, the judged motion if there is one, and the times by stage [ms]."""

    problem_set: str
    index: int
    status: str
    judged: Judged | None = None
    relative_length: float = np.nan
    smoothness: float = np.nan
    duration: float = np.nan
    times: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Set and index of the problem."""
        return f"{self.problem_set} {self.index}"


def run(arguments: list[str]) -> None:
    """Print a table for each robot."""
    parser = problems_parser("quality", __doc__, robots=ROBOTS[:3])
    parser.add_argument("--peers", action="store_true", help="plan with the peers that are installed, too")
    parser.add_argument("--worst", type=int, default=0, help="name so many problems that were worst, and all warnings")
    parser.add_argument("--poses", action="store_true", help="the goals are poses of the tip")
    parser.add_argument("--acceleration", type=float, help="limit of every joint [rad/s² or m/s²]")
    parser.add_argument("--jerk", type=float, help="limit of every joint [rad/s³ or m/s³]")
    parser.add_argument("--objective", default="balanced", help="balanced, time or clearance")
    options = parser.parse_args(arguments)
    for robot in options.robots.split(","):
        given = Problems.load(options.folder, robot, options.every)
        vamp = given.peers_rows()
        _row(given, given.problems[0], vamp, options)  # compiles and computes what is kept from then on
        rows = [_row(given, problem, vamp, options) for problem in given.problems]
        print(f"\n{robot}: {len(rows)} problems")
        _print("guidefield", rows)
        _print("  not used to choose numbers", [row for row in rows if row.index % LEFT_OUT == 0])
        for name in dict.fromkeys(row.problem_set for row in rows):
            _print(f"  {name}", [row for row in rows if row.problem_set == name])
        if options.worst:
            _print_worst(rows, options.worst)
        _print_vamp(given, vamp)
        for name, solve in peers.list_installed().items() if options.peers else ():
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


def _problem(given: Problems, declared: dict[str, Any], options: argparse.Namespace, clock: StageClock) -> Problem:
    """A problem with the goal and the limits that are asked for, the tables of its world made anew."""
    group, scene, (start, end) = given.group, scene_of(declared), given.ends(declared)
    if options.acceleration is not None:
        group = group.with_limits({}, {joint.name: options.acceleration for joint in group.joints}, 1.0, 1.0)
    kinematics = Kinematics(group)
    goal: Goal = ConfigurationGoal((group.from_local(end),))
    if options.poses:
        pose = kinematics.frame_placement(group.expand_from_local(end), group.tip_id)
        goal = TipGoal(PoseTarget(pose, np.zeros(3), np.zeros(3)))
    return Problem(
        group=group,
        scene=scene,
        world=World.build(group, scene),
        robot_field=RobotField(group, scene, Precision.SINGLE),
        kinematics=kinematics,
        q_start=group.from_local(start),
        goal=goal,
        deadline=Deadline(time.monotonic() + SECONDS),
        observer=clock,
        jerk_limits=None if options.jerk is None else np.full(group.nv, options.jerk),
        objective=Objective(options.objective),
    )


def _row(given: Problems, declared: dict[str, Any], vamp: VampRows, options: argparse.Namespace) -> Row:
    times: dict[str, float] = {}
    for _ in range(REPEATS):
        clock, began = StageClock(), time.thread_time()
        asked = _problem(given, declared, options, clock)
        loaded = time.thread_time() - began
        made = plan(asked)
        whole = sum(spent for name, spent in clock.seconds.items() if name != "ends")
        for name, spent in {**clock.seconds, "load": loaded, "whole": whole}.items():
            times[name] = min(times.get(name, np.inf), 1e3 * spent)
        if whole > 1.0:
            break
    row = Row(declared["set"], declared["index"], made.status.name, times=times, warnings=made.warnings)
    if made.trajectory is not None and made.status is Status.SUCCESS:
        row.judged = judge_motion(asked.world, Curve(made.trajectory.bezier(), made.trajectory.piece_times()))
        row.relative_length = _relative(row, vamp)
        row.smoothness = measure_figures(made.trajectory, asked.kinematics).smoothness
        row.duration = made.trajectory.duration
    return row


def _peers_row(
    given: Problems, declared: dict[str, Any], vamp: VampRows, name: str, solve: Callable[[peers.Task], peers.Answer]
) -> Row:
    task = peers.task_of(given, declared, SECONDS)
    answer = solve(task)
    row = Row(declared["set"], declared["index"], "SUCCESS" if answer.path is not None else name)
    row.times = {"load": 1e-3 * answer.scene, "connect": 1e-3 * answer.plan, "relax": 1e-3 * answer.simplify}
    row.times["whole"] = row.times["connect"] + row.times["relax"]
    if answer.path is not None:
        row.judged = judge_motion(task.world, Curve(polyline(answer.path), np.arange(max(2.0, len(answer.path)))))
        row.relative_length = _relative(row, vamp)
    return row


def judge_motion(world: World, curve: Curve) -> Judged:
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
    ends = [clearance_at(world, world.group.expand_from_local(z)).obstacle_distance for z in samples[[0, -1]]]
    return Judged(
        minimum=minimum,
        inner=inner[0] if inner else np.nan,
        ends=min(ends),
        length=float(lengths[-1]),
        hits=any(world.in_collision(world.group.expand_from_local(z)) for z in samples),
    )


def _relative(row: Row, vamp: VampRows) -> float:
    peer = vamp.get((row.problem_set, row.index))
    return row.judged.length / peer["cost"] if row.judged and peer and peer["solved"] else np.nan


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
        f" length {_spread((row.relative_length for row, _ in done), (50, 95), 2)} of VAMP's;"
        f" smoothness {_spread((row.smoothness for row, _ in done), (50,), 2)};"
        f" duration, median / 75 / 98 % {_spread((row.duration for row, _ in done), (50, 75, 98), 3)} s"
    )
    stages = [stage for stage in STAGES if any(stage in row.times for row, _ in done)]
    times = [f"{stage} {_spread((row.times.get(stage, 0.0) for row, _ in done), (50, 95))}" for stage in stages]
    print(f"    ms: {'; '.join(times)}")


def _print_worst(rows: list[Row], count: int) -> None:
    for row in rows:
        for warning in row.warnings:
            print(f"    {row.name}: {warning}")
    short = [(row.judged.minimum - row.judged.ends, row.name) for row in rows if row.judged is not None]
    for off, name in sorted(short)[:count]:
        if off < -AT_THE_ENDS:
            print(f"    {name} comes {-1e3 * off:.1f} mm closer than its ends")
    for row in sorted(rows, key=lambda row: -row.times.get("whole", 0.0))[:count]:
        print(f"    {row.name}: " + ", ".join(f"{name} {spent:.1f}" for name, spent in row.times.items()) + " ms")


def _print_vamp(given: Problems, vamp: VampRows) -> None:
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


def _spread(values: Iterable[float], quantiles: tuple[int, ...] = (50, 5), digits: int = 1) -> str:
    """Quantiles of what is known [%]."""
    known = [value for value in values if np.isfinite(value)]
    return " / ".join(f"{value:.{digits}f}" for value in np.percentile(known, quantiles)) if known else "-"
