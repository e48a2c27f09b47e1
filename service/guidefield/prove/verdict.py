"""Verdicts of certificates: whether a motion is free, and where and why it is refused; tolerances of the decision.

The values of `Reason` are on the wire and in recordings. A smaller accuracy of Coal's than it has would turn verdicts
into contradictions, a larger one more of them into undecided. docs/certificate.md states `COAL_ACCURACY`,
`COAL_RELATIVE` and `LIMIT_TOLERANCE`; the referee has a tolerance of limits of its own (`referee/case.py`). A smaller
`CONSTRAINT_RESOLUTION` refuses less, and takes longer.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from guidefield.collision.pairs import PairNames
from guidefield.read_only import ReadOnly
from guidefield.robot.model.configuration import LimitFault
from guidefield.robot.model.joints import LocalPoint

_D = TypeVar("_D", float, np.ndarray)

COAL_ACCURACY = 1e-6  # how far off Coal's answers may be [m]: the tolerance of its search for distances

COAL_RELATIVE = 2e-6
"""The same as a share of the distance: crossing cylinders, whose distance is known, are at most 1 um and 0.9e-6 of it
off; this is twice as much."""

CONSTRAINT_RESOLUTION = 1e-5
"""A curve that spans no more than this in every coordinate is refused if its path constraints are still undecided
[rad or m]. Unrecorded."""


def with_coal_error(distance: _D) -> _D:
    """Return the distance that Coal must report [m] for bodies to be at least a distance [m] apart; or of each (n,)."""
    required: _D = distance + COAL_RELATIVE * abs(distance) + COAL_ACCURACY
    return required


LIMIT_TOLERANCE = 1e-9  # a motion's coordinate may be this much beyond its limit, for rounding [rad or m]


class Reason(enum.Enum):
    """The reason of a verdict; values are words of replies, with sentences in handlers/certify.py."""

    FREE = "free"
    """No pair touches, and all conditions hold, all along the motion."""
    CONTACT = "contact"
    """A pair touches."""
    TOO_CLOSE = "too close"
    """Robot and obstacle come closer than the required clearance."""
    BEYOND_LIMITS = "beyond limits"
    """A joint leaves its position limits."""
    BEYOND_VELOCITY = "beyond a velocity limit"
    """The executed trajectory is too fast."""
    BEYOND_ACCELERATION = "beyond an acceleration limit"
    """The executed trajectory accelerates too much."""
    BEYOND_JERK = "beyond a jerk limit"
    """The executed trajectory has too much jerk."""
    PATH_CONSTRAINT = "violates a path constraint"
    """A frame leaves what a path constraint allows."""
    UNDECIDED = "undecided"
    """A pair comes so close that it couldn't be decided down to the resolution."""
    STOPPED = "stopped"
    """The deadline passed before it was decided."""


@dataclass(frozen=True, eq=False)
class Verdict(ReadOnly):
    """The verdict of a certificate about a motion."""

    reason: Reason
    evaluations: int  # configurations examined, by balls and boxes, by Coal, or by a constraint
    piece: int | None = None  # index of the piece that was refused; None if free
    parameter: float | None = None  # where on it, from 0 to 1: the place of the refusal; None if free
    # piece, and parameter on it, up to which the motion is certified; None if free
    free_until: tuple[int, float] | None = None
    # names of the pair that was refused; None if free, or where no single pair is to blame
    pair: PairNames | None = None
    local_point: LocalPoint | None = None  # the place of the refusal, shape (nv,); None if free
    # the joint that is beyond its limits, and its value there; None unless that is the reason
    beyond: LimitFault | None = None

    @property
    def free(self) -> bool:
        """Whether the motion is certified over its whole length."""
        return self.reason is Reason.FREE

    @property
    def place(self) -> tuple[float, float]:
        """Piece and parameter of the place of the refusal; infinite if the motion is free."""
        if self.piece is None or self.parameter is None:
            return math.inf, math.inf
        return self.piece, self.parameter


def first_refused(one: Verdict, other: Verdict) -> Verdict:
    """Return that of two verdicts about one motion which refuses it first, with the evaluations of both.

    The motion is certified as far as both certify it.
    """
    chosen = min(one, other, key=lambda verdict: verdict.place)
    certified = [verdict.free_until for verdict in (one, other) if verdict.free_until is not None]
    return replace(
        chosen, evaluations=one.evaluations + other.evaluations, free_until=min(certified) if certified else None
    )
