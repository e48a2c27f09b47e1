"""How fast whole motions are: the public problems of a Panda as pose goals, at any limits.

Usage: tools/bench motion <folder> [--every N] [--acceleration A] [--jerk J] [--robots panda,...] [--configurations]
    [--objective balanced]

The folder is described in problems.py. Every third problem, by index, stands in a row of its own: numbers are chosen on
the others. (Before this was so, some numbers were chosen on problems of all sets, these among them: the row is no blind
test.) *T* is the duration of the motion [s]: mean, median, 75 % and 98 %; *way* its length in the chart
[rad or m], mean and median; *inner* the exact smallest clearance without `END_STRETCH` at each end [mm]: median, 5 %,
and how many are below 20; *ends* the share of problems whose minimum is the ends' own, less a millimetre. Times are CPU
times of one thread [ms], median and mean: *stage* from the path that was found to the motion, *plan* without the
checks of the ends. With `--configurations` goals are the problems' own configurations, and without limits the robot's
count. cuRobo publishes 1.361, 1.330, 1.420 and 2.292 s for 15 rad/s² and 500 rad/s³, of its own 800 problems.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.problems import Problems, posed, scene_of
from benchmarks.quality import AT_THE_ENDS, Judged, StageClock, judged
from guidefield.deadline import Deadline
from guidefield.errors import Status
from guidefield.planner.plan import plan
from guidefield.planner.task.problem import ConfigurationGoal, Goal, Objective, Problem, TipGoal
from guidefield.prove.curve import Curve
from guidefield.robot.ik.inverse_kinematics import PoseTarget

SECONDS = 20.0
"""Budget of one problem."""

LEFT_OUT = 3
"""Numbers are chosen without every so manieth problem, by index."""

STAGES = ("parameterize", "relax")


@dataclass(frozen=True)
class Row:
    """One problem: whether it is left out of choices, the judged motion, its duration [s] and CPU times [ms]."""

    left_out: bool
    judged: Judged
    duration: float
    stage: float
    whole: float
    certified: bool


def run(arguments: list[str]) -> None:
    """Print two rows for each robot."""
    parser = argparse.ArgumentParser(prog="tools/bench motion", description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="the folder that `guidefield docs benchmarks` describes")
    parser.add_argument("--robots", default="panda", help="which, between commas")
    parser.add_argument("--every", type=int, default=1, help="take every n-th problem only")
    parser.add_argument("--acceleration", type=float, help="limit of every joint [rad/s² or m/s²]")
    parser.add_argument("--jerk", type=float, help="limit of every joint [rad/s³ or m/s³]")
    parser.add_argument("--objective", default="balanced", help="balanced, time or clearance")
    parser.add_argument("--configurations", action="store_true", help="the goals are configurations")
    options = parser.parse_args(arguments)
    for robot in options.robots.split(","):
        given = Problems.load(options.folder, robot, options.every)
        plan(_posed(given, given.problems[0], options))  # compiles and computes what is kept from then on
        rows = [row for k, p in enumerate(given.problems) if (row := _row(k * options.every, given, p, options))]
        print(f"\n{robot}: {len(rows)} of {len(given.problems)} problems")
        _print("others", [row for row in rows if not row.left_out])
        _print("left out", [row for row in rows if row.left_out])


def _posed(given: Problems, declared: dict[str, Any], options: argparse.Namespace, **rest: Any) -> Problem:
    """A problem with the limits that are asked for."""
    group, (start, end) = given.group, given.ends(declared)
    if options.acceleration is not None:
        group = group.with_limits({}, {joint.name: options.acceleration for joint in group.joints}, 1.0, 1.0)
    jerk = None if options.jerk is None else np.full(group.nv, options.jerk)
    scene, q_start = scene_of(declared), group.from_chart(start)
    rest |= {"jerk_limits": jerk, "objective": Objective(options.objective)}
    asked = posed(group, scene, q_start, ConfigurationGoal((group.from_chart(end),)), **rest)
    if options.configurations:
        return asked
    pose = asked.kinematics.frame_placement(group.expand_from_chart(end), group.tip_id)
    goal: Goal = TipGoal(PoseTarget(pose, np.zeros(3), np.zeros(3)))
    return posed(group, scene, q_start, goal, **rest)


def _row(index: int, given: Problems, declared: dict[str, Any], options: argparse.Namespace) -> Row | None:
    clock = StageClock()
    asked = _posed(given, declared, options, deadline=Deadline(time.monotonic() + SECONDS), observer=clock)
    made = plan(asked)
    if made.trajectory is None:
        print(f"  {declared['set']} {declared['index']}: {made.message}")
        return None
    for warning in made.warnings:
        print(f"  {declared['set']} {declared['index']}: {warning}")
    motion = made.trajectory
    return Row(
        left_out=index % LEFT_OUT == 0,
        judged=judged(asked.world, Curve(motion.bezier(), motion.piece_times())),
        duration=motion.duration,
        stage=1e3 * sum(clock.seconds[name] for name in STAGES),
        whole=1e3 * sum(spent for name, spent in clock.seconds.items() if name != "ends"),
        certified=made.status is Status.SUCCESS and made.verdict.free,
    )


def _print(title: str, rows: list[Row]) -> None:
    if not rows:
        return
    T, way = np.array([row.duration for row in rows]), np.array([row.judged.length for row in rows])
    inner = 1e3 * np.array([row.judged.inner for row in rows])
    ends = np.mean([row.judged.minimum >= row.judged.ends - AT_THE_ENDS for row in rows])
    stage, whole = np.array([row.stage for row in rows]), np.array([row.whole for row in rows])
    print(
        f"  {title} ({len(rows)}): T {T.mean():.3f} / {np.median(T):.3f} / {np.percentile(T, 75):.3f} /"
        f" {np.percentile(T, 98):.3f} s; way {way.mean():.2f} / {np.median(way):.2f};"
        f" inner {np.nanmedian(inner):.0f} / {np.nanpercentile(inner, 5):.0f} / {int((inner < 20.0).sum())};"
        f" ends {100 * ends:.0f} %; hits {sum(row.judged.hits for row in rows)};"
        f" certified {sum(row.certified for row in rows)};"
        f" stage {np.median(stage):.1f} / {stage.mean():.1f}; plan {np.median(whole):.1f} / {whole.mean():.1f} ms"
    )
