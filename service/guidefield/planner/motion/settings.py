"""The numbers of curves and their timing, each with what chose it; `tools/bench timing` measures them.

Where it says *unrecorded* nobody wrote down how a number was chosen.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CurveSettings:
    """Of the curve along a path.

    Attributes:
        spacing: Of its control points, at most [rad or m]. On 100 public problems of four robots, nothing optimised:
            with 0.18 motions take 1 to 4 % longer; with 0.5 they take 1 to 4 % less, and one in six more is refused at
            first, whose certificates take longer.
        repeated: A waypoint at most this far from the one before is the same [rad or m]: a nanometre at a metre's
            reach.
    """

    spacing: float = 0.3
    repeated: float = 1e-9


CURVE = CurveSettings()


@dataclass(frozen=True)
class TimingSettings:
    """Of the fastest motion along a curve.

    Attributes:
        length_weight: Of the curve's length against its own parameter, for the steps of the grid. With 0 motions along
            a line of uneven places take up to 15 % longer; with 300 those that turn back up to 10 %.
        steps_a_piece: Of the grid, on each piece of the curve: with 6 motions round many corners take 2 % longer, with
            24 they take 1 % less and their timing twice as long ..
        least_steps: .. and at least so many in all of it. Unrecorded.
        pieces: Of the motion: the most of them; where jerk is limited, the number with which it is the shortest. With
            at most 96 motions take 1 % less; with 12 as well those within 50 rad/s³ take 5 % less,
            but are farther from the path.
        shortest_piece: No controller follows shorter ones, and their accelerations, second differences of positions,
            would be a matter of rounding [s].
    """

    length_weight: float = 300.0
    steps_a_piece: int = 10
    least_steps: int = 64
    pieces: tuple[int, ...] = (16, 24, 32, 48, 64)
    shortest_piece: float = 2e-4


TIMING = TimingSettings()
