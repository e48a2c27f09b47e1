"""Why no connection was found, as far as that can be known: ends that can't be left, a joint with no way round."""

from __future__ import annotations

import numpy as np

from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.planner.connect.settings import TREE
from guidefield.planner.connect.tree_search import FoundPath
from guidefield.robot.model.chart import ANGLE
from guidefield.robot.model.spaces import ChartPoint, ChartPoints

FEW = 0.01
"""An end is hard to get away from if its tree has less configurations than this share of the motions tried there."""


def no_way(
    lanes: BatchCollision, start: ChartPoint, goals: ChartPoints, resolution: float, clearance: float
) -> str | None:
    """Why a group of one coordinate can't get to any goal, or None where it can or has several coordinates.

    Whatever it does, it passes what is between; so one sample in contact on each way is proof.

    Args:
        lanes: Robot and obstacles.
        start: Chart point, shape (nv,).
        goals: Chart points, shape (m, nv), each no more than half a turn away if it wraps.
        resolution: Samples of a motion per length in the chart [1/rad or 1/m].
        clearance: What to keep from obstacles [m].
    """
    group = lanes.world.group
    if group.nv != 1:
        return None
    joint, ways = group.joints[0], list(goals)
    round_again = joint.kind in ANGLE
    if round_again:
        ways += [goal - 2.0 * np.pi * np.sign(goal - start) for goal in goals]
    if any(lanes.free_until(np.array([start, end]), resolution, clearance) for end in ways):
        return None
    which = "either way round" if round_again else "on the only way"
    return f"joint {joint.name} can't get to the goal: {which} it comes to what it must not touch"


def why_not(found: FoundPath, goals: int, *, in_time: bool) -> str:
    """Why a search ended without a path, for a person.

    Args:
        found: What it came to.
        goals: How many goals it had.
        in_time: Whether it ended because time was up.
    """
    names = "start", "goal" if goals == 1 else "goals"
    if found.enclosed is not None:
        name, tried = names[found.enclosed], found.tried[found.enclosed]
        return f"the {name} can't be left: none of {tried} motions out of it is free, and no shorter one that was tried"
    start, goal = found.sizes
    ended = "in time" if in_time else f"in {TREE.most_motions} motions, the most that a search takes"
    message = (
        f"no connection was found {ended}: {found.motions} motions were judged, and the trees from the {names[0]} and"
        f" the {names[1]} have {start} and {goal} configurations"
    )
    narrow = int(np.argmin(np.array(found.sizes) / np.maximum(found.tried, 1)))
    if found.sizes[narrow] < FEW * found.tried[narrow]:
        verb = "are" if narrow == 1 and goals > 1 else "is"
        message += f"; the {names[narrow]} {verb} hard to get away from: {found.tried[narrow]} motions were tried there"
    return message
