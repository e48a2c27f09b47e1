"""Which bodies may be near a group of points, remembered as long as the group hasn't moved far.

A motion is looked at again and again, and moves little from one time to the next. The bodies within reach
and a margin of where a group's ball was hold all those within reach of where it is, as long as the ball's centre has
moved by no more than the margin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from guidefield.kernels.barrier.sampled_robot import SampledRobot, Workspace
from guidefield.kernels.distance.distance import DistanceTables, bodies_near
from guidefield.kernels.distance.triangle_distance import box_gap_squared
from guidefield.kernels.jit.fields import BlocksOut, IndexBlocksOut, IndexRowsOut, numba_type
from guidefield.kernels.jit.no_refcount import uncounted

MARGIN = 0.04
"""How far a group may move before bodies are looked for anew [m]."""

MOST = 24
"""With more bodies about it than this, a group looks for them anew each time."""


class NearBodies(NamedTuple):
    """What is remembered of s configurations of a motion, by group; overwritten by every look at them.

    Attributes:
        centres: Where each group's ball was when bodies were looked for, shape (s, g, 3) [m].
        counts: How many there were, shape (s, g); -1 where nothing is remembered.
        bodies: Their indices, shape (s, g, `MOST`).
    """

    centres: BlocksOut
    counts: IndexRowsOut
    bodies: IndexBlocksOut


NEAR_BODIES = numba_type(NearBodies)


def nothing_remembered(configurations: int, groups: int) -> NearBodies:
    """Of so many configurations and groups."""
    return NearBodies(
        np.zeros((configurations, groups, 3)),
        np.full((configurations, groups), -1),
        np.zeros((configurations, groups, MOST), np.int64),
    )


@uncounted
def bodies_that_count(robot: SampledRobot, tables: DistanceTables, g: int, reach: float, work: Workspace) -> int:
    """How many bodies that count may be within reach of a group; the first of the candidates are they."""
    x, y, z = work.centres[g, 0], work.centres[g, 1], work.centres[g, 2]
    near, count = bodies_near(x, y, z, robot.balls[g, 3] + reach, tables, work.candidates), 0
    for k in range(near):
        if not robot.ignored[g, tables.obstacles[work.candidates[k]]]:
            work.candidates[count] = work.candidates[k]
            count += 1
    return count


@uncounted
def remembered_bodies(
    robot: SampledRobot, tables: DistanceTables, s: int, g: int, reach: float, near: NearBodies, work: Workspace
) -> int:
    """The same of configuration s, for a reach that is the same each time; looks for them where it has to."""
    x, y, z = work.centres[g, 0], work.centres[g, 1], work.centres[g, 2]
    dx, dy, dz = x - near.centres[s, g, 0], y - near.centres[s, g, 1], z - near.centres[s, g, 2]
    if near.counts[s, g] < 0 or dx * dx + dy * dy + dz * dz > MARGIN * MARGIN:
        found = bodies_that_count(robot, tables, g, reach + MARGIN, work)
        near.counts[s, g] = found if found <= MOST else -1
        near.centres[s, g, 0], near.centres[s, g, 1], near.centres[s, g, 2] = x, y, z
        for k in range(min(found, MOST)):
            near.bodies[s, g, k] = work.candidates[k]
        if found > MOST:
            return found
    count, far = 0, (robot.balls[g, 3] + reach) ** 2
    for k in range(near.counts[s, g]):
        body = near.bodies[s, g, k]
        if box_gap_squared(x, y, z, tables.boxes, body) < far:
            work.candidates[count] = body
            count += 1
    return count
