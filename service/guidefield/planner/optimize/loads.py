"""The loads of a motion, torques and speeds in space as shares of their limits, at samples of its optimisation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from guidefield.kernels.optimize.load_penalty import LoadModel
from guidefield.kernels.optimize.speed_loads import expand_speed_loads, largest_speed_loads
from guidefield.kernels.optimize.torque_loads import expand_torque_loads, largest_torque_loads
from guidefield.memo import memoized_by_value
from guidefield.planner.motion.bspline import BSpline, basis, basis_bends, basis_slopes
from guidefield.planner.task.effort import EffortLimit
from guidefield.planner.task.motion_limits import CartesianLimit, MotionLimit
from guidefield.read_only import ReadOnly, read_only

# By 30 public problems of a Panda with 3 kg in the hand, at 15 rad/s² and 500 rad/s³.
TORQUE_SAMPLES = 128  # about this many on a motion, two on each piece at least. With 64 motions are 2 % slower
# the same where no torques are limited, one on each piece at least. With 128 motions take as long
SPEED_SAMPLES = 64
# share of its limit up to which a load costs nothing. With 0.9 and 0.97 motions are 0.5 and 1 % slower
FREE_SHARE = 0.95
# share from which on a load is linearized. With 0.4 there are 4 % fewer looks, with 0.75 and 0.9 11 and 36 % more; as
# long as only what is beyond `FREE_SHARE` was linearized there were three times as many
LINEARIZE_ABOVE = 0.6


class _Memory(NamedTuple):
    """Memory for the loads of a look: the largest, and the linearized ones as `LoadModel` has them."""

    largest: np.ndarray  # at each sample, by limit, shape (l, pieces s)
    pieces: np.ndarray
    samples: np.ndarray
    values: np.ndarray
    slopes: np.ndarray


@memoized_by_value(16)
def no_loads(nv: int) -> LoadModel:
    """No loads of a motion of a given number of coordinates."""
    none = np.empty((0, 3, 4)), np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0), np.empty((0, 3, nv))
    read_only(*none)
    return LoadModel(0, 0, 0.0, FREE_SHARE, *none)


@dataclass(frozen=True, eq=False)
class LoadSamples(ReadOnly):
    """The samples at which a motion's loads are examined, with memory for two looks, by turns."""

    effort: EffortLimit | None
    speeds: tuple[CartesianLimit, ...]
    bases: np.ndarray  # on a piece of length 1, shape (s, 3, 4)
    memory: tuple[_Memory, _Memory]
    seen: tuple[_Memory, _Memory]  # the same, read-only

    @classmethod
    def of(cls, limits: Sequence[MotionLimit], pieces: int, nv: int) -> LoadSamples:
        """Of a motion of a given number of pieces and coordinates."""
        effort = next((one for one in limits if isinstance(one, EffortLimit)), None)
        speeds = tuple(one.sketched for one in limits if isinstance(one, CartesianLimit))
        # accelerations are largest at the ends of pieces: one sample in the middle would miss torques there
        count = max(2, round(TORQUE_SAMPLES / pieces)) if effort else max(1, round(SPEED_SAMPLES / pieces))
        at = (np.arange(count) + 0.5) / count
        bases = np.ascontiguousarray(np.stack([basis(at), basis_slopes(at), basis_bends(at)], axis=1))
        largest = np.empty(((effort is not None) + len(speeds), pieces * count))
        most = pieces * count * ((len(effort.limited) if effort else 0) + 3 * len(speeds))
        memory = [
            _Memory(
                largest, np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most), np.empty((most, 3, nv))
            )
            for _ in range(2)
        ]
        seen = [_Memory(*(array.view() for array in one)) for one in memory]
        read_only(bases, *seen[0], *seen[1])
        return cls(effort, speeds, bases, (memory[0], memory[1]), (seen[0], seen[1]))

    def mean(self, spline: BSpline) -> float:
        """The mean load of a motion, by the limit by which it is largest."""
        self.measure(spline)
        return float(self.memory[0].largest.mean(axis=1).max(initial=0.0))

    def weight(self, weight: float) -> float:
        """Weight of each sample's half square, so that their sum is `weight` times their mean."""
        return weight / float(self.memory[0].largest.shape[1])

    def measure(self, spline: BSpline) -> float:
        """Look at the loads of a motion; return the sum of squares beyond `FREE_SHARE`."""
        total, rows = 0.0, iter(self.memory[0].largest)
        where = spline.points, spline.step, self.bases, FREE_SHARE
        if self.effort is not None:
            total += largest_torque_loads(self.effort.tree, self.effort.limits, *where, next(rows))
        for one in self.speeds:
            total += largest_speed_loads(one.body, one.speed, *where, next(rows))
        return total

    def linearize(self, spline: BSpline, turn: int, weight: float) -> LoadModel:
        """Linearize the loads that were measured last, into one of the two memories, with a weight of their mean."""
        count, (largest, *memory) = 0, self.memory[turn]
        rows = iter(largest)
        where = spline.points, spline.step, self.bases
        if self.effort is not None:
            tree, most = self.effort.tree, self.effort.limits
            count = expand_torque_loads(tree, most, *where, next(rows), LINEARIZE_ABOVE, *memory)
        torques = count
        for one in self.speeds:
            count = expand_speed_loads(one.body, one.speed, *where, next(rows), LINEARIZE_ABOVE, count, *memory)
        return LoadModel(torques, count, self.weight(weight), FREE_SHARE, self.bases, *self.seen[turn][1:])
