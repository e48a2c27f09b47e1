"""The seed's scenes: what its thesis reports, beside both minimizers, with given and with derived guide planes.

Options: [--runs N] [--starts N] [--links] [scene ..]. Times are of the guided planner alone: processor time of its one
thread, warm, the best of N runs of a scene. `--starts` tries N random starts in each manipulator scene, `--links`
chains of more links.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pinocchio as pin

from benchmarks.along import smallest_along
from benchmarks.posed import posed
from guidefield.collision.clearance import clearance_at
from guidefield.errors import Status
from guidefield.messages import codec
from guidefield.planner.guide import rounds
from guidefield.planner.guide.auto_planes import derive_planes
from guidefield.planner.guide.guide import ATTEMPTS, FIRST_STEP, Univariate, cross_plane
from guidefield.planner.guide.guided_path import GuidedPath
from guidefield.planner.guide.projected import Projected
from guidefield.planner.guide.rounds import Aim, Attempt
from guidefield.planner.motion.waypoints import polyline
from guidefield.planner.task.problem import LastPlaneGoal, Problem
from guidefield.planner.task.trace import Event, Step, StepKind
from guidefield.prove.curve import Curve
from guidefield.robot.catalog.catalog import Catalog
from guidefield.robot.group.link_chain import link_chain
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import configuration_from_wire
from guidefield.scene import guide_plane, library
from guidefield.scene.guide_plane import GuidePlane
from guidefield.scene.scene import build

REQUESTS = Path(__file__).resolve().parents[1] / "examples" / "requests"
THESIS = {"seed_a_gates": (8, 2.924), "seed_b_tapered": (12, 26.648), "seed_c_blocked": (11, 34.199)}
"""Configurations, and seconds on a Pentium III at 1 GHz."""
THESIS_TABLE = (5.988, 3.245, 1.612, 2.184, 1.592, 1.492, 1.963, 1.612, 1.472, 1.502, 2.374, 1.612)
"""Its Table 4.1: seconds for each of the 12 configurations of the tapered passage."""
SCENES = (*THESIS, *(f"seed_{s}" for s in ("d_passage_3", "d_passage_6", "e_L_3", "e_L_6", "e_S_3", "e_S_6")))
LONGER = (
    *(f"seed_b_tapered{n}" for n in ("", "_10_links", "_12_links", "_20_links", "_24_links", "_40_links", "_48_links")),
    *(f"seed_d_passage_{n}" for n in ("3", "6", "12_links", "24_links", "6_out_again")),
    *(f"seed_e_L_{n}_planar" for n in (3, 6)),
    *(f"seed_{s}_universal" for s in ("a_gates", "b_tapered", "c_blocked", "d_passage_6", "e_S_6")),
)
"""More links, out again, planar bases, universal joints."""
GOALS = {"projected": (8.0, 20.0), "univariate": (200.0, 400.0)}
"""Median and worst of the nine scenes [ms]."""
CATALOG = Catalog()


class Clock:
    """Notes when each configuration was found: at the end of the steps that follow an advance."""

    def __init__(self) -> None:
        self.steps: list[tuple[float, Step]] = []

    def observe(self, event: Event) -> None:
        """Keep steps, with the time."""
        if isinstance(event, Step):
            self.steps.append((time.process_time(), event))

    def configurations(self) -> list[float]:
        """Seconds that each configuration took."""
        seconds, before = [], self.steps[0][0]
        for k, (at, step) in enumerate(self.steps):
            last = k + 1 == len(self.steps) or self.steps[k + 1][1].kind in (StepKind.ADVANCE, StepKind.START)
            if last and step.kind is not StepKind.START:
                seconds.append(at - before)
                before = at
        return seconds


@dataclasses.dataclass(frozen=True)
class Run:
    """One crossing of planes: what it took and what came of it."""

    solved: bool
    seconds: float
    evaluations: int
    configurations: list[float]
    potentials: list[float]
    settled_from: list[np.ndarray]
    path: np.ndarray


def problem_of(title: str) -> Problem:
    """The problem of an example request."""
    request = codec.decode_request((REQUESTS / f"{title}.json").read_bytes())
    robot, scene = CATALOG.load(request.robot), build(library.read(request.scene))
    q = configuration_from_wire(robot, request.start)
    group = select(robot, request.group, request.tip, q, pin.SE3.Identity())
    planes = scene.guide_planes
    if isinstance(request.guide_planes, list):
        planes = tuple(guide_plane.build(message, index) for index, message in enumerate(request.guide_planes))
    return posed(group, scene, group.part_of(q), LastPlaneGoal(), guide_planes=planes)


def crossed(problem: Problem, planes: Sequence[GuidePlane], attempts: Sequence[Attempt]) -> Run:
    """Cross planes, one after the other, from the problem's start."""
    clock = Clock()
    problem = dataclasses.replace(problem, observer=clock)
    q, evaluations, paths = problem.q_start, problem.robot_field.evaluations, []
    potentials, settled_from, solved = [], [], True
    begin = time.process_time()
    for index, plane in enumerate(planes):
        crossing = cross_plane(problem, q, plane, index, attempts)
        paths.append(crossing.path)
        q, solved = crossing.path[-1], crossing.status is Status.SUCCESS
        if not solved:
            break
    seconds = time.process_time() - begin
    evaluations = problem.robot_field.evaluations - evaluations
    for index, path in enumerate(paths):
        advances = [step.q for _, step in clock.steps if step.kind is StepKind.ADVANCE and step.plane == index]
        potentials.append(problem.robot_field.potential(path[-1]))
        settled_from.append(advances[-1])
    return Run(solved, seconds, evaluations, clock.configurations(), potentials, settled_from, np.concatenate(paths))


