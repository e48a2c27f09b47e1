"""Curves one after the other whose corners are rounded: each corner within a distance of where the two curves meet.

A corner is where a curve A ends at the place c at which the next one, B, begins. From where A has a length ``a`` left
to where B has gone a length ``b``, with ``u`` from 0 to 1,

    q(u) = A(a (1 - u)²) + B(b u²) - c,

lengths counted from c, takes their place. It begins along A and ends along B, as a parabola between two straight lines;
nothing else of the curves is changed. (With u³ (2 - u) for u² the curvature has no step, and motions were 2 % slower,
with limits of jerk up to 7 %.)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.sequence.nearness import PassedGoal
from guidefield.read_only import ReadOnly
from guidefield.robot.model.spaces import ChartPoints


@dataclass(frozen=True)
class CornerSettings:
    """Numbers of rounded corners.

    Attributes:
        looks: Places on each piece of a motion between which its length is measured.
        share: Of a radius that a corner takes: a spline through its places stays within the radius, too.
        most: Share of a curve's length that a corner takes at most: the other end has as much.
        places: On a corner, at least.
        fine: Places between which a corner's length is measured.
    """

    looks: int = 8
    share: float = 0.9
    most: float = 0.5
    places: int = 16
    fine: int = 200


CORNER = CornerSettings()


class Curve:
    """The curve of a motion by its length.

    Args:
        motion: The motion, not a single point.
    """

    def __init__(self, motion: Trajectory) -> None:
        within = np.arange(CORNER.looks) / CORNER.looks
        times = (motion.times[:-1, None] + within * np.diff(motion.times)[:, None]).ravel()
        self._motion, self._times = motion, np.append(times, motion.times[-1])
        self.places = motion.evaluate(self._times)[0]
        self.lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(self.places, axis=0), axis=1))]

    @property
    def length(self) -> float:
        """[rad or m]."""
        return float(self.lengths[-1])

    def at(self, lengths: np.ndarray) -> ChartPoints:
        """Where the curve is after lengths (k,): shape (k, nv)."""
        return self._motion.evaluate(np.interp(lengths, self.lengths, self._times))[0]


@dataclass(frozen=True, eq=False)
class Rounded(ReadOnly):
    """A path through rounded corners.

    Attributes:
        path: Its places, shape (n, nv).
        corners: For each corner, where it begins and ends in `path`.
    """

    path: ChartPoints
    corners: tuple[tuple[int, int], ...]


def rounded(curves: Sequence[Curve], goals: Sequence[PassedGoal], radii: Sequence[float], spacing: float) -> Rounded:
    """A path along curves, each of which begins where the one before ends.

    Args:
        curves: In order.
        goals: What is passed between one and the next.
        radii: How far from each of them a corner may reach.
        spacing: Between places, at most [rad or m].
    """
    begin, path, corners, count = 0.0, [], [], 0
    for k, (curve, after) in enumerate(zip(curves, [*curves[1:], None], strict=True)):
        if after is None:
            path.append(_evenly(curve, begin, curve.length, spacing))
            break
        left, right = _reach(curve, after, goals[k], radii[k])
        straight = _evenly(curve, begin, curve.length - left, spacing)
        bend = _bend(curve, after, left, right, spacing)
        path += [straight, bend[1:-1]]
        first = count + len(straight) - 1
        count = first + len(bend) - 1
        corners.append((first, count))
        begin = right
    return Rounded(cast(ChartPoints, np.concatenate(path)), tuple(corners))


def _reach(curve: Curve, after: Curve, goal: PassedGoal, radius: float) -> tuple[float, float]:
    """Lengths before and after a goal that a corner takes [rad or m]."""
    within = CORNER.share * radius
    return (
        _until(goal.distances(curve.places)[::-1], curve.length - curve.lengths[::-1], within),
        _until(goal.distances(after.places), after.lengths, within),
    )


def _until(distances: np.ndarray, lengths: np.ndarray, within: float) -> float:
    """The length at which the distances first reach a bound; at most the share of the whole that a corner may take."""
    most = CORNER.most * float(lengths[-1])
    beyond = np.flatnonzero(distances > within)
    if not len(beyond):
        return most
    k = int(beyond[0])
    share = (within - distances[k - 1]) / (distances[k] - distances[k - 1])
    return min(most, float(lengths[k - 1] + share * (lengths[k] - lengths[k - 1])))


def _evenly(curve: Curve, begin: float, end: float, spacing: float) -> ChartPoints:
    """Places of a curve from one length to another, both among them."""
    count = max(2, math.ceil((end - begin) / spacing) + 1)
    return curve.at(np.linspace(begin, end, count))


def _bend(curve: Curve, after: Curve, left: float, right: float, spacing: float) -> ChartPoints:
    """Places of a corner, evenly spaced, its first on the one curve and its last on the other."""
    u = np.linspace(0.0, 1.0, CORNER.fine + 1)
    meeting = curve.at(np.array([curve.length]))
    bend = curve.at(curve.length - left * (1.0 - u) ** 2) + after.at(right * u**2) - meeting
    lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(bend, axis=0), axis=1))]
    count = max(CORNER.places, math.ceil(lengths[-1] / spacing)) + 1
    places = np.linspace(0.0, lengths[-1], count)
    return cast(ChartPoints, np.column_stack([np.interp(places, lengths, column) for column in bend.T]))
