"""The accuracies of the judges of motions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

_D = TypeVar("_D", float, np.ndarray)

COAL_ACCURACY = 1e-6
"""How far off Coal's answers may be [m]: the tolerance of its search for distances."""

COAL_RELATIVE = 2e-6
"""The same for each metre of distance: crossing cylinders, whose distance is known, are at most 1 um and 0.9 um a metre
off; this is twice as much."""

CONSTRAINT_RESOLUTION = 1e-5
"""Curves that span no more than this in every coordinate, and about whose path constraints it still can't be told, are
refused [rad or m]. Unrecorded."""


def with_coal_error(distance: _D) -> _D:
    """Return what Coal has to say [m], so that bodies are a distance [m] apart at least; of an array (n,), of each."""
    asked: _D = distance + COAL_RELATIVE * abs(distance) + COAL_ACCURACY
    return asked


@dataclass(frozen=True)
class LimitSettings:
    """Of the judgement of position limits.

    Attributes:
        tolerance: What a coordinate may be beyond its limit, for rounding [rad or m].
        exact: Curves are halved until the largest excess is known to this [rad or m].
        most_halvings: Parts shorter than this leaves can't be told from a point: 2^-60.
    """

    tolerance: float = 1e-9
    exact: float = 1e-13
    most_halvings: int = 60


LIMITS = LimitSettings()
