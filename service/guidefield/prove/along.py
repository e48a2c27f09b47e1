"""The smallest distances along a motion and at some of its times: by kernels, or by Coal where those can't tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guidefield.deadline import UNLIMITED, Deadline
from guidefield.prove.asked import Asked
from guidefield.prove.by_coal import ByCoal
from guidefield.prove.by_kernels import ByKernels
from guidefield.prove.places import Surveyor
from guidefield.prove.smallest import Smallest
from guidefield.read_only import ReadOnly


@dataclass(frozen=True, eq=False)
class Along(ReadOnly):
    """What was found along a motion.

    Attributes:
        obstacle: The smallest distance from obstacles within each of the spans that were asked for.
        own: The smallest distance of the robot to itself, all along.
        distances: The smallest distance from obstacles at each of the times, shape (k,) [m]; infinite without one.
    """

    obstacle: list[Smallest]
    own: Smallest
    distances: np.ndarray


def smallest_along(
    surveyor: Surveyor,
    times: np.ndarray,
    spans: Sequence[tuple[float, float]],
    deadline: Deadline = UNLIMITED,
) -> Along:
    """Find the smallest distances along a motion, at most `TOLERANCE` too large.

    Args:
        surveyor: The robot among obstacles, and the motion.
        times: At which the distance from obstacles is asked for as well, in order, the first and the last of the motion
            among them, shape (k,) [s].
        spans: Within which the smallest distance from obstacles is asked for, the whole motion first [s].
        deadline: Ends the search.
    """
    asked = Asked(surveyor, times, spans, deadline)
    kernels, coal = ByKernels(asked), ByCoal(asked)
    obstacles, own = kernels.found() if kernels.serve else (None, None)
    if obstacles is None:
        obstacles = coal.obstacles()
    elif surveyor.worlds.moving.scene.moves:
        obstacles = coal.obstacles_that_move(obstacles)
    return Along(obstacles.smallest, coal.own() if own is None else own, obstacles.distances)
