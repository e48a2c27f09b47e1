"""An even sequence of samples in the box of a group's chart, for searches on lanes."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import int64, types

from guidefield.kernels.lane_math import Floats32, cosine_and_sine
from guidefield.kernels.lanes import (
    FLOAT_POINTER,
    FLOATS,
    LANES,
    Vector,
    f32x16,
    lane_part,
    lane_step,
    load,
    magnitude,
    pointed,
    pointers,
    rint,
    splat,
    sqrt,
    store,
    where_below,
)
from guidefield.kernels.packing import unpacked
from guidefield.kernels.signatures import VECTOR, Floats
from guidefield.kernels.tree_kinematics import INDICES

_AHEAD = np.arange(1, LANES + 1, dtype=np.float32)
"""Of sixteen samples, the how manieth each is."""


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


@lane_step(types.void(f32x16, f32x16, f32x16, FLOAT_POINTER, int64))
def turn_evenly(first: Vector, second: Vector, third: Vector, samples_out: Floats32, at: int) -> None:
    """The rotation vectors, at most pi long, of the rotations at sixteen places in the unit cube (Shoemake 1992).

    Places that fill the cube evenly are rotations that fill all of them evenly. With w the cosine of half of the angle,
    vector and sine are as arccos w / sqrt(1 - w^2), here a polynomial that is off by 6e-5.

    Args:
        first: Shares of the cube's first side.
        second: Of its second.
        third: Of its third.
        samples_out: Gets the vectors from an index on, coordinate by coordinate, shape (n,) [rad].
        at: That index.
    """
    inner, outer = sqrt(splat(1.0) - first), sqrt(first)
    c, s = cosine_and_sine(second * (2.0 * math.pi))
    d, t = cosine_and_sine(third * (2.0 * math.pi))
    w = outer * d
    u = magnitude(w)
    scale = (((0.5462545 - 0.1317371 * u) * u - 1.0787918) * u + 1.5185036) * u - 1.9957945
    scale = scale * u + 3.141535
    scale = where_below(w, splat(0.0), -scale, scale)
    store(samples_out, at, scale * inner * s)
    store(samples_out, at + LANES, scale * inner * c)
    store(samples_out, at + 2 * LANES, scale * outer * t)


@lane_part
def _shares(sampling: Sampling, places: Floats, j: int) -> Vector:
    """How far along a side of the box the next sixteen samples are, from 0 to 1."""
    along = load(pointers(_AHEAD), 0) * sampling.steps[j] + places[j]
    return along - rint(along - 0.5)


@lane_part
def next_samples(sampling: Sampling, nv: int, places: Floats, samples_out: Floats32) -> None:
    """The next sixteen points of the sequence, in the box; `pass_samples` goes on by those that are used.

    Args:
        sampling: The box.
        nv: Coordinates of a point.
        places: (nv,) where in the box the last one was, as shares of its sides.
        samples_out: (nv * 16,) the points, coordinate by coordinate [rad or m].
    """
    for j in range(nv):
        store(samples_out, j * LANES, _shares(sampling, places, j) * sampling.width[j] + sampling.lower[j])
    for k in range(sampling.n_rotations):
        j = sampling.rotations[k]
        x, y, z = _shares(sampling, places, j), _shares(sampling, places, j + 1), _shares(sampling, places, j + 2)
        turn_evenly(x, y, z, samples_out, j * LANES)


@lane_part
def pass_samples(sampling: Sampling, nv: int, places: Floats, count: int) -> None:
    """Go on by so many points of the sequence; `places` (nv,) as for `next_samples`, changed."""
    for j in range(nv):
        place = places[j] + count * sampling.steps[j]
        places[j] = place - math.floor(place)
