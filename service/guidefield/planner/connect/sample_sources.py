"""Where the samples of a search on lanes come from: a group's limits, or the part of them that may matter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from guidefield.kernels.simd.packing import Words, packed
from guidefield.kernels.tree.informed_samples import Sampling
from guidefield.memo import memoized
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.group.alike import memoized_for_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.chart import ROAM, ROTATION, TRANSLATION, WIND
from guidefield.robot.model.spaces import ChartPoints


@dataclass(frozen=True, eq=False)
class Sources(ReadOnly):
    """Where samples of a group come from: chart points in the group's units.

    Attributes:
        sampling: The box that they fill.
        words: That packed.
        roams: Which coordinates are lengths without limits, or angles without limits whose whole turns count: (k,).
        around: How far beyond what is to be reached samples of those lie, shape (k,) [m or rad].
    """

    sampling: Sampling
    words: Words
    roams: np.ndarray
    around: np.ndarray

    @classmethod
    def of(cls, sampling: Sampling, roams: np.ndarray, around: np.ndarray) -> Sources:
        """Sources that fill a box; `roams` and `around` as the attributes, shape (k,)."""
        read_only(*sampling)
        return cls(sampling, packed(sampling), roams, around)

    def about(self, roots: ChartPoints) -> Sources:
        """Where coordinates roam, a box with `around` beside all of some roots, such points, shape (n, nv)."""
        if len(self.roams) == 0:
            return self
        lower, width = self.sampling.lower.copy(), self.sampling.width.copy()
        least, largest = (end(roots[:, self.roams], axis=0) for end in (np.min, np.max))
        lower[self.roams], width[self.roams] = least - self.around, largest - least + 2.0 * self.around
        return Sources.of(self.sampling._replace(lower=lower, width=width), self.roams, self.around)

    def between(self, starts: ChartPoints, goals: ChartPoints, length: float) -> Sources:
        """A box about all points through which a path of some length may lead from a start (k, nv) to a goal (m, nv).

        Of one start and one goal these are an ellipsoid with both in its foci (Gammell 2014); a coordinate that wraps
        keeps its whole turn where the path might go round the other way.
        """
        low, high = self.sampling.lower.copy(), self.sampling.lower + self.sampling.width
        least, largest = np.full(len(low), np.inf), np.full(len(low), -np.inf)
        for start in starts:
            for goal in goals:
                way = goal - start
                distance = float(np.linalg.norm(way))
                along = (way / max(distance, 1e-12)) ** 2
                spare = max(length * length - distance * distance, 0.0)
                reach = 0.5 * np.sqrt(length * length * along + spare * (1.0 - along))
                least, largest = (
                    np.minimum(least, 0.5 * (start + goal) - reach),
                    np.maximum(largest, 0.5 * (start + goal) + reach),
                )
        wraps = self.sampling.period > 0.0
        round_again = wraps & (length + largest - least >= self.sampling.period)
        rotates = np.zeros(len(low), bool)
        for first in self.sampling.rotations:
            rotates[first : first + 3] = True
        narrow = ~(round_again | rotates)
        low[narrow] = np.where(wraps, least, np.clip(least, low, high))[narrow]
        high[narrow] = np.where(wraps, largest, np.clip(largest, low, high))[narrow]
        return Sources.of(self.sampling._replace(lower=low, width=high - low), self.roams, self.around)


@memoized
def sources_of(group: PlanningGroup) -> Sources:
    """The box that samples of a group fill."""
    endless = ~np.isfinite(group.upper - group.lower)
    return _alike_sources(group, group.chart(group.q_origin)[endless].tobytes() if endless.any() else b"")


@memoized_for_alike
def _alike_sources(group: PlanningGroup, origins: bytes) -> Sources:
    """The same, with the values of the coordinates without limits where the group's chart starts, in order."""
    lower, upper, period = group.lower.copy(), group.upper.copy(), group.periods.astype(np.float32)
    lengths, rotations = np.zeros(group.nv, bool), []
    for joint in group.joints:
        if joint.kind in TRANSLATION:
            lengths[joint.idx_v : joint.idx_v + joint.nv][TRANSLATION[joint.kind]] = True
        if joint.kind in ROTATION:
            rotations.append(joint.idx_v + ROTATION[joint.kind].start)
    endless, origin = ~np.isfinite(upper - lower), np.frombuffer(origins)
    reach = np.where(lengths, ROAM, np.where(group.winds, WIND, np.pi))
    lower[endless], upper[endless] = origin - reach[endless], origin + reach[endless]
    with np.errstate(divide="ignore"):
        frequency = np.where(period > 0.0, 1.0 / period, 0.0).astype(np.float32)
    vectors = np.array(rotations, np.int64)
    lower, upper, reach = lower / group.units, upper / group.units, reach / group.units
    steps, units = _steps(group.nv + 1), group.units.astype(np.float32)
    sampling = Sampling(steps, lower, upper - lower, period, frequency, units, len(vectors), vectors)
    roams = np.flatnonzero(endless & (lengths | group.winds))
    return Sources.of(sampling, roams, reach[roams])


def _steps(count: int) -> np.ndarray:
    """Steps of the additive recurrence that fills a box of so many sides evenly (M. Roberts 2018).

    They are the powers of 1 / g, where g > 1 solves g^(n + 1) = g + 1.
    """
    g = 2.0
    for _ in range(64):
        g = (1.0 + g) ** (1.0 / (count + 1.0))
    steps: np.ndarray = g ** -np.arange(1.0, count + 1.0)
    return steps
