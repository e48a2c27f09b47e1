"""A first motion that begins or ends in motion brought within limits: these are loosened first, then tightened.

Time cannot be stretched where velocities are given. Newton's method on the same objective, with so much weight on the
barrier that it leads away from all limits, brings the motion further within the loosened ones each time.
"""

from __future__ import annotations

import dataclasses

from guidefield.kernels.optimize.limit_barrier import MotionLimits
from guidefield.planner.motion.bspline import BSpline
from guidefield.planner.optimize.interior_point import Descent, Question
from guidefield.planner.optimize.start import load_of
from guidefield.read_only import read_only


def brought_within(question: Question, spline: BSpline) -> BSpline | None:
    """The motion strictly within limits; None where that isn't reached in a few rounds.

    Args:
        question: What is asked.
        spline: The motion, within the range of positions.
    """
    settings = question.settings
    for _ in range(settings.loosenings):
        load = load_of(spline, question.limits)
        if load < settings.strictly:
            return spline
        loosened = dataclasses.replace(question, limits=_loosened(question.limits, settings.loosened * load))
        descent = Descent.of(loosened, spline, settings.samples)
        spline = descent.lowered(descent.look(spline), settings.inward, settings.inward_steps) or spline
    return None


def _loosened(limits: MotionLimits, by: float) -> MotionLimits:
    """Limits of rates multiplied by a factor."""
    rows = (by * limits.velocity, by * limits.acceleration, by * limits.jerk)
    read_only(*rows)
    return limits._replace(velocity=rows[0], acceleration=rows[1], jerk=rows[2])
