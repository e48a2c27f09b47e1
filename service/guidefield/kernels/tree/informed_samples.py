"""An even sequence of samples for searches in SIMD batches: most near the path between two roots, others anywhere.

A joint turns by more than most paths need. Samples from all of its limits mostly pull a tree away from where it has to
go; those near the straight path from a start to a goal find most paths sooner, and the others find the rest. The
sequence is fixed by `Sampling.steps` and the places where it begins, which `planner/tree_search.py` draws by
the seed: a change here changes every path.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import int64, types

from guidefield.kernels.jit.arrays import FLOAT_POINTER, Floats, Floats32, Indices, Row, Singles, numba_type
from guidefield.kernels.jit.decorators import vector_part, vector_step
from guidefield.kernels.simd.packing import pointed, pointers, unpacked
from guidefield.kernels.simd.rotations import cosine_and_sine
from guidefield.kernels.simd.vector import (
    LANES,
    Vector,
    f32x16,
    largest_of,
    load,
    magnitude,
    rint,
    root,
    select,
    smallest_of,
    splat,
    store,
)

_AHEAD = np.arange(1, LANES + 1, dtype=np.float32)  # which of the next sixteen samples each lane has
NEAR = 0.75  # the share of samples, above 0, drawn near a path, as service/docs/algorithm.md says; others fill the box
WHOLE = 0.9999  # a range of at least this share of a turn counts as the whole turn


class StraightPath(NamedTuple):
    """The straight path between two points that most samples are near."""

    nodes: Floats32  # points, coordinate by coordinate
    # start, goal: Where the first coordinates of the two points are in these
    start: int
    goal: int
    stride: int  # how far on each next coordinate is
    reach: float  # in each coordinate samples are at most so far from a point of the path [rad or m]


class Sampling(NamedTuple):
    """Sources of samples."""

    # (nv + 1,) by which each coordinate's place in the box goes on from sample to sample, modulo 1; by the last of
    # these places it is chosen which samples are near the path, and how far along
    steps: Row
    # lower, width: (nv,) the box that samples fill
    lower: Row
    width: Row
    period: Singles  # (nv,) 2 pi for coordinates that wrap, else 0; float32
    frequency: Singles  # (nv,) 1 / (2 pi) for those, else 0; float32
    # (nv,) what counts as one radian, a power of two, so that nothing is rounded; 1 for angles; float32. All else here,
    # and nodes and samples of a search, are local coordinates over them.
    units: Singles
    n_rotations: int  # how many joints turn about a point
    rotations: Indices  # (n_rotations,) where their rotation vectors begin: these are of rotations drawn evenly


_SAMPLING = numba_type(Sampling)
SAMPLING = pointed(_SAMPLING)

sampling_of = unpacked(_SAMPLING)  # makes a sampling of its words


@vector_step(types.void(f32x16, f32x16, f32x16, FLOAT_POINTER, int64))
def turn_evenly(first: Vector, second: Vector, third: Vector, samples_out: Floats32, at: int) -> None:
    """Write rotation vectors, at most pi long, of rotations at sixteen places in the unit cube (Shoemake 1992) [rad].

    Places that fill the cube evenly are rotations that fill all of them evenly; (n,) gets them from an index on,
    coordinate by coordinate. With w the cosine of half of the angle, vector and sine are as arccos w / root(1 - w^2),
    here a polynomial that is off by 6e-5.
    """
    inner, outer = root(splat(1.0) - first), root(first)
    c, s = cosine_and_sine(second * (2.0 * math.pi))
    d, t = cosine_and_sine(third * (2.0 * math.pi))
    w = outer * d
    u = magnitude(w)
    scale = (((0.5462545 - 0.1317371 * u) * u - 1.0787918) * u + 1.5185036) * u - 1.9957945
    scale = scale * u + 3.141535
    scale = select(w < 0.0, -scale, scale)
    store(samples_out, at, scale * inner * s)
    store(samples_out, at + LANES, scale * inner * c)
    store(samples_out, at + 2 * LANES, scale * outer * t)


@vector_part
def _shares(sampling: Sampling, places: Floats, j: int) -> Vector:
    """Return how far along a side of the box the next sixteen samples are, from 0 to 1."""
    along = load(pointers(_AHEAD), 0) * sampling.steps[j] + places[j]
    return along - rint(along - 0.5)


@vector_part
def next_samples(sampling: Sampling, nv: int, places: Floats, path: StraightPath, samples_out: Floats32) -> None:
    """Write the next sixteen points of the sequence (nv * 16,).

    `pass_samples` goes on by those that are used [rad or m]. Each fills a box of its own: all of the limits, or the
    part within reach of a point of `path`. A coordinate that turns without end has no limits but a turn's length, and
    goes the short way. Rotations are drawn evenly. `places` (nv + 1,) is where in its box the last one was, as shares
    of its sides, and which box that was.
    """
    along = _shares(sampling, places, nv)
    reach = select(along < NEAR, splat(path.reach), np.inf)
    along = along * np.float32(1.0 / NEAR)
    for j in range(nv):
        at, period, width = path.nodes[path.start + j * path.stride], sampling.period[j], np.float32(sampling.width[j])
        apart, lower = path.nodes[path.goal + j * path.stride] - at, np.float32(sampling.lower[j])
        if period != 0.0:
            apart -= np.float32(np.rint(apart * sampling.frequency[j])) * period
        middle = along * apart + at
        if width < np.float32(WHOLE) * period or period == 0.0:
            least = largest_of(middle - reach, splat(lower))
            most = smallest_of(middle + reach, splat(lower + width))
        else:
            half = smallest_of(reach, splat(np.float32(0.5) * width))
            least, most = middle - half, middle + half
        store(samples_out, j * LANES, _shares(sampling, places, j) * (most - least) + least)
    for k in range(sampling.n_rotations):
        j = sampling.rotations[k]
        x, y, z = _shares(sampling, places, j), _shares(sampling, places, j + 1), _shares(sampling, places, j + 2)
        turn_evenly(x, y, z, samples_out, j * LANES)


@vector_part
def pass_samples(sampling: Sampling, nv: int, places: Floats, count: int) -> None:
    """Go on by that many points of the sequence; `places` (nv + 1,) as for `next_samples`, changed."""
    for j in range(nv + 1):
        place = places[j] + count * sampling.steps[j]
        places[j] = place - math.floor(place)
