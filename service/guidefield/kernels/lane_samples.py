"""An even sequence of samples in the box of a group's chart, for searches on lanes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import int64, types

from guidefield.kernels.lane_math import Floats32, cosine_and_sine
from guidefield.kernels.lanes import DOUBLE_POINTER, FLOAT_POINTER, FLOATS, lane, lane_step, pointed, splat
from guidefield.kernels.packing import unpacked
from guidefield.kernels.signatures import VECTOR, Floats
from guidefield.kernels.tree_kinematics import INDICES


class Sampling(NamedTuple):
    """Where samples come from.

    Attributes:
        steps: (nv,) by which each coordinate's place in the box goes on from sample to sample, modulo 1.
        lower, width: (nv,) the box that samples fill.
        period: (nv,) 2 pi for coordinates that wrap, else 0; float32.
        frequency: (nv,) 1 / (2 pi) for those, else 0; float32.
        n_rotations: How many joints turn about a point.
        rotations: (n_rotations,) where their rotation vectors begin: these are of rotations drawn evenly.
    """

    steps: np.ndarray
    lower: np.ndarray
    width: np.ndarray
    period: np.ndarray
    frequency: np.ndarray
    n_rotations: int
    rotations: np.ndarray


_SAMPLING = types.NamedTuple([*[VECTOR] * 3, *[FLOATS] * 2, types.int64, INDICES], Sampling)
SAMPLING = pointed(_SAMPLING)

sampling_of = unpacked(_SAMPLING)
"""Makes a sampling of its words."""


@lane_step(types.void(DOUBLE_POINTER, int64, FLOAT_POINTER))
def turn_evenly(places: Floats, at: int, sample_out: Floats32) -> None:
    """The rotation vector, at most pi long, of the rotation at a place in the unit cube (Shoemake 1992).

    Places that fill the cube evenly are rotations that fill all of them evenly. With w the cosine of half of the angle,
    vector and sine are as arccos w / sqrt(1 - w^2), here a polynomial that is off by 6e-5.

    Args:
        places: Shares of the cube's sides, three from an index on, shape (n,).
        at: That index.
        sample_out: Gets the vector from the same index on, shape (n,) [rad].
    """
    inner, outer = math.sqrt(1.0 - places[at]), math.sqrt(places[at])
    c, s = cosine_and_sine(splat(2.0 * math.pi * places[at + 1]))
    d, t = cosine_and_sine(splat(2.0 * math.pi * places[at + 2]))
    w = outer * lane(d, 0)
    u = abs(w)
    scale = (((0.5462545 - 0.1317371 * u) * u - 1.0787918) * u + 1.5185036) * u - 1.9957945
    scale = scale * u + 3.141535
    if w < 0.0:
        scale = -scale
    sample_out[at] = scale * inner * lane(s, 0)
    sample_out[at + 1] = scale * inner * lane(c, 0)
    sample_out[at + 2] = scale * outer * lane(t, 0)


@lane_step(types.void(SAMPLING, int64, DOUBLE_POINTER, FLOAT_POINTER))
def next_sample(sampling: Sampling, nv: int, places: Floats, sample_out: Floats32) -> None:
    """The next point of the sequence, in the box.

    Args:
        sampling: The box.
        nv: Coordinates of a point.
        places: (nv,) where in the box the last one was, as shares of its sides; changed.
        sample_out: (nv,) the point [rad or m].
    """
    for j in range(nv):
        place = places[j] + sampling.steps[j]
        place -= 1.0 if place >= 1.0 else 0.0
        places[j] = place
        sample_out[j] = sampling.lower[j] + place * sampling.width[j]
    for k in range(sampling.n_rotations):
        turn_evenly(places, sampling.rotations[k], sample_out)
