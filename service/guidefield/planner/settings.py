"""The numbers of the story of a plan, each with what chose it.

Where it says *unrecorded* nobody wrote down how a number was chosen.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LeavingSettings:
    """Of motions out of a contact at the start.

    Attributes:
        slight: A contact deeper than this is not slight [m]: what the page about the certificate promises.
        apart: Distance that what touched keeps in the end, at least [m]. Unrecorded.
        lengths: Of the motions that are tried, short ones first [rad or m]. Unrecorded.
        directions: That are tried with each length. Unrecorded.
        closer: A distance that becomes smaller by less has not become smaller [m]: how far off Coal's answers may be.
        samples: Places on the motion where what touches is measured. Unrecorded.
    """

    slight: float = 0.01
    apart: float = 1e-3
    lengths: tuple[float, ...] = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32)
    directions: int = 48
    closer: float = 1e-6
    samples: int = 24


LEAVING = LeavingSettings()


@dataclass(frozen=True)
class GoalSettings:
    """Of the configurations that are looked for where the goal is a pose.

    Attributes:
        solutions: Configurations for which a connection looks at once. Unrecorded.
        candidates: From which those next to the start in time are chosen. With them motions of a Panda to poses are a
            tenth faster. The number is unrecorded.
        starts: Descents that begin about the problem's start, for these. Unrecorded.
        spread: How far about it, as a standard deviation [rad, or the group's unit of length]. Unrecorded.
        apart: Chosen ones differ by this at least in some coordinate [rad, or the unit of length]. Unrecorded.
        grazing: What they keep from obstacles beyond the clearance asked for, if there are such [m]: a certificate
            isn't stopped by grazing then. Unrecorded.
        most_starts: Starts from which a configuration that is free is looked for. Unrecorded.
        at_once: Of configurations that are given so many are judged before it is asked whether there is time: it takes
            some milliseconds.
    """

    solutions: int = 8
    candidates: int = 64
    starts: int = 128
    spread: float = 0.7
    apart: float = 0.3
    grazing: float = 1e-3
    most_starts: int = 8192
    at_once: int = 100


GOALS = GoalSettings()


@dataclass(frozen=True)
class StraightWaySettings:
    """Of the straight ways between guide planes that take the place of steps.

    Attributes:
        margin: Distance that they keep from obstacles beyond the clearance asked for [m]. A choice: less than what the
            optimiser keeps, so that it has to push little.
    """

    margin: float = 0.03


STRAIGHT_WAYS = StraightWaySettings()


@dataclass(frozen=True)
class MeasuringSettings:
    """Of the figures of a motion. What isn't told otherwise is a choice: it decides what a figure means.

    Attributes:
        length_steps: Chords by which the length of a way is measured, at least. Unrecorded.
        length_share: Pieces are divided on where their lengths by chords and by chords twice as long differ by more,
            all together, than this share of the whole. The messages promise lengths to a share of 1e-4; of the public
            problems' motions they were off by 3e-7 at most.
        length_levels: So often at most: a piece is 1000 times shorter by then, and so is what is missing.
        spacing: Joint distance between samples of the clearance [rad or m].
        most_samples: Samples at most.
        samples_a_second: Among obstacles that move there are at least so many [Hz], within the most.
        fewer: The mean is over one sample in so many; the smallest distances are looked for from there.
        end_stretch: Joint distance at each end that the inner clearance leaves out [rad or m].
        many: Times a knot at which it is looked how far has been travelled. Unrecorded.
        most_many: Such times at most. Unrecorded.
        finer: Times between two close ones at which it is looked when exactly a distance has been travelled.
            Unrecorded.
        last: For how long the smallest distances may still be looked for when time is up or the run is ended [s]. An
            answer may come 50 ms late: a certificate, the layout of what is measured and the reply need the rest.
    """

    length_steps: int = 100
    length_share: float = 5e-5
    length_levels: int = 10
    spacing: float = 0.05
    most_samples: int = 100
    samples_a_second: float = 10.0
    fewer: int = 3
    end_stretch: float = 0.3
    many: int = 20
    most_many: int = 100_000
    finer: int = 100
    last: float = 0.01


MEASURING = MeasuringSettings()
