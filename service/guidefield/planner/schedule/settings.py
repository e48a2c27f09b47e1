"""The numbers of schedules among obstacles that move, each with what chose it; `tools/bench timed` measures them.

Where it says *a choice* nothing was measured.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ScheduleSettings:
    """Of the search for a schedule along a path."""

    rates: int = 8  # rates above 0 that a schedule may have, evenly up to 1. A choice
    changes: int = 4  # by how many of them it may change in one step at most. A choice
    braking: float = 2.0  # so much of a rate changes in a step at the acceleration limits at most. A choice
    shortest_step: float = 0.02  # a step lasts at least, and at most, so long [s]. Choices
    longest_step: float = 0.2  # together with the one above
    slice_length: float = 0.05  # obstacles are looked at in slices of time at most this long [s]. A choice
    # an obstacle that moves by more than twice this in a slice stands there more than once [m]; a choice
    finest: float = 0.01
    most_copies: int = 6  # so often at most. A choice
    most_triangles: int = 200  # a moving mesh of more stands in slices as the box about it. A choice
    most_points: int = 500  # a moving cloud of more is covered by so many larger ones. A choice
    far: float = 5.0  # how far a joint without limits slides, for the speed of half-spaces [m]. A choice
    resolution: float = 32.0  # cells of a path per length in the chart [1/rad or 1/m], as samples of a tree's motions
    most_cells: int = 1000  # cells of a path at most. A choice
    fine: int = 4  # times for each knot of a motion at which it is looked how far has been travelled. A choice
    steps_at_once: int = 16  # steps that are followed before it is asked whether time is up. A choice
    most_steps: int = 4096  # after so many steps no search goes on. A choice: four minutes of a Panda's
    most_states: int = 40_000_000  # a search keeps so many states at most, of 8 bits each. A choice
    # after all obstacles have come to rest the search goes on for so many times what the path takes, and a second. A
    # choice: what arrives then could have gone before
    slack: float = 1.5
    # shares of its limits that the path's motion uses, as stretched in time, where its rate changes: what is left of
    # them is for changes of rate. Choices, tried in order
    rooms: tuple[float, ...] = (0.97, 0.85, 0.7)
    repairs: int = 8  # how often a refused place is taken out, and a schedule looked for again. A choice
    # where what moves keeps this, and the clearance asked for, from a motion that it doesn't delay, no better one is
    # looked for [m]: the range of the optimisation's barrier
    aside: float = 0.08
    kept_slices: int = 400  # slices whose tables are kept. A choice


SCHEDULE = ScheduleSettings()


@dataclass(frozen=True)
class WaySettings:
    """Of the ways along which schedules are looked for."""

    # shares of the time until all obstacles rest, at which they are held for a way among them. A choice
    moments: tuple[float, ...] = (0.0, 0.33, 0.67)
    swept: int = 8  # moments of a motion at which each obstacle stands for a way round it. A choice
    draws: int = 3  # ways among what rests alone. A choice
    places: int = 256  # random places that are looked at, where the robot has to wait elsewhere. A choice
    # how far from the start half of them lie, as a standard deviation [rad, or the group's unit of length]. A choice
    aside: float = 0.7
    detours: int = 12  # by how many of them a way is tried. A choice
    rooms: tuple[float, ...] = (0.85,)  # as those of a schedule, where a way is but estimated. A choice
    share: float = 0.5  # of the time left for ways that a few motions find. A choice
    unhindered: float = 1.05  # a way of at most this times the time without obstacles ends the looking. A choice


WAYS = WaySettings()
