"""The numbers of streams, each with what chose it; distances kept are stated at size 1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WITHIN = 1e-7  # what pieces leave of each limit, so that no rounding leads beyond it; a share of the limit
RISE = 0.05  # in so long the acceleration's limit is reached where no jerk limit is given [s]


@dataclass(frozen=True)
class ClearanceRule:
    """What paths keep from what moves."""

    least: float  # from all [m]
    ahead: float  # and what each may cover in so long [s]

    def from_each(self, rates: np.ndarray, size: float) -> np.ndarray:
        """It [m], for a robot of a size, given how fast each grows for the judge, shape (k,) [m/s]."""
        return self.least * size + self.ahead * rates


@dataclass(frozen=True)
class StreamSettings:
    """How pieces are chosen."""

    # shares of the velocity limits at which the path is followed, tried in order: those of the prototype, and a slow
    # one, in which a robot comes to goals that are just free
    speeds: tuple[float, ...] = (1.0, 0.6, 0.35, 0.15, 0.05)
    in_space: float = 0.97  # a piece that is too fast in space is slowed down to such a share of its limit,
    slowed: int = 4  # so often at most. Choices
    reserve: float = 0.06  # kept beyond what is proven along the path, so that fleeing has room [s]: the prototype's
    evaluations: int = 600  # a commit that isn't judged after this many segments isn't sent: the median takes 4
    ahead: float = 0.25  # the path is aimed at so far ahead of where the robot could stand, less where slow [s]
    looked_at: float = 1.5  # so much of the path is examined in each cycle, in time at full speed [s]
    predicted: float = 0.25  # a goal is taken where something is on it now, or will be in so long [s]
    planned: float = 1.5  # so far ahead obstacles are foreseen where paths are examined and planned [s]
    # by planned paths from what moves, the least first
    kept: tuple[ClearanceRule, ...] = (ClearanceRule(0.02, 0.10), ClearanceRule(0.04, 0.25))
    # what the robot keeps from what moves where a path costs nothing but its time, on the move: about what the judge
    # wants at full speed
    going: ClearanceRule = ClearanceRule(0.03, 0.25)
    waiting: ClearanceRule = ClearanceRule(0.03, 0.12)  # the same where it waits
    # where a path ends it is enough to keep as much as is free there then, but this at least: what the judge wants of
    # who comes slowly. Of nine public runs that came too late three stood before such a goal for good
    ending: ClearanceRule = ClearanceRule(0.0, 0.05)
    widening: float = 0.4  # more is kept for each second from an end that is closer than that [m/s]
    step: float = 0.1  # of time, where it is found what paths cost [s]
    arriving: float = 2.5  # so far that is foreseen [s]
    dear: float = 100.0  # what a lack of 1 m for 1 s costs [s]: of eleven hard Pandas three were run into at 60
    stays: int = 3  # steps for which who arrives is to keep that: what comes along stops it just before else
    sides: int = 4  # this many directions to sidestep in are drawn, once;
    # others lead away from what presses on the path so far ahead [s], at such a place of it [s], each,
    aside: tuple[tuple[float, float], ...] = ((0.3, 0.0), (0.6, 0.0), (0.6, 0.4))
    pressed: float = 0.2  # from where on that counts [m];
    back: float = 0.3  # and one goes back, as from such a place of the path to its beginning [s]
    levels: int = 5  # this many sidesteps at most
    # this many states beside the path are examined for each step: planning takes 20 to 70 ms on a busy machine. One
    # without that bound found nothing of use in 3000 where all costs something
    beside: int = 100
    few: int = 32  # among more than this many obstacles fewer states are, so that it doesn't take longer;
    plain: int = 500  # and so of a robot of more than this many balls: a Tiago's 3697 among a cloud took 3.7 s
    early: float = 0.3  # a path is followed so much ahead of its times [s]: what brakes from full speed stands 0.1 s on
    lag: float = 0.1  # a path's times begin so much after it is taken over [s]. Of 28 Pandas 26 succeeded, 20 without
    gain: float = 0.1  # another path is followed if it costs less by so much [s],
    gain_share: float = 0.1  # and by this share
    again: float = 0.06  # so long after a path was taken over the next one is planned, where something moves [s]
    # it begins on the path that is followed, as far on as the robot goes by then at the speed that it has, if it is at
    # most this many times as far away from there; otherwise where it could stand. Paths of robots that didn't get on
    # began ever further ahead, until nobody had planned what led there
    on_it: float = 2.0
    resting: float = 0.004  # kept by paths from what rests [m]: half a millimetre above the floor nothing is proven
    resting_looked_at: float = 0.002  # the same where a path is examined [m]: less, or each path would be left soon
    # shares of that, tried one after the other where an end of a path is closer: a robot that cut a corner had no path
    # out of there any more
    closer: tuple[float, ...] = (1.0, 0.5, 0.25, 0.0)
    # who stands and has no piece leaves what rests if the next of these is kept then [m]. What joints may be off by
    # takes millimetres of a long arm: one of 18 joints stood 3 mm above the ground for good, where the judge wanted so
    # much and paths kept less
    leaving: tuple[float, ...] = (0.001, 0.002, 0.004, 0.008, 0.016)
    resolution: float = 10.0  # samples of paths per length in the chart [1/rad or 1/m]
    motions: int = 4000  # this many motions are judged for a tree at most
    cuts: int = 150  # this many short cuts are tried: with 60 paths have more corners, at which the robot is slow
    refused: int = 2  # after this many updates without a piece another path is planned
    near: float = 0.12  # obstacles that are predicted as close as this are fled from [m]
    foreseen: float = 0.4  # so far ahead [s]
    threat: float = 0.04  # what is foreseen nearer than this to the end of a piece, and of its path, is fled from [m],
    threatened: float = 0.6  # if the piece has at most this share of the speeds: fleeing costs time
    flights: int = 6  # directions tried for that: down the pressure, and random ones; until a cycle's time is up
    flight_speeds: tuple[float, ...] = (1.0, 0.4)  # shares of the velocity limits
    goals: int = 8  # configurations that are looked for where the goal is a pose


STREAM = StreamSettings()
