"""Other planners' paths, judged by `certify` and by samples on the exact meshes: where they differ, and why.

Usage: tools/bench judged <folder> [--robots panda,ur5,fetch,baxter] [--every N] [--seconds S]

The folder is described in problems.py; the planners are those of peers.py that are installed, and the straight segment
from start to goal. The samples are those of `tools/doubt`, on the meshes as they are in their files. The certificate
judges hulls that stand off from their meshes: a path that it alone refuses is printed with the distance of the exact
meshes where it was refused, and with how far the hulls of the two bodies stand off together.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks import peers
from benchmarks.problems import Problems, print_times, problems_parser, scene_message
from doubting.compare import asked_curve, judge_of, names_of, time_of
from doubting.loaded import Loaded, subject_of
from doubting.robots import Robot
from guidefield.engine import Engine
from guidefield.messages.requests import CertifyRequest

SAME = 1e-5
"""A distance may exceed what hulls stand off by so much, and the refusal is explained by that [m]."""


@dataclass(frozen=True)
class Row:
    """One path: what certificate and samples say, the certificate's time [ms], how a difference is explained."""

    certified: bool
    sampled: bool
    milliseconds: float
    difference: str = ""
    explained: bool = False


def run(arguments: list[str]) -> None:
    """Print, for each robot and planner, how the two judges agree, and every difference."""
    parser = problems_parser("judged", __doc__)
    parser.add_argument("--seconds", type=float, default=5.0, help="what planning may take")
    options = parser.parse_args(arguments)
    for robot in options.robots.split(","):
        given = Problems.load(options.folder, robot, options.every)
        model = given.group.robot
        subject = subject_of(model, model.source.urdf_text, exact=True)
        loaded = Loaded(Robot(), given.reference, model, subject, model.source.urdf_text, Engine())
        for name, solve in {"straight": _straight, **peers.list_installed()}.items():
            rows = [_row(given, loaded, problem, solve, options.seconds) for problem in given.problems]
            _print(f"{robot}, {name}", [row for row in rows if row is not None], len(rows))


def _straight(task: peers.Task) -> peers.Answer:
    """The straight segment from start to goal."""
    return peers.Answer(np.array([task.start, task.goal]), 0.0, 0.0, 0.0)


def _row(
    given: Problems,
    loaded: Loaded,
    problem: dict[str, Any],
    solve: Callable[[peers.Task], peers.Answer],
    seconds: float,
) -> Row | None:
    """One problem's path, judged twice; None where the planner found none."""
    answer = solve(peers.task_of(given, problem, seconds))
    if answer.path is None:
        return None
    names = [joint.name for joint in given.group.joints]
    request = CertifyRequest(
        given.reference,
        scene_message(problem),
        path=answer.path.tolist(),
        start={name: value for name, value in given.standing.items() if name not in names},
        position_names=names,
        allowed_time=60.0,
        recording="off",
    )
    reply = loaded.engine.answer(request)
    judge, curve = judge_of(loaded, request, names_of(names)), asked_curve(loaded, request)
    sampled, verdict = judge.along_all(curve), reply.certificate
    nearest = min(sampled.obstacle, sampled.own, key=lambda one: one.distance)
    certified, free, time = verdict.collision_free, nearest.distance > 0.0, 1e3 * reply.timing.total
    where = f"{problem['set']} {problem['index']}: "
    if certified == free:
        return Row(certified, free, time)
    if certified:
        return Row(certified, free, time, f"{where}certified, and {nearest.pair} touch at a sample")
    if verdict.pair is None or verdict.place is None:
        return Row(certified, free, time, f"{where}refused: {verdict.reason}; free at samples")
    pairs = judge.between(verdict.pair)
    distances = judge.along(curve, np.full(len(pairs), time_of(curve, verdict.place.row)), pairs)
    distance, stand_off = float(distances.min()), _stand_off(given, verdict.pair)
    told = f"{where}{verdict.reason} of {verdict.pair}"
    if distance <= 0.0:
        return Row(certified, free, time, f"{told}; the meshes touch there, between samples", True)
    told += f"; the meshes keep {1e3 * distance:.3f} mm there, their hulls stand off by {1e3 * stand_off:.3f} mm"
    return Row(certified, free, time, told, distance <= stand_off + SAME)


def _stand_off(given: Problems, pair: list[str]) -> float:
    """Return how far what is judged of two bodies stands off from their meshes together, at most [m]."""
    of = Counter[str]()
    for choice in given.group.robot.geometry_choices:
        of[choice.link] = max(of[choice.link], choice.stand_off)
    return float(sum(of[name] for name in pair))


def _print(title: str, rows: list[Row], asked: int) -> None:
    print(f"\n{title}: {len(rows)} paths for {asked} problems")
    for certified, sampled, words in (
        (True, True, "free for both"),
        (False, False, "refused by both"),
        (False, True, "refused by the certificate alone"),
        (True, False, "refused by samples alone"),
    ):
        print(f"  {words}: {sum((row.certified, row.sampled) == (certified, sampled) for row in rows)}")
    print_times("  certify, ms", [row.milliseconds for row in rows])
    for row in rows:
        if row.difference:
            print(f"   {'explained' if row.explained else 'UNEXPLAINED'}: {row.difference}")
