"""The numbers of inverse kinematics, each with what chose it; `tools/bench ik` measures them.

Where it says *unrecorded* nobody wrote down how a number was chosen.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchSettings:
    """Of the search for configurations that reach a pose.

    Attributes:
        aim: The middle part of a tolerance that is aimed at, so that an approach from outside ends inside. Unrecorded.
        round: Random starts of a round. Unrecorded.
        first_round: The same of the first rounds where one solution is asked for. Unrecorded.
        large_round: The same where nothing was accepted for so many: poses in narrow places need many starts. The value
            is unrecorded.
        choice: Accepted solutions for each that is asked for, from which those farthest apart are chosen. Unrecorded.
        most_unreached: Random starts after which a pose counts as unreachable. With it all of 1000 reachable poses of
            a Panda are solved.
        most_rejected: The same after which it counts as reachable only by what isn't accepted. Unrecorded.
        most_per_solution: The same for each solution asked for, where there are some. Unrecorded.
        most_kept: Distinct solutions that are kept of those not accepted: they tell what stands in the way.
        why_starts: Random starts for each question that is asked after a failure. Unrecorded.
        why_halvings: How often half a turn is halved to find the nearest orientation in reach: to 0.7 degrees.
    """

    aim: float = 0.9
    round: int = 64
    first_round: int = 16
    large_round: int = 512
    choice: int = 2
    most_unreached: int = 256
    most_rejected: int = 1024
    most_per_solution: int = 64
    most_kept: int = 256
    why_starts: int = 64
    why_halvings: int = 8


SEARCH = SearchSettings()
