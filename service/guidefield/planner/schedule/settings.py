"""The numbers of schedules among obstacles that move, each with what chose it; `tools/bench timed` measures them.

Where it says *a choice* nothing was measured.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ScheduleSettings:
    """Of the search for a schedule along a path.

    Attributes:
        rates: Rates above 0 that a schedule may have, evenly up to 1. A choice.
        changes: By how many of them it may change in one step at most. A choice.
        braking: So much of a rate is changed in a step at most at the acceleration limits: a step lasts
            `braking / rates` times what the slowest joint takes to its largest velocity. A choice.
        shortest_step, longest_step: A step lasts at least, and at most, so long [s]. Choices.
        slice_length: Obstacles are looked at in slices of time at most this long [s]. A choice.
        finest: An obstacle that moves by more than twice this in a slice stands there more than once [m]; a choice.
        most_copies: So often at most. A choice.
        most_triangles: A moving mesh of more triangles stands in slices as the box about it: it is built anew for each
            slice. A choice.
        most_points: In place of a moving cloud of more points one of so many, and larger ones, stands there. A choice.
        far: How far a joint slides that has no limits, where it is asked how fast a half-space comes to the robot [m].
            A choice: what lies beyond is the certificate's to refuse.
        resolution: Cells of a path per length in the chart [1/rad or 1/m], as samples of a tree's motions.
        most_cells: Cells of a path at most. A choice.
        fine: Times for each knot of a motion at which it is looked how far has been travelled. A choice.
        steps_at_once: Steps that are followed before it is asked whether time is up. A choice.
        most_steps: After so many steps no search goes on. A choice: four minutes of a Panda's.
        most_states: A search keeps so many states at most, of 8 bits each. A choice.
        slack: After all obstacles have come to rest the search goes on for so many times what the path takes, and a
            second. A choice: what arrives then could have gone before.
        rooms: Shares of its limits that the path's motion uses, as stretched in time, where its rate changes: what is
            left of them is for changes of rate. Choices, tried in order.
        repairs: How often a place that the certificate refused is taken out, and a schedule looked for again. A choice.
        aside: Where what moves keeps this, and the clearance asked for, from a motion that it doesn't delay, no better
            one is looked for [m]: the range of the optimisation's barrier.
        kept_slices: Slices whose tables are kept. A choice.
    """

    rates: int = 8
    changes: int = 4
    braking: float = 2.0
    shortest_step: float = 0.02
    longest_step: float = 0.2
    slice_length: float = 0.05
    finest: float = 0.01
    most_copies: int = 6
    most_triangles: int = 200
    most_points: int = 500
    far: float = 5.0
    resolution: float = 32.0
    most_cells: int = 1000
    fine: int = 4
    steps_at_once: int = 16
    most_steps: int = 4096
    most_states: int = 40_000_000
    slack: float = 1.5
    rooms: tuple[float, ...] = (0.97, 0.85, 0.7)
    repairs: int = 8
    aside: float = 0.08
    kept_slices: int = 400


SCHEDULE = ScheduleSettings()


@dataclass(frozen=True)
class WaySettings:
    """Of the ways along which schedules are looked for.

    Attributes:
        moments: Shares of the time until all obstacles rest, at which they are held for a way among them. A choice.
        swept: At how many moments of a motion each obstacle stands for a way that avoids what it passes. A choice.
        draws: Ways among what rests alone. A choice.
        places: Random places that are looked at, where the robot has to wait elsewhere. A choice.
        aside: How far from the start half of them lie, as a standard deviation [rad, or the group's unit of length]. A
            choice.
        detours: By how many of them a way is tried. A choice.
        rooms: As those of a schedule, where a way is but estimated. A choice.
        share: Share of the time that is left for ways that a few motions find; the rest is for the planner among
            obstacles at rest. A choice.
        unhindered: Where a way takes no more than this times what it takes without obstacles, no other is looked for.
            A choice.
    """

    moments: tuple[float, ...] = (0.0, 0.33, 0.67)
    swept: int = 8
    draws: int = 3
    places: int = 256
    aside: float = 0.7
    detours: int = 12
    rooms: tuple[float, ...] = (0.85,)
    share: float = 0.5
    unhindered: float = 1.05


WAYS = WaySettings()
