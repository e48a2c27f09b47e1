"""What is asked about the smallest distances along a motion, and what is found of obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.prove.places import Surveyor
from guidefield.prove.smallest import Smallest
from guidefield.prove.timed_world import TimedWorld


class Asked(NamedTuple):
    """Questions about a motion.

    Attributes:
        surveyor: The robot among obstacles, and the motion.
        times: At which the distance from obstacles is asked for, in order, the first and the last of the motion among
            them, shape (k,) [s].
        spans: Within which the smallest distance from obstacles is asked for, the whole motion first [s].
        deadline: Ends the search.
    """

    surveyor: Surveyor
    times: np.ndarray
    spans: Sequence[tuple[float, float]]
    deadline: Deadline


class OfObstacles(NamedTuple):
    """What is found of obstacles.

    Attributes:
        smallest: The smallest distance from them within each of the spans.
        distances: The smallest distance from them at each of the times, shape (k,) [m]; infinite without one.
    """

    smallest: list[Smallest]
    distances: np.ndarray


def among_resting(worlds: TimedWorld) -> World:
    """The robot among those obstacles that rest, in the order in which they are among all."""
    if not worlds.moving.scene.moves:
        return worlds.moving
    rest = np.flatnonzero([one.motion is None for one in worlds.moving.scene.obstacles])
    same = len(rest) == worlds.resting.pairs.obstacles
    return worlds.resting if same else worlds.moving.among(rest)