def clearance(problem: Problem, path: np.ndarray) -> tuple[float, float]:
    """Smallest clearance along a path, exact, and the mean of samples [mm]."""
    zs = problem.group.chart_path(list(path))
    found = []
    for a, b in pairwise(zs):
        for t in np.linspace(0.0, 1.0, 1 + int(np.ceil(np.abs(b - a).max() / 0.02)), endpoint=False):
            found.append(
                clearance_at(problem.world, problem.group.expand_from_chart(a + t * (b - a))).obstacle_distance
            )
    curve = Curve(polyline(zs), np.arange(max(2.0, len(zs))))
    (least,) = smallest_along(problem.world, curve, [(0.0, float(curve.times[-1]))])
    return 1000.0 * least, 1000.0 * float(np.mean(found))


def turning(problem: Problem, path: np.ndarray) -> tuple[float, float]:
    """Length in the chart [rad], and the mean angle between successive pieces [rad]."""
    pieces = np.diff(problem.group.chart_path(list(path)), axis=0)
    lengths = np.linalg.norm(pieces, axis=1)
    pieces, lengths = pieces[lengths > 1e-9], lengths[lengths > 1e-9]
    cosines = np.einsum("ij,ij->i", pieces[:-1], pieces[1:]) / (lengths[:-1] * lengths[1:])
    return float(lengths.sum()), float(np.arccos(np.clip(cosines, -1.0, 1.0)).mean()) if len(cosines) else 0.0


def report(title: str, minimizer: str, runs: int, derived: Sequence[GuidePlane] | None = None) -> Run:
    """Cross a scene's planes (or derived ones, then the last), and print its line of the table."""
    problem = problem_of(title)
    planes = problem.guide_planes if derived is None else (*derived, problem.guide_planes[-1])
    attempts = ATTEMPTS[minimizer](problem.group)
    found = min((crossed(problem, planes, attempts) for _ in range(runs)), key=lambda run: run.seconds)
    with patch.object(rounds, "AT_ONCE", 1):  # each configuration comes back by itself
        alone = min((crossed(problem, planes, attempts) for _ in range(runs)), key=lambda run: run.seconds)
    least, mean = clearance(problem, found.path)
    length, angle = turning(problem, found.path)
    each = 1000.0 * np.array(alone.configurations)
    print(
        f"{title:28} {minimizer:10} {'yes' if found.solved else 'NO':3} {len(each):5} {1000 * found.seconds:9.1f}"
        f" {each[0]:8.1f} {np.median(each):8.1f} {found.evaluations:7} {least:7.1f} {mean:7.1f} {length:7.1f}"
        f" {angle:6.2f}"
        f"  {' '.join(f'{u:.3f}' for u in found.potentials)}"
    )
    return found


HEADER = (
    f"{'scene':28} {'minimizer':10} {'ok':3} {'conf.':>5} {'ms':>9} {'first':>8} {'median':>8} {'evals':>7}"
    f" {'min mm':>7} {'mean mm':>7} {'rad':>7} {'turn':>6}  U at each plane"
)


def table(scenes: Sequence[str], minimizers: Sequence[str], runs: int) -> None:
    """The table of scenes, and how it stands to the goals."""
    print(HEADER)
    for minimizer in minimizers:
        milliseconds = [1000.0 * report(title, minimizer, runs).seconds for title in scenes]
        median, worst = GOALS[minimizer]
        print(
            f"-- {minimizer}: median {np.median(milliseconds):.1f} ms (goal {median:.0f}),"
            f" worst {max(milliseconds):.1f} ms (goal {worst:.0f})"
        )
    for title, (configurations, seconds) in THESIS.items():
        print(f"{title:28} thesis         {configurations:5} {1000 * seconds:9.1f}   at 1 GHz")
    first, others = 1000 * THESIS_TABLE[0], 1000 * float(np.median(THESIS_TABLE[1:]))
    print(f"its table for seed_b_tapered: first {first:.0f} ms, median of the others {others:.0f} ms")


