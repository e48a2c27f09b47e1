"""The numbers of curves and their timing, each with what chose it; `tools/bench timing` measures them.

Where it says *unrecorded* nobody wrote down how a number was chosen.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SplineSettings:
    """Of the spline through waypoints.

    Attributes:
        repeated: A waypoint at most this far from the one before is the same [rad or m]: a nanometre at a metre's
            reach.
        rounding: A curve that is beyond a limit by no more than this keeps it [rad or m].
    """

    repeated: float = 1e-9
    rounding: float = 1e-12


SPLINE = SplineSettings()


@dataclass(frozen=True)
class TimingSettings:
    """Of the fastest motion along a curve.

    The steps of its grid count in r, with (dr/ds)^2 = 1 + (weight |q'| / its mean)^2.

    Attributes:
        arc_length_weights: Weights that are tried on the first grid: the spline's own parameter, and nearly the arc
            length. Waypoints unevenly spaced on a straight line cost up to twice the time by the former; where a curve
            turns back on itself, or nearly, the latter's derivatives jump, which costs some percent.
        steps_a_piece: Of the first grid, in each piece of the spline .. Unrecorded.
        least_steps: .. and at least so many in all of it. Unrecorded.
        acceleration_change: A step of it is divided if some joint's acceleration changes over it by more than this
            share of its limit: d^2r/dt^2 is constant over a step, so the end that allows less of it decides. Evenly
            spaced waypoints hardly need that. Unrecorded.
        most_parts: Into at most so many. Unrecorded.
        shortest_step: No controller follows shorter steps, and their accelerations, second differences of positions,
            would be a matter of rounding [s].
        shortest_share: Steps of a motion that lasts no longer than a few of them are at least this share of it.
        small_excess: Limits are tightened, where they were exceeded, until the excess is this small .. Unrecorded.
        most_rounds: .. or for so many rounds. Unrecorded.
    """

    arc_length_weights: tuple[float, float] = (0.0, 300.0)
    steps_a_piece: int = 3
    least_steps: int = 64
    acceleration_change: float = 0.1
    most_parts: int = 4
    shortest_step: float = 2e-4
    shortest_share: float = 1.0 / 16.0
    small_excess: float = 1.002
    most_rounds: int = 4


TIMING = TimingSettings()


@dataclass(frozen=True)
class JerkSettings:
    """Of timing with jerk limits.

    Attributes:
        windows: That are tried, as shares of the optimal duration. Unrecorded.
        accelerations: Shares of the acceleration limits that are tried: what changes slowly doesn't become large.
            Unrecorded.
        pieces: Of the motion in a window. Unrecorded.
        most_pieces: In all. Unrecorded.
        samples: By which the average over a window is taken, for each piece. Unrecorded.
    """

    windows: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2, 0.35, 0.6)
    accelerations: tuple[float, ...] = (1.0, 0.5, 0.25)
    pieces: int = 6
    most_pieces: int = 320
    samples: int = 8


JERK = JerkSettings()
