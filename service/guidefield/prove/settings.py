"""The numbers of the certificate, each with what chose it.

None of them decides what is certified, but for the accuracy of Coal and the tolerances: the others are about time, and
about how close to contact a motion can still be told to be free. Where it says *unrecorded* nobody wrote down how a
number was chosen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np

_D = TypeVar("_D", float, np.ndarray)


@dataclass(frozen=True)
class CertificateSettings:
    """Of the certificate of motions.

    Attributes:
        coal_accuracy: Added to every margin: how far off Coal's answers may be [m]. The tolerance of
            Coal's search for distances.
        coal_relative: The same for each metre of distance. Crossing cylinders, whose distance is known, are at most
            1 um and 0.9 um a metre off; this is twice as much.
        floor: A pair whose possible motion is down to this, and which still can't be told apart, is undecided [m]. The
            page about the certificate promises it.
        mesh_from: A mesh is asked, where its hull does not tell, once its pair's possible motion is down to this [m].
            With 0.02 the certificates of a UR5's motions take 1.7 to 2.5 times as long, with 0.0025 those of motions
            close to obstacles a twentieth longer; a Panda's, a Fetch's and a Baxter's take as long with either.
        least_share: What can't be told is divided into at most as many parts at once as this goes into one. Unrecorded.
        at_once: So many segments are judged coarsely before any is judged finely, which bounds memory; plans have
            fewer.
        batch: At most so many segments have their bounds computed together. Unrecorded.
        widest: Curves that span more in any coordinate are halved before they are tested [rad or m]: a test there
            rarely decides. Unrecorded.
        together: Consecutive pieces are tested together as long as they span about this in some coordinate, not more
            [rad or m]. With 0.07 or 0.035 a Panda's or a UR5's motion takes a twentieth longer, with 0.1 a fifth.
        timed_floor: The same as `floor` among obstacles that move: robot and obstacle together can't move farther [m].
            The page about the certificate promises it.
        constraint_floor: Curves that span no more than this in every coordinate, and about whose path constraints it
            still can't be told, are refused [rad or m]. Unrecorded.
    """

    coal_accuracy: float = 1e-6
    coal_relative: float = 2e-6
    floor: float = 1e-5
    mesh_from: float = 0.01
    least_share: float = 1.0 / 8.0
    at_once: int = 4096
    batch: int = 64
    widest: float = 0.3
    together: float = 0.05
    timed_floor: float = 1e-3
    constraint_floor: float = 1e-5


CERTIFICATE = CertificateSettings()


def with_coal_error(distance: _D) -> _D:
    """What Coal has to say [m], so that bodies are a distance [m] apart at least; of an array (n,), of each."""
    asked: _D = distance + CERTIFICATE.coal_relative * abs(distance) + CERTIFICATE.coal_accuracy
    return asked


def without_coal_error(distance: _D) -> _D:
    """How far apart bodies are at least [m], where Coal says a distance [m]; of an array (n,), of each."""
    certain: _D = distance - CERTIFICATE.coal_relative * abs(distance) - CERTIFICATE.coal_accuracy
    return certain


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
