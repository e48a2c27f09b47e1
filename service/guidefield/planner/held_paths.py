"""Ways to goals among obstacles that move: among what rests alone, and with the others held where they are at times."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from guidefield.planner.connect.quickest import quickest_way
from guidefield.planner.fallback_connection import connect_to_goal
from guidefield.planner.path_so_far import PathSoFar
from guidefield.planner.schedule.settings import WAYS
from guidefield.planner.schedule.slices import Slices, build_held_world
from guidefield.planner.task.problem import Problem
from guidefield.planner.task.stages import Stages
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoints


@dataclass(frozen=True, eq=False)
class HeldPath(ReadOnly):
    """A way to a goal among obstacles that are held.

    Attributes:
        detour: Whether it goes by a place to wait at, so that it may not be made shorter.
    """

    name: str
    problem: Problem
    found: PathSoFar
    at_rest: bool = False
    detour: bool = False


def quick_paths(problem: Problem, goals: ChartPoints) -> Iterator[HeldPath]:
    """Ways that a few motions find, one after the other.

    Args:
        goals: Chart points of which one is to be reached, shape (m, nv), free once all obstacles rest.
    """
    for draw, (name, among, at_rest) in enumerate(_holdings(problem)):
        if problem.deadline.expired():
            return
        touching = among.lanes.touching(np.vstack([problem.z_start, goals]), problem.min_clearance)
        if touching[0] or touching[1:].all():
            continue
        near = np.array([problem.group.unwrapped(goal, problem.z_start) for goal in goals[~touching[1:]]])
        way = quickest_way(among, problem.z_start, near, np.random.default_rng([problem.seed, 5, draw]))
        if way is not None:
            found = PathSoFar.at_start(among).extended(way.path, proven=False, others=way.others)
            yield HeldPath(name, among, found, at_rest)


def detours(problem: Problem, goals: ChartPoints, slices: Slices, since: float) -> Iterator[HeldPath]:
    """Ways by places at which the robot may wait, as it can't where it starts; those that are free longest first.

    Args:
        goals: Chart points of which one is to be reached, shape (m, nv), free once all obstacles rest.
        since: From when on it has to be somewhere else [s].
    """
    rng, among, last = np.random.default_rng([problem.seed, 6]), _among(problem, {}), problem.at(problem.scene.end)
    places = _places(among, rng)
    if not len(places):
        return
    blocked = np.zeros(len(places), int)
    for index in range(int(since / slices.length), slices.resting_from + 1):
        if problem.deadline.expired():
            return
        blocked += slices.touching(index, places)
    for place in places[np.argsort(blocked, kind="stable")[: WAYS.detours]]:
        if problem.deadline.expired():
            return
        there = quickest_way(among, problem.z_start, place[None], rng)
        near = np.array([problem.group.unwrapped(goal, place) for goal in goals])
        onward = (
            None if there is None else quickest_way(last, place, near, rng) or quickest_way(among, place, near, rng)
        )
        if there is not None and onward is not None:
            found = PathSoFar.at_start(among).extended(there.path, proven=False).extended(onward.path, proven=False)
            yield HeldPath("by a place to wait at", among, found, detour=True)


def _places(among: Problem, rng: np.random.Generator) -> ChartPoints:
    """Random chart points (n, nv) that are free among what rests, half of them about the start."""
    group, half = among.group, WAYS.places // 2
    aside = rng.normal(scale=WAYS.aside, size=(half, group.nv)) * group.units
    anywhere = np.array([group.chart(group.random(rng)) for _ in range(half)])
    drawn = np.clip(np.concatenate([among.z_start + aside, anywhere]), group.lower, group.upper)
    free: ChartPoints = drawn[~among.lanes.touching(drawn, among.min_clearance)]
    return free


def thorough_path(problem: Problem, goals: ChartPoints, stages: Stages, *, prove: bool) -> HeldPath:
    """The way of the planner among obstacles at rest, once they have come to rest; failed if there is none.

    Args:
        goals: Chart points, shape (m, nv), as there.
    """
    resting = problem.at(problem.scene.end)
    certified = ", certified" if prove else ""
    with stages.entered("connect", f"to the goal, among the obstacles once they rest{certified}") as stage:
        found = connect_to_goal(resting, PathSoFar.at_start(resting), goals, stage, prove=prove)
    return HeldPath("where they come to rest", resting, found, at_rest=True)


def _holdings(problem: Problem) -> Iterator[tuple[str, Problem, bool]]:
    """The problem among obstacles that are held in some ways: in words, and whether where they come to rest."""
    end = problem.scene.end
    yield "among what rests", _among(problem, {}), False
    resting = problem.at(end)
    yield "where they come to rest", resting, True
    for share in WAYS.moments:
        yield f"where they are at {share * end:.2f} s", problem.at(share * end), False
    times = (np.arange(WAYS.swept) + 0.5) / WAYS.swept
    for until in (0.5 * end, end):
        moments = (until * times).tolist()
        yield f"wherever they are until {until:.2f} s", _among(problem, dict.fromkeys(_movers(problem), moments)), False
    for _ in range(WAYS.draws - 1):
        yield "among what rests, again", _among(problem, {}), False


def among_what_rests(problem: Problem) -> Problem:
    """The problem without the obstacles that move."""
    return _among(problem, {}) if problem.scene.moves else problem


def _movers(problem: Problem) -> list[int]:
    return [index for index, one in enumerate(problem.scene.obstacles) if one.motion is not None]


def _among(problem: Problem, moments: dict[int, Sequence[float]]) -> Problem:
    """The problem among what rests, and some of the others, held at times."""
    at_rest = {index: (0.0,) for index, one in enumerate(problem.scene.obstacles) if one.motion is None}
    world = build_held_world(problem, {**at_rest, **moments})
    return dataclasses.replace(
        problem, scene=world.scene, world=world, robot_field=problem.robot_field.among(world.scene)
    )
