"""Where along a path the robot can be when, among obstacles that move: cells of the path by slices of time."""

from __future__ import annotations

import math

import numpy as np

from guidefield.deadline import Deadline
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.schedule.settings import SCHEDULE
from guidefield.planner.schedule.slices import Slices
from guidefield.robot.group.group import PlanningGroup


class Occupancy:
    """Which cells of a path are free in which slices of time; made as far as it is asked for.

    Cells are of equal length by the group's metric; of a motion too short for that, of equal time.

    Args:
        group: Whose joints move.
        motion: A motion along the path, from rest to rest.
        slices: The robot among what moves.
        leave_by: Until when the start is free, for certain, and not after [s].
        arrive_from: From when on the end stays free, for certain, and not before [s].
        free_at_rest: Whether the whole path is certified among the obstacles once they have come to rest.
    """

    def __init__(
        self,
        group: PlanningGroup,
        motion: Trajectory,
        slices: Slices,
        leave_by: float,
        arrive_from: float,
        *,
        free_at_rest: bool,
    ) -> None:
        self._times = np.linspace(motion.times[0], motion.times[-1], SCHEDULE.fine * len(motion.times) + 2)
        way = np.linalg.norm(np.diff(motion.evaluate(self._times)[0], axis=0) / group.units, axis=1)
        travelled = np.r_[0.0, np.cumsum(way)]
        self.count = int(np.clip(math.ceil(travelled[-1] * SCHEDULE.resolution) + 1, 3, SCHEDULE.most_cells))
        along = travelled / travelled[-1] if travelled[-1] > 0.0 else np.linspace(0.0, 1.0, len(travelled))
        self._cells = along * (self.count - 1)
        self.at = np.interp(np.arange(self.count), self._cells, self._times)
        self._zs = motion.evaluate(self.at)[0]
        self.slices, self.leave_by, self.arrive_from = slices, leave_by, arrive_from
        self.free_at_rest = free_at_rest
        self._rows = np.empty((0, self.count), np.uint8)
        self._taken_out: list[tuple[int, int]] = []

    def cells(self, times: np.ndarray) -> np.ndarray:
        """In which cells the motion is at its own times (k,) [s], shape (k,)."""
        cells: np.ndarray = np.round(np.interp(times, self._times, self._cells)).astype(np.int64)
        return cells

    def free(self, first: int, last: int, deadline: Deadline) -> np.ndarray | None:
        """Which cells are free in slices from one up to another, shape (last - first, cells), uint8.

        Args:
            first: The first slice.
            last: The first that isn't asked about.
            deadline: Checked before each slice that isn't known; there is no answer, None, if it has passed.
        """
        more: list[np.ndarray] = []
        for index in range(len(self._rows), last):
            if deadline.expired():
                break
            more.append(self._row(index))
        if more:
            self._rows = np.concatenate([self._rows, np.array(more, np.uint8)])
        return np.ascontiguousarray(self._rows[first:last]) if len(self._rows) >= last else None

    def take_out(self, time: float, along: float) -> None:
        """Don't be at a place again, the motion's own time [s], at a time [s]: the certificate refused it."""
        place = int(time / self.slices.length), int(self.cells(np.array([along]))[0])
        self._taken_out.append(place)
        for index in range(max(0, place[0] - 1), min(len(self._rows), place[0] + 2)):
            self._rows[index, self._about(place[1])] = 0

    def point(self, cell: int) -> np.ndarray:
        """The chart point (nv,) of a cell."""
        point: np.ndarray = self._zs[cell]
        return point

    def _about(self, cell: int) -> slice:
        """The cells from one before to one after; never the ends, whose times are known for certain."""
        return slice(max(1, cell - 1), min(self.count - 1, cell + 2))

    def _row(self, index: int) -> np.ndarray:
        """Which cells are free in a slice, shape (cells,)."""
        if self.free_at_rest and index >= self.slices.resting_from:
            row = np.ones(self.count, np.uint8)
        else:
            row = (~self.slices.touching(index, self._zs)).astype(np.uint8)
        row[0] = (index + 1) * self.slices.length <= self.leave_by
        row[-1] = index * self.slices.length >= self.arrive_from
        for slice_index, cell in self._taken_out:
            if abs(slice_index - index) <= 1:
                row[self._about(cell)] = 0
        return row
