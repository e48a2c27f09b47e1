"""The smallest distances along a motion; where it is in contact, the depth at the worst of a few samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.kernels.collide.gjk import ACCURACY, SLACK
from guidefield.kernels.prove.tables import NEARLY
from guidefield.prove.closest import ClosestPairs, put_obstacle
from guidefield.prove.curve import Curve
from guidefield.prove.search import ContradictionError, Goal, SearchResult, Smallest, search
from guidefield.prove.tables import arithmetic_error
from guidefield.prove.verdict import with_coal_error

DEPTHS = 4  # maximum number of samples in contact at which depth is measured


def smallest_along(
    world: World,
    curve: Curve,
    samples: np.ndarray,
    spans: Sequence[tuple[float, float]],
    min_clearance: float | None = None,
    deadline: Deadline = UNLIMITED,
) -> SearchResult:
    """Find the smallest distances along a motion among obstacles in time.

    They are at most `TOLERANCE` too large, and Coal confirms each where it is. Where bodies are in contact the smallest
    is the signed distance at the worst of `DEPTHS` samples in contact, the first and the last of them among these.

    Args:
        samples: In order, the ends of the motion among them, shape (k,) [s].
        spans: The smallest distance from obstacles is asked for within each, the whole motion first [s].
        min_clearance: Given where a verdict is asked for as well, see `Goal` [m].

    Raises:
        ContradictionError: if Coal measures another distance where one is smallest.
    """
    found = search(world, curve, Goal(min_clearance, spans=spans, samples=samples), deadline)
    return confirm(world, curve, samples, spans, found)


def confirm(
    world: World, curve: Curve, samples: np.ndarray, spans: Sequence[tuple[float, float]], found: SearchResult
) -> SearchResult:
    """Have Coal confirm what a search found, and measure depths in contact; see `smallest_along`."""
    _confirm(world, curve, {(one.time, one.pair): one for one in (*found.obstacle, found.own)})
    if min((one.distance for one in (*found.obstacle, found.own)), default=np.inf) > NEARLY:
        return found
    return _with_depths(world, curve, samples, spans, found)


def _confirm(world: World, curve: Curve, answers: Mapping[tuple[float, int], Smallest]) -> None:
    """Have Coal measure the pair of each answer without contact where it is smallest, by time and pair."""
    error = arithmetic_error(world) + SLACK + ACCURACY
    apart = [one for one in answers.values() if one.pair >= 0 and one.distance > NEARLY]
    for one, z in zip(apart, curve.at(np.array([one.time for one in apart])), strict=True):
        world.place(world.group.expand_from_chart(z))
        put_obstacle(world, one.pair, one.time)
        measured, _ = world.distance(one.pair)
        off = error + with_coal_error(one.distance) - one.distance
        if abs(measured - one.distance) > off:
            first, second = world.pair_names(one.pair)
            raise ContradictionError(
                f"the search has {first} and {second} {1000 * one.distance:.6g} mm apart at {one.time:.6g} s, Coal has"
                f" {1000 * measured:.6g} mm",
                (world, curve, 0.0),
            )


def _with_depths(
    world: World, curve: Curve, samples: np.ndarray, spans: Sequence[tuple[float, float]], found: SearchResult
) -> SearchResult:
    """What was found, with Coal's signed distances at some of the samples in contact, and where contact was found."""
    touching = np.flatnonzero(found.distances <= NEARLY)
    some = touching[np.unique(np.linspace(0, len(touching) - 1, DEPTHS).astype(int))] if len(touching) else touching
    told = [one.time for one in (*found.obstacle, found.own) if one.distance <= NEARLY]
    times = np.unique(np.concatenate([samples[some], told]))
    touches_itself = found.own.distance <= NEARLY
    qs = world.group.expand_each(curve.at(times))
    measured = list(ClosestPairs(world).clearances(qs, times, counts_own=touches_itself))
    obstacle_depths = [(one.obstacle_distance, one.pairs[1]) for one in measured]
    own_depths = [(one.self_distance, one.pairs[0]) for one in measured]

    def deepest(one: Smallest, span: tuple[float, float], depths: list[tuple[float, int]]) -> Smallest:
        within = [
            (distance, time, pair)
            for time, (distance, pair) in zip(times.tolist(), depths, strict=True)
            if span[0] <= time <= span[1] and pair >= 0
        ]
        if one.distance > NEARLY or not within or (worst := min(within))[0] > one.distance:
            return one
        return replace(one, distance=worst[0], bound=min(worst[0], one.bound), time=worst[1], pair=worst[2])

    obstacle = [deepest(one, span, obstacle_depths) for one, span in zip(found.obstacle, spans, strict=True)]
    distances = found.distances.copy()
    distances[some] = [obstacle_depths[row][0] for row in np.searchsorted(times, samples[some]).tolist()]
    return replace(found, obstacle=obstacle, own=deepest(found.own, spans[0], own_depths), distances=distances)
