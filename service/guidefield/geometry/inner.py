"""Choose a few inscribed spheres of a body that fill much of it: whatever touches one touches the body, for certain.

Collision kernels prove contact by these balls, the most filling first; that their radii are less than the depths of
their centres, by `SAFETY` and `Solid.reach`, makes it a proof. All other constants are how much is filled against time.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from guidefield.geometry.cover import medial_balls
from guidefield.geometry.elements import Pieces, bisect_pieces, gather_elements
from guidefield.geometry.solid import Solid
from guidefield.geometry.surfaces import Floats
from guidefield.kernels.cover.ball_cover import count_missing, held_points

MOST_INNER_BALLS = 8  # most balls of a body: with more contact is proved sooner, and every test reads more

SAFETY = 1e-6
"""By how much a ball is smaller than the depth of its centre, so that it is inside whatever rounding does [m]."""

LEAST_RADIUS = 1e-3  # smaller balls aren't worth looking at [m]
RESOLUTION = 0.01  # of candidates closer to each other than this, one is examined; as a share of the body's extent
SLACK = 0.02  # by how much candidates may miss the surface that they were grown from, as a share of the body's extent
STEPS = 12  # of a chosen ball to where it is deeper: each moves it, or else halves the next step

CANDIDATES = 200
"""About how many balls they are chosen from. With three times as many the chosen ones fill 1 % more of a link."""

SAMPLES = 1000  # about how many points of a grid within the body stand for its volume
_MOST_ALONG = 64  # most of them in a row: a flat body must not get very many


def inner_balls(body: Solid) -> Floats:
    """Return balls inside a body and the mesh within `Solid.reach` of it, shape (n, 4) [m], the most filling first.

    There are none in an open surface, not even if it was closed by lids: what is inside may not touch it. Nor are there
    any in a body that is flat.
    """
    if not body.closed or body.lids:
        return _freeze(np.empty((0, 4)))
    low, high = body.surface.vertices.min(axis=0), body.surface.vertices.max(axis=0)
    corners = body.surface.corners
    size = float(np.sqrt(4.0 * body.area / CANDIDATES))
    elements = gather_elements(bisect_pieces(Pieces(corners, np.arange(len(corners))), size), size)
    extent = float((high - low).max())
    balls = medial_balls(body, elements, CANDIDATES, RESOLUTION * extent, SLACK * extent)
    balls[:, 3] -= SAFETY + body.reach
    samples = _grid(low, high)
    samples = samples[body.depths(samples) > 0.0]
    balls = balls[balls[:, 3] >= LEAST_RADIUS]
    if not len(balls) or not len(samples):
        return _freeze(np.empty((0, 4)))
    return _freeze(_most_filling(body, balls, samples, RESOLUTION * extent))


def _most_filling(body: Solid, balls: Floats, samples: Floats, step: float) -> Floats:
    """Choose balls in turn, each the one that fills most that those before don't, and move it to where it is deeper."""
    held, counts = _mark_contained(balls, samples), np.empty(len(balls), np.int64)
    missing = np.full(held.shape[1], ~np.uint64(0))
    chosen: list[Floats] = []
    while len(chosen) < MOST_INNER_BALLS:
        count_missing(held, missing, counts)
        best = int(counts.argmax())
        if counts[best] == 0:
            break
        ball = _move_deeper(body, balls[best], step)
        fills = _mark_contained(ball[None], samples)[0]
        if int(np.bitwise_count(fills & missing).sum()) < counts[best]:
            ball, fills = balls[best], held[best]
        chosen.append(ball)
        missing &= ~fills
    return np.array(chosen)


def _mark_contained(balls: Floats, samples: Floats) -> np.ndarray:
    """Return the bit matrix of which ball (n, 4) holds which sample (m, 3), 64 samples to a word: (n, words)."""
    bits = np.empty((len(balls), -(-len(samples) // 64)), np.uint64)
    held_points(np.ascontiguousarray(balls), samples, bits)
    return bits


def _move_deeper(body: Solid, ball: Floats, step: float) -> Floats:
    """Move a ball along edges and diagonals of a cube while that makes it larger, by ever smaller steps."""
    centre, radius = ball[:3], float(ball[3])
    for _ in range(STEPS):
        trials = centre + step * _NEIGHBOURS
        radii = body.depths(trials) - SAFETY - body.reach
        best = int(radii.argmax())
        if radii[best] > radius:
            centre, radius = trials[best], float(radii[best])
        else:
            step *= 0.5
    return np.append(centre, radius)


_NEIGHBOURS = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)])


def _grid(low: Floats, high: Floats) -> Floats:
    extents = np.maximum(high - low, 1e-9)
    step = float(np.cbrt(np.prod(extents) / SAMPLES))
    counts = np.clip(np.ceil(extents / step), 1, _MOST_ALONG).astype(int)
    axes = [low[k] + (np.arange(counts[k]) + 0.5) * extents[k] / counts[k] for k in range(3)]
    grid: Floats = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid


def _freeze(balls: Floats) -> Floats:
    balls = np.ascontiguousarray(balls)
    balls.setflags(write=False)
    return balls
