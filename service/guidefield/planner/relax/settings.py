"""The numbers of the relaxation, each with what chose it.

"Problems" are 70 public ones of a Panda, ten of each set, on which the barrier was tuned, with 70 others to try it on
(service/docs/algorithm.md, "Relax"). Where it says *unrecorded* nobody wrote down how a number was chosen.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RelaxationSettings:
    """Of the descent of a chain of waypoints.

    Attributes:
        segment: Length of a segment [rad or m]. Problems: with 16 segments 83 % of the paths keep as much as their
            ends, with 32 and with 64 94 %, these in 1.6 times the time. How the length came of that is unrecorded.
        finer: Segments of a path that is relaxed again, as a share of the usual ones. Unrecorded.
        least_segments, most_segments: At least and at most so many. Unrecorded.
        most_iterations: Steps that are tried at most, unless the problem says how many. Problems: 16 to 19 did,
            settled more finely.
        settled: A step that lowers J by less than this share brings little; two in a row end it. Unrecorded.
        shrunk: When its length has fallen to this share, the path is spread anew, over fewer waypoints and with the new
            L. Unrecorded.
        end_segment: Segments next to waypoints that stay are cut to this length in the end [rad or m]. The barrier
            drives their other waypoints away, and through a long segment the spline would swing where the clearance is
            least: on Fetch it took up to 6 mm of 15.
        eagerness: A step is taken 1 + this times the share by which the last one lowered J. Next to a pole Newton's
            steps are too short: for 1/d^3 each brings a quarter of the distance only. Its size is unrecorded.
        first_damping, least_damping, hopeless_damping: Of a step, in units of the stretch energy's stiffness.
            Unrecorded.
        stretch: Stretch energy of evenly spaced waypoints: it weighs length against the barrier alike in short and long
            paths. Unrecorded.
        largest_step: Most that a joint of a waypoint moves in one step [rad, or the group's unit of length].
            Unrecorded.
    """

    segment: float = 0.14
    finer: float = 0.5
    least_segments: int = 16
    most_segments: int = 96
    most_iterations: int = 60
    settled: float = 1e-2
    shrunk: float = 0.75
    end_segment: float = 0.1
    eagerness: float = 2.0
    first_damping: float = 1.0
    least_damping: float = 1e-6
    hopeless_damping: float = 1e8
    stretch: float = 0.5
    largest_step: float = 0.3


RELAXATION = RelaxationSettings()


@dataclass(frozen=True)
class BarrierSettings:
    """Of what the relaxation keeps away from.

    Attributes:
        range: Of the barrier [m]. Problems: 50 to 60 mm keep 34 to 42 mm on the way where this keeps 48; 100 to 120 mm
            keep more there, and less at the ends.
        dense: Samples on a segment that ends at a waypoint that stays: the clearance changes fastest there. Problems:
            with two, 1.4 % of the paths touched something there; with eight, none.
        ramp: So many segments away from a waypoint that stays, range and weight are the full ones. Problems, with the
            two that follow: 90 % of the paths keep as much as their ends, without 86 %.
        least_range: Share of the range at a waypoint that stays: what is that close by cannot be left.
        extra_weight: Weight on top of the full one at a waypoint that stays, against the tighter range.
        weight: Sum of the weights of all points: the problems' weight, with which the stretch energy was balanced.
        self_range: Range of the barrier between links [m]. Unrecorded.
        least_self_range: The same between links that are that close at an end of the path [m]. Unrecorded.
        coarser: One in so many of a link's points stands for all against other links. Chosen for time; the value is
            unrecorded.
        floor_share: What is nearer to obstacles than this share of what the waypoints that stay keep costs more: it is
            the bottleneck. Unrecorded.
        farthest_floor: That is at most so far from them [m]. Unrecorded; `MARGIN` is the least.
    """

    range: float = 0.08
    dense: int = 8
    ramp: float = 5.0
    least_range: float = 0.5
    extra_weight: float = 10.0
    weight: float = 100.0
    self_range: float = 0.03
    least_self_range: float = 0.004
    coarser: int = 3
    floor_share: float = 1.1
    farthest_floor: float = 0.25


BARRIER = BarrierSettings()


@dataclass(frozen=True)
class CrossingSettings:
    """Of waypoints whose tip stays on a guide plane.

    Attributes:
        on_plane: How near the inset polygon the tip is brought back [m]: far below the 0.1 mm of a guided path.
        at_edge: A tip this near the inset polygon's edge is at it [m]. Above `on_plane`; else unrecorded.
        corrections: Newton steps by which the tip is brought back; two or three do.
    """

    on_plane: float = 1e-7
    at_edge: float = 1e-6
    corrections: int = 10


CROSSING = CrossingSettings()
