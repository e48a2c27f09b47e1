"""What motions among obstacles that move are worth: sooner and farther away is better."""

from __future__ import annotations

import numpy as np

from guidefield.planner.finish import time_path_ignoring_jerk
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.optimize.clearance_samples import better, keeps_aside
from guidefield.planner.optimize.settings import BALANCED
from guidefield.planner.task.problem import Problem
from tests.planner.schedule.test_schedule import PASSING, START, asked, ball, flight, moved

AWAY = flight([0.0, 1.0], (0.0, 3.0, 0.5), (0.0, 4.0, 0.5))


def swing(made: Problem, begin: float = 0.0) -> Trajectory:
    motion = time_path_ignoring_jerk(made, np.array([START, moved(1.2, 0.3, 0.0, 0.4, 0.0, 0.0, 0.0)]))
    return Trajectory(begin + motion.times, motion.positions, motion.velocities)


def test_what_arrives_sooner_is_better_where_nothing_is_near() -> None:
    made = asked(ball(trajectory=AWAY))
    early, late = swing(made), swing(made, 0.5)
    assert better(made, early, late, BALANCED)
    assert not better(made, late, early, BALANCED)
    assert not better(made, early, early, BALANCED)


def test_what_waits_for_something_is_better_than_what_meets_it() -> None:
    made = asked(ball(trajectory=PASSING))
    early = next(one for one in (swing(made, 0.1 * k) for k in range(25)) if not keeps_aside(made, one, 1e-3))
    late = swing(made, 2.6)
    assert better(made, late, early, BALANCED)
