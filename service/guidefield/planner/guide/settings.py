"""The numbers of the guided planner, each with what chose it; lengths are those at size 1.

"Scenes" are those of the thesis, by `tools/bench seed`; service/docs/algorithm.md, "Projected", has what happens
otherwise. Where it says *unrecorded* nobody wrote down how a number was chosen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class DescentSettings:
    """Of a descent of the potential while the tip keeps a constraint.

    Attributes:
        regularization: Share of the metric's mean diagonal added to it. Scenes: with less, symmetric links spin; 0.1 is
            too stiff.
        on_constraint: How near a trial has to come to the constraint [m or rad]. A tenth of
            `ApproachSettings.on_plane`.
        tolerance: It ends where a step promises, or brings, less than this share of U. Scenes: more costs half of the
            clearance, less 3 to 7 times the time.
        close: Where the robot is nearer to obstacles than this when it would end, it goes on .. [m]. Scenes: the
            blocked passage keeps 15 mm with it, 11.6 without.
        fine: .. with this tolerance: there the last thousandth of U is millimetres of clearance.
        most_steps: It ends after so many steps. Unrecorded.
        at_once: Steps between two checks of the deadline. Unrecorded.
    """

    regularization: float = 1e-2
    on_constraint: float = 1e-5
    tolerance: float = 1e-3
    close: float = 0.015
    fine: float = 1e-4
    most_steps: int = 60
    at_once: int = 20


DESCENT = DescentSettings()


@dataclass(frozen=True)
class SettlingSettings:
    """Of slide and reorient in turn, and of Univariate's rounds, on one plane.

    Attributes:
        most_rounds: At most so many. Unrecorded.
        negligible: They end where U falls by less than this share. Unrecorded.
    """

    most_rounds: int = 6
    negligible: float = 2e-3


SETTLING = SettlingSettings()


@dataclass(frozen=True)
class ApproachSettings:
    """Of the rounds of advance, slide and reorient towards a guide plane.

    Attributes:
        first_step: Length of an advance, the thesis' delta_0 [m]: a third of a link, a third of a mouth. Scenes:
            shorter ones take up to twice the time, longer ones keep less clearance.
        smallest_step: Below this an advance is given up, delta_min [m]. Unrecorded.
        guard: Share of an advance's gain that slide and reorient have to keep, 1 - beta. Unrecorded.
        on_plane: How near the plane counts as on it [m]: the tip's accuracy that the pages promise.
        short: An advance of this length is not made again with shorter ones [m]. Scenes, with `WaySettings.dips`.
        at_once: Rounds between two checks of the deadline, in one kernel. Unrecorded.
        creeping: A round gains little if it brings less than this share of what an advance may bring. Unrecorded.
        creeping_rounds: So many such rounds in a row are a standstill. Unrecorded.
    """

    first_step: float = 0.1
    smallest_step: float = 0.1 / 50
    guard: float = 0.5
    on_plane: float = 1e-4
    short: float = 0.1 / 4
    at_once: int = 4
    creeping: float = 0.1
    creeping_rounds: int = 3


APPROACH = ApproachSettings()


@dataclass(frozen=True)
class WaySettings:
    """Of the choice among ways between the same two configurations.

    Attributes:
        comfortable: A straight way that keeps this distance from obstacles is taken without comparing [m]. It spares
            time where the way is free anyway; the value is unrecorded.
        margins: Distances from obstacles by which ways are compared, the widest first [m]. Unrecorded.
        dips: A way dips that does not keep the widest of these distances that both its ends keep [m]. Scenes: with it
            Univariate keeps 46 and 17 mm in the tapered and the blocked passage.
    """

    comfortable: float = 0.02
    margins: tuple[float, ...] = (0.06, 0.03, 0.02, 0.01, 0.005)
    dips: tuple[float, ...] = (0.06, 0.045, 0.03, 0.015)


WAYS = WaySettings()


@dataclass(frozen=True)
class UnivariateSettings:
    """Of Univariate's searches along one axis.

    Attributes:
        first_turn, last_turn: A search for an angle begins with the one and ends below the other [rad]. Unrecorded.
        first_slide, last_slide: The same for a slide [m]: a quarter and a 64th of an advance. Unrecorded.
        most_steps: Of one round. Unrecorded.
    """

    first_turn: float = float(np.deg2rad(5.0))
    last_turn: float = float(np.deg2rad(0.5))
    first_slide: float = 0.025
    last_slide: float = 0.1 / 64
    most_steps: int = 4000


UNIVARIATE = UnivariateSettings()


@dataclass(frozen=True)
class TipWaySettings:
    """Of the coarse way of the tip by which guide planes are derived, and of free sections across it.

    Attributes:
        spacing: Of the grid [m]. Unrecorded.
        most_points: The grid is made coarser where it would have more. Unrecorded.
        around: How far the grid reaches beyond obstacles, start and goal [m]. Unrecorded.
        comforts: Clearance at which a way costs twice its length [m]: ways with much of it are looked for first.
            Unrecorded.
        least_ample: Clearance that counts even where an end is in a narrower tube [m]. Unrecorded.
        smoothings: How often the way is drawn straight and pushed off the obstacles. Unrecorded.
        push: Share of what is missing to free clearance by which a point of the way is pushed. Unrecorded.
        kept: No point of it keeps less than this share of the clearance that it had. Unrecorded.
        rays: By which a free section is cut. Unrecorded.
        compared_rays: By which areas are compared, and points told to be enclosed. Unrecorded.
        longest: Rays are followed no farther [m]: a plane in the open is this large. Unrecorded.
    """

    spacing: float = 0.05
    most_points: int = 2_000_000
    around: float = 0.3
    comforts: tuple[float, ...] = (0.2, 0.1, 0.05, 0.02)
    least_ample: float = 0.1
    smoothings: int = 8
    push: float = 0.3
    kept: float = 0.98
    rays: int = 24
    compared_rays: int = 12
    longest: float = 0.4


TIP_WAY = TipWaySettings()


@dataclass(frozen=True)
class AutoPlaneSettings:
    """Of guide planes that nobody gave.

    Attributes:
        mouth: A passage begins where clearance falls below this share of what counts as free. Unrecorded.
        plateau: Clearances that differ by less than this share are one plateau. Unrecorded.
        sight: Two centres see each other if the straight way between them keeps this share of the clearance at its
            ends. Unrecorded.
        sight_step: Spacing of the points that are looked at along a line of sight [m]. Unrecorded.
        nearby: How many points of the way a plane may be moved to a smaller section. Unrecorded.
        apart: Planes nearer to each other, to the start or to the goal than this are one [m]. Unrecorded.
        centrings: How often a section is cut anew about its own middle. Unrecorded.
        centred: Share of the clearance on the way that its middle keeps. Unrecorded.
        distinct: Corners nearer than this share of a section's size are one. Unrecorded.
    """

    mouth: float = 0.8
    plateau: float = 0.02
    sight: float = 0.5
    sight_step: float = 0.02
    nearby: int = 3
    apart: float = 0.1
    centrings: int = 2
    centred: float = 0.5
    distinct: float = 1e-3


AUTO_PLANES = AutoPlaneSettings()