def derived_planes(scenes: Sequence[str], runs: int) -> None:
    """The same with the goal plane alone."""
    print("\nguide planes derived, the goal plane alone given")
    print(HEADER)
    milliseconds = []
    for title in scenes:
        problem = problem_of(title)
        spent = []
        for _ in range(max(runs, 3)):
            begin = time.process_time()
            planes = derive_planes(problem, problem.guide_planes[-1])
            spent.append(1000.0 * (time.process_time() - begin))
        milliseconds.append(min(spent))
        report(title, "projected", runs, planes or ())
    print(f"-- deriving: {', '.join(f'{ms:.1f}' for ms in milliseconds)} ms (goal 15)")


def converged(scenes: Sequence[str]) -> None:
    """Both minimizers run to convergence on the same plane from the same configuration."""
    print("\nrun to convergence on each plane, from where Univariate's last advance got: U of Projected, Univariate")
    below = total = 0
    for title in scenes:
        problem = problem_of(title)
        chain = link_chain(problem.group)
        run = crossed(problem, problem.guide_planes, (Attempt(Univariate(chain), FIRST_STEP),))
        cells = []
        for plane, q in zip(problem.guide_planes, run.settled_from, strict=False):
            ends = []
            for minimizer in (Projected(tolerance=1e-8, most_steps=600), Univariate(chain, 1e-6, 60)):
                guided = GuidedPath(problem, q, 2e-3, 0)
                minimizer.settle(guided, plane.centroid, plane.normal, Aim(plane, 0.0).inside(0.0))
                ends.append(problem.robot_field.potential(guided.q))
            total, below = total + 1, below + (ends[0] <= ends[1] * 1.0005)
            cells.append(f"{ends[0]:.3f} {ends[1]:.3f} ({100 * (ends[0] / ends[1] - 1):+.2f} %)")
        print(f"{title:20} {'   '.join(cells)}")
    print(f"-- Projected at Univariate's U or below (within 0.05 %) on {below} of {total} planes")


def random_starts(count: int) -> None:
    """Random walks behind the first plane, then all planes, with all retries."""
    print("\nrandom free starts")
    for title in THESIS:
        problem = problem_of(title)
        attempts, solved, failures = ATTEMPTS["projected"](problem.group), 0, []
        for seed in range(count):
            run = crossed(dataclasses.replace(problem, q_start=wandered(problem, seed)), problem.guide_planes, attempts)
            solved += run.solved
            if not run.solved:
                failures.append(seed)
        print(f"{title:20} {solved} of {count}" + (f", not seeds {failures}" if failures else ""))


def wandered(problem: Problem, seed: int, steps: int = 60) -> np.ndarray:
    """A configuration at the end of a free random walk whose tip stays behind the first plane."""
    rng, guided, plane = (
        np.random.default_rng(seed),
        GuidedPath(problem, problem.q_start, 5e-3, 0),
        problem.guide_planes[0],
    )
    side = np.sign(plane.signed_height(guided.tip))
    for _ in range(steps):
        q = problem.group.integrate(guided.q, 0.25 * rng.normal(size=problem.group.nv))
        tip = problem.kinematics.tip_position(problem.group.expand(q))
        if side * plane.signed_height(tip) > 0.05 and guided.free(guided.q, q):
            guided.take(q, "walk", "")
    return guided.q


def run(arguments: list[str]) -> None:
    """Measure."""
    parser = argparse.ArgumentParser(prog="tools/bench seed", description=__doc__)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--starts", type=int, default=0)
    parser.add_argument("--links", action="store_true")
    parser.add_argument("--minimizer", choices=[*ATTEMPTS], action="append")
    parser.add_argument("scenes", nargs="*", default=SCENES)
    asked = parser.parse_args(arguments)
    table(asked.scenes, asked.minimizer or [*ATTEMPTS], asked.runs)
    derived_planes(asked.scenes, asked.runs)
    if asked.minimizer != ["projected"]:
        converged(asked.scenes)
    if asked.links:
        print("\nmore links, out again, planar bases, universal joints")
        print(HEADER)
        for title in LONGER:
            report(title, "projected", 1)
    if asked.starts:
        random_starts(asked.starts)
