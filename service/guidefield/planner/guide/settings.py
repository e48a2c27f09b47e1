"""The numbers of the guided planner, each with what chose it; lengths are those at size 1.

"Scenes" are those of the thesis, by `tools/bench seed`; service/docs/algorithm.md, "Projected", has what happens
otherwise. Where it says *unrecorded* nobody wrote down how a number was chosen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class DescentSettings:
    """Of a descent of the potential while the tip keeps a constraint."""

    # share of the metric's mean diagonal added to it. Scenes: with less, symmetric links spin; 0.1 is too stiff
    regularization: float = 1e-2
    on_constraint: float = 1e-5  # how near a trial has to come to it [m or rad]: a tenth of `ApproachSettings.on_plane`
    # it ends where a step promises, or brings, less than this share of U. Scenes: more costs half of the clearance,
    # less 3 to 7 times the time
    tolerance: float = 1e-3
    # where the robot is nearer to obstacles than this when it would end, it goes on .. [m]. Scenes: the blocked passage
    # keeps 15 mm with it, 11.6 without
    close: float = 0.015
    fine: float = 1e-4  # .. with this tolerance: there the last thousandth of U is millimetres of clearance
    most_steps: int = 60  # it ends after so many steps. Unrecorded
    at_once: int = 20  # steps between two checks of the deadline. Unrecorded


DESCENT = DescentSettings()


@dataclass(frozen=True)
class SettlingSettings:
    """Of slide and reorient in turn, and of Univariate's rounds, on one plane."""

    most_rounds: int = 6  # at most so many. Unrecorded
    negligible: float = 2e-3  # they end where U falls by less than this share. Unrecorded


SETTLING = SettlingSettings()


@dataclass(frozen=True)
class ApproachSettings:
    """Of the rounds of advance, slide and reorient towards a guide plane."""

    # length of an advance, the thesis' delta_0 [m]: a third of a link, a third of a mouth. Scenes: shorter ones take up
    # to twice the time, longer ones keep less clearance
    first_step: float = 0.1
    smallest_step: float = 0.1 / 50  # below this an advance is given up, delta_min [m]. Unrecorded
    guard: float = 0.5  # share of an advance's gain that slide and reorient have to keep, 1 - beta. Unrecorded
    on_plane: float = 1e-4  # how near the plane counts as on it [m]: the tip's accuracy that the pages promise
    short: float = 0.1 / 4  # an advance of this length is not made again with shorter ones [m]. Scenes
    resolution: float = 32.0  # samples of a motion per length in the chart [1/rad or 1/m], as a tree's motions have
    at_once: int = 4  # rounds between two checks of the deadline, in one kernel. Unrecorded
    creeping: float = 0.1  # a round gains little below this share of what an advance may bring. Unrecorded
    creeping_rounds: int = 3  # so many such rounds in a row are a standstill. Unrecorded


APPROACH = ApproachSettings()


@dataclass(frozen=True)
class WaySettings:
    """Of the choice among ways between the same two configurations."""

    comfortable: float = 0.02  # a straight way that keeps this is taken without comparing [m]. Unrecorded
    # distances from obstacles by which ways are compared, the widest first [m]. Unrecorded
    margins: tuple[float, ...] = (0.06, 0.03, 0.02, 0.01, 0.005)
    # a way dips that does not keep the widest of these distances that both its ends keep [m]. Scenes: with it
    # Univariate keeps 46 and 17 mm in the tapered and the blocked passage
    dips: tuple[float, ...] = (0.06, 0.045, 0.03, 0.015)


WAYS = WaySettings()


@dataclass(frozen=True)
class UnivariateSettings:
    """Of Univariate's searches along one axis."""

    # a search for an angle begins with the one and ends below the other [rad]. Unrecorded
    first_turn: float = float(np.deg2rad(5.0))
    last_turn: float = float(np.deg2rad(0.5))  # together with the one above
    first_slide: float = 0.025  # the same for a slide [m]: a quarter and a 64th of an advance. Unrecorded
    last_slide: float = 0.1 / 64  # together with the one above
    most_steps: int = 4000  # of one round. Unrecorded


UNIVARIATE = UnivariateSettings()


@dataclass(frozen=True)
class TipWaySettings:
    """Of the coarse way of the tip by which guide planes are derived, and of free sections across it."""

    spacing: float = 0.05  # of the grid [m]. Unrecorded
    most_points: int = 2_000_000  # the grid is made coarser where it would have more. Unrecorded
    around: float = 0.3  # how far the grid reaches beyond obstacles, start and goal [m]. Unrecorded
    # clearance at which a way costs twice its length [m]: ways with much of it are looked for first. Unrecorded
    comforts: tuple[float, ...] = (0.2, 0.1, 0.05, 0.02)
    least_ample: float = 0.1  # clearance that counts even where an end is in a narrower tube [m]. Unrecorded
    smoothings: int = 8  # how often the way is drawn straight and pushed off the obstacles. Unrecorded
    push: float = 0.3  # share of what is missing to free clearance by which a point of the way is pushed. Unrecorded
    kept: float = 0.98  # no point of it keeps less than this share of the clearance that it had. Unrecorded
    rays: int = 24  # by which a free section is cut. Unrecorded
    compared_rays: int = 12  # by which areas are compared, and points told to be enclosed. Unrecorded
    longest: float = 0.4  # rays are followed no farther [m]: a plane in the open is this large. Unrecorded


TIP_WAY = TipWaySettings()


@dataclass(frozen=True)
class AutoPlaneSettings:
    """Of guide planes that nobody gave."""

    mouth: float = 0.8  # a passage begins where clearance falls below this share of what counts as free. Unrecorded
    plateau: float = 0.02  # clearances that differ by less than this share are one plateau. Unrecorded
    sight: float = 0.5  # centres see each other if their straight way keeps this share of their clearance. Unrecorded
    sight_step: float = 0.02  # spacing of the points that are looked at along a line of sight [m]. Unrecorded
    nearby: int = 3  # how many points of the way a plane may be moved to a smaller section. Unrecorded
    apart: float = 0.1  # planes nearer to each other, to the start or to the goal than this are one [m]. Unrecorded
    centrings: int = 2  # how often a section is cut anew about its own middle. Unrecorded
    centred: float = 0.5  # share of the clearance on the way that its middle keeps. Unrecorded
    distinct: float = 1e-3  # corners nearer than this share of a section's size are one. Unrecorded


AUTO_PLANES = AutoPlaneSettings()
