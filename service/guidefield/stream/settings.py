"""The numbers of streams, each with what chose it; distances kept are stated at size 1.

They decide which motions are tried and sent, `resting` also which goals are refused: the judge (`commit.py`) proves
each motion whatever they are; `RISE` makes its limit of jerk. With other numbers kept journals replay to other pieces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WITHIN = 1e-7  # share of limits of rates, distance from those of position [rad or m], left free; below `GOAL_TOLERANCE`
RISE = 0.05  # time in which the acceleration reaches its limit where no jerk limit is given: messages promise it [s]


@dataclass(frozen=True)
class ClearanceRule:
    """The distance that paths keep from moving obstacles."""

    least: float  # from all [m]
    ahead: float  # and the distance that each may cover in this time [s]

    def from_each(self, rates: np.ndarray, size: float) -> np.ndarray:
        """The distance from each [m], for a robot of a size, by their growth for the judge, shape (k,) [m/s]."""
        return self.least * size + self.ahead * rates


@dataclass(frozen=True)
class StreamSettings:
    """The numbers by which pieces are chosen, and paths planned."""

    # shares of the velocity limits at which the path is followed, tried in order: those of the prototype, and a slow
    # one, by which a robot comes to goals that are just free
    speeds: tuple[float, ...] = (1.0, 0.6, 0.35, 0.15, 0.05)
    in_space: float = 0.97  # share of its limit in space to which a piece that is too fast is slowed down. A choice
    slowed: int = 4  # times that it is slowed down at most. A choice
    # time for which obstacles grow beyond what is proven along the path, so that fleeing has room [s]: the prototype's
    reserve: float = 0.06
    evaluations: int = 600  # segments after which a commit isn't sent, or `judged` unproven: the median takes 4
    ahead: float = 0.25  # distance on the path from where the robot could stand to the target, at full speed [s]
    looked_at: float = 1.5  # part of the path that is examined in each cycle, in time at full speed [s]
    predicted: float = 0.25  # a goal is taken if something is on it now, or will be after this time [s]
    planned: float = 1.5  # time for which obstacles are foreseen where paths are examined and planned [s]
    # distances of planned paths from moving obstacles, each tried, the least first
    kept: tuple[ClearanceRule, ...] = (ClearanceRule(0.02, 0.10), ClearanceRule(0.04, 0.25))
    # distance from moving obstacles from which on a path costs nothing but its time, on the move: about that of the
    # judge at full speed
    going: ClearanceRule = ClearanceRule(0.03, 0.25)
    waiting: ClearanceRule = ClearanceRule(0.03, 0.12)  # the same while it waits
    # least distance at the end of a path, where else as much is kept as is free there then: that of the judge from slow
    # obstacles. Of nine public runs that came too late three stood before such a goal for good
    ending: ClearanceRule = ClearanceRule(0.0, 0.05)
    widening: float = 0.4  # rise of the distance kept, from a closer end on [m/s]
    step: float = 0.1  # step of time of a schedule [s]
    arriving: float = 2.5  # time for which obstacles are foreseen there [s] (docs/algorithm.md)
    dear: float = 100.0  # cost of a lack of 1 m for 1 s [s]: with 60 three of eleven hard Pandas were run into
    stays: int = 3  # steps at the end for which the distance counts: else a passing obstacle stops it just before
    sides: int = 4  # directions to sidestep in that are drawn, once
    # further ones lead away from the obstacles near the path: time ahead [s], and place on the path [s], of each
    sidesteps: tuple[tuple[float, float], ...] = ((0.3, 0.0), (0.6, 0.0), (0.6, 0.4))
    pressed: float = 0.2  # distance below which obstacles count for these [m]
    back: float = 0.3  # one leads back, as from this place of the path to its beginning [s]
    levels: int = 5  # sidesteps in one direction at most
    # states beside the path that are examined for each step: planning takes 20 to 70 ms on a busy machine. Without
    # this bound nothing of use was found in 3000 where all costs something
    beside: int = 100
    few: int = 32  # obstacles; among more of them fewer states are examined, so that it doesn't take longer
    plain: int = 500  # balls of a robot; with more fewer states, too: a Tiago's 3697 among a cloud took 3.7 s
    early: float = 0.3  # a path is followed ahead of its times by this [s]: braking from full speed takes 0.1 s
    lag: float = 0.1  # time from taking a path over to its first time [s]. Of 28 Pandas 26 succeeded, 20 without
    gain: float = 0.1  # another path is followed if its cost is less by this [s] ..
    gain_share: float = 0.1  # .. and by this share
    again: float = 0.06  # time from taking a path over to planning the next one, if something moves [s]
    # that one begins on the path that is followed, where the robot is by then at its speed, if the robot is at most
    # this many times as far away from there; else where it could stand. Paths of robots that didn't get on began ever
    # further ahead, until nobody had planned what led there
    on_it: float = 2.0
    # distance of paths, and of goals, from what rests [m] (docs/stream.md): half a millimetre above the floor nothing
    # is proven
    resting: float = 0.004
    resting_looked_at: float = 0.002  # the same where a path is examined [m]: less, or each path would be left soon
    # shares of that, tried one after the other where an end of a path is closer: a robot that cut a corner had no path
    # out of there any more
    closer: tuple[float, ...] = (1.0, 0.5, 0.25, 0.0)
    # distances from what rests [m]: a robot that stands without a piece leaves what rests if it keeps the next of them
    # then. Deviations of joints are millimetres of a long arm: one of 18 joints stood 3 mm above the ground for good,
    # where the judge keeps as much and paths kept less
    leaving: tuple[float, ...] = (0.001, 0.002, 0.004, 0.008, 0.016)
    resolution: float = 10.0  # samples of paths per length in local coordinates [1/rad or 1/m]
    motions: int = 4000  # motions that a tree checks at most
    cuts: int = 150  # shortcuts that are tried: with 60 paths have more corners, at which the robot is slow
    refused: int = 2  # updates without a piece after which another path is planned
    near: float = 0.12  # distance below which a robot without a piece flees from predicted obstacles [m]
    foreseen: float = 0.4  # time for which they are predicted [s]
    threat: float = 0.04  # distance from the end of a piece, and of its path, below which it flees instead [m] ..
    threatened: float = 0.6  # .. if the piece has at most this share of the speeds: fleeing costs time
    flights: int = 6  # directions of flight to draw, and commits to check for one, at most
    flight_speeds: tuple[float, ...] = (1.0, 0.4)  # shares of the velocity limits of a flight
    goals: int = 8  # configurations that are searched for where the goal is a pose


STREAM = StreamSettings()
