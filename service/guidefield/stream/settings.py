"""The numbers of streams, each with what chose it."""

from __future__ import annotations

from dataclasses import dataclass

WITHIN = 1e-7
"""What pieces leave of each limit, so that no rounding leads beyond it; a share of the limit."""

RISE = 0.05
"""In so long the acceleration's limit is reached where no jerk limit is given [s]."""


@dataclass(frozen=True)
class StreamSettings:
    """How pieces are chosen.

    Attributes:
        speeds: Shares of the velocity limits at which the way is followed, tried one after the other: those of the
            prototype.
        reserve: Pieces along the way keep what obstacles cover in so long beyond what is proven [s], so that what is
            left is enough to flee: the prototype's.
        evaluations: A commit that isn't judged after so many configurations isn't sent: the median takes about 15.
        ahead: The way is aimed at so far ahead of where the robot could stand, in time at full speed [s].
        looked_at: So much of the way is looked at in each cycle, in time at full speed [s].
        predicted: For which times after now obstacles are predicted where the way is looked at [s]: the prototype's.
        planned: The same where a new one is planned [s].
        grown: By how much obstacles are grown where the way is looked at [m], less where an end is closer: the
            prototype's.
        planned_grown: The same where a new one is planned [m].
        resting: What ways keep from obstacles that rest [m]: half a millimetre above the floor nothing is proven.
        resting_looked_at: What a way is looked at with then [m]: less, or each way would be left soon for another one.
        closer: Shares of that, tried one after the other where an end of a way is closer: a robot that cut a corner had
            no way out of there any more.
        spacing: Of samples along ways [rad or m].
        longest: An edge of the trees, for each root of the number of coordinates [rad or m].
        samples: So many points are drawn for a tree at most.
        cuts: So many short cuts are tried.
        refused: After so many updates without a piece another way is planned.
        near: Obstacles that are predicted as close as this are fled from [m].
        foreseen: So far ahead [s].
        threat: Where what is foreseen comes closer than this to where a piece along the way would end, fleeing is tried
            first [m], at any speed: of four Pandas that were run into at rest where it was tried at 0.35 of the speeds
            and below, none was any more. It takes longer.
        flights: Directions tried for that: down the pressure, and random ones; as many as a cycle has time for.
        flight_speeds: Shares of the velocity limits.
        goals: Configurations that are looked for where the goal is a pose.
    """

    speeds: tuple[float, ...] = (1.0, 0.6, 0.35, 0.15)
    reserve: float = 0.06
    evaluations: int = 600
    ahead: float = 0.25
    looked_at: float = 1.5
    predicted: tuple[float, ...] = (0.0, 0.25)
    planned: tuple[float, ...] = (0.0, 0.25, 0.5)
    grown: float = 0.04
    planned_grown: float = 0.10
    resting: float = 0.004
    resting_looked_at: float = 0.002
    closer: tuple[float, ...] = (1.0, 0.5, 0.25, 0.0)
    spacing: float = 0.1
    longest: float = 0.5
    samples: int = 1000
    cuts: int = 60
    refused: int = 2
    near: float = 0.12
    foreseen: float = 0.4
    threat: float = 0.04
    flights: int = 6
    flight_speeds: tuple[float, ...] = (1.0, 0.4)
    goals: int = 8


STREAM = StreamSettings()
