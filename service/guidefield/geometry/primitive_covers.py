"""A few balls inside of a body for certain, and covers of boxes, cylinders, capsules and spheres.

Rows and grids of equal balls. Where these leave the shape too far, or are many, the surface is covered like any other
(`cover.py`); the fewer balls are kept. ValueError if the overhang is so small for the shape that there might be very
many balls. That a cover contains its shape rests on `_ROUNDING`.

Collision kernels prove contact by the inner balls, the most filling first; that their radii are less than the depths of
their centres, by `SAFETY` and `Solid.reach`, makes it a proof. All other constants trade the number of balls, or how
much they fill, against time; of obstacles wholly inside a mesh those kernels see what inner balls meet alone.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from guidefield.geometry import surfaces
from guidefield.geometry.cover import (
    MOST_BALLS,
    Cover,
    Pieces,
    assemble_cover,
    bisect_pieces,
    cover,
    gather_elements,
    medial_balls,
)
from guidefield.geometry.solid import Solid, solid
from guidefield.geometry.surfaces import Floats, Integers
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
_MAX_GRID_SIDE = 64  # most of them in a row: a flat body must not get very many


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
    counts = np.clip(np.ceil(extents / step), 1, _MAX_GRID_SIDE).astype(int)
    axes = [low[k] + (np.arange(counts[k]) + 0.5) * extents[k] / counts[k] for k in range(3)]
    grid: Floats = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid


def _freeze(balls: Floats) -> Floats:
    balls = np.ascontiguousarray(balls)
    balls.setflags(write=False)
    return balls


_SIDES = 36  # of the prism within a cylinder


def inner_sphere(radius: float) -> Floats:
    """The sphere itself; shape (n, 4) [m], as for the other shapes."""
    return _row(0.0, radius)


def inner_capsule(radius: float, length: float) -> Floats:
    """Return balls (n, 4) [m] along the axis, z, of a capsule whose straight part has that length."""
    return _row(0.5 * length, radius)


def inner_cylinder(radius: float, length: float) -> Floats:
    """Return balls (n, 4) [m] inside a cylinder along z."""
    if 0.5 * length >= radius:
        return _row(0.5 * length - radius, radius)
    # the prism's sides touch a cylinder of radius r, its edges one of r / cos(pi / sides)
    return inner_balls(solid(*surfaces.cylinder(radius * np.cos(np.pi / _SIDES), length, _SIDES)))


def inner_box(size: ArrayLike) -> Floats:
    """Balls inside of a box about the origin; `size` is its full extents, shape (3,) [m]."""
    return inner_balls(solid(*surfaces.box(size)))


def _row(half: float, radius: float) -> Floats:
    """Equal balls from -half to half along z, about a radius apart if they needn't be more than `MOST_INNER_BALLS`."""
    inside = radius - SAFETY
    count = int(np.clip(np.ceil(2.0 * half / radius) + 1, 1, MOST_INNER_BALLS)) if inside >= LEAST_RADIUS else 0
    heights = np.linspace(-half, half, count) if count > 1 else np.zeros(count)
    balls = np.column_stack([np.zeros((count, 2)), heights, np.full(count, inside)])
    balls.setflags(write=False)
    return balls


SMALL_GRID = 8  # a grid of so few balls isn't compared with a cover of the surface

_MOST_ALONG, _MOST_IN_GRID = 64, 512  # most cells of a box along an axis, and in all: beyond it there is no grid

_ROUNDING = 1.0 + 1e-12  # factor on radii, so that rounding leaves nothing uncovered

_PRISM_EXCESS = 0.01  # by how much the prism around a cylinder may leave it, as a share of delta


def cover_sphere(radius: float) -> Cover:
    """Return a sphere itself as its cover."""
    return _direct(np.zeros((1, 3)), radius, np.array([radius]), radius)


def cover_capsule(radius: float, length: float, delta: float) -> Cover:
    """Cover a capsule along z with a straight part of that length [m], leaving it by at most `delta` [m]."""
    half = 0.5 * length
    # a ball that overhangs by delta reaches so far along the straight part; the ends' centres lie delta within it
    reach = np.sqrt(2.0 * radius * delta + delta * delta)
    count = 1 if half <= delta else 1 + _in_row((half - delta) / reach)
    overhang = half if count == 1 else _least_overhang(radius, half, count, delta)
    ends = half - min(overhang, half)
    centres = np.zeros((count, 3))
    centres[:, 2] = np.linspace(-ends, ends, count)
    return _direct(centres, radius + overhang, np.full(count, radius), half + radius)


def cover_cylinder(radius: float, length: float, delta: float) -> Cover:
    """Cover a cylinder along z, leaving it by at most `delta` [m]."""
    count = _in_row(0.5 * length / np.sqrt(2.0 * radius * delta + delta * delta))
    half = 0.5 * length / count
    ball = float(np.hypot(radius, half))
    bound = float(np.hypot(radius, 0.5 * length))
    if ball <= delta + min(radius, half):
        centres = np.zeros((count, 3))
        centres[:, 2] = half * (2.0 * np.arange(count) + 1.0 - count)
        return _direct(centres, ball, np.minimum(radius, 0.5 * length - np.abs(centres[:, 2])), bound)
    sides = int(np.ceil(np.pi / np.arccos(radius / (radius + _PRISM_EXCESS * delta))))
    prism = solid(*surfaces.cylinder(radius, length, max(sides, 12)))
    around = cover(prism, (1.0 - _PRISM_EXCESS) * delta).spheres
    return _indirect(around, _depth_in_cylinder(around[:, :3], radius, 0.5 * length), bound)


def cover_box(size: ArrayLike, delta: float) -> Cover:
    """Cover of a box about the origin; `size` is its full extents, shape (3,) [m], `delta` the largest overhang [m]."""
    half = 0.5 * np.asarray(size, dtype=np.float64)
    counts = _fewest_cells(half, delta)
    grid = None
    if counts is not None:
        cell = half / counts
        axes = [cell[k] * (2.0 * np.arange(counts[k]) + 1.0 - counts[k]) for k in range(3)]
        centres = np.array(list(product(*axes)))
        depths = (half - np.abs(centres)).min(axis=1)
        grid = _direct(centres, float(np.linalg.norm(cell)), depths, float(np.linalg.norm(half)))
        if len(centres) <= SMALL_GRID:
            return grid
    around = cover(solid(*surfaces.box(2.0 * half)), delta).spheres
    if grid is not None and len(grid.spheres) <= len(around):
        return grid
    return _indirect(around, (half - np.abs(around[:, :3])).min(axis=1), float(np.linalg.norm(half)))


def _direct(centres: Floats, radius: float, depths: Floats, bound: float) -> Cover:
    return _indirect(np.column_stack([centres, np.full(len(centres), radius * _ROUNDING)]), depths, bound)


def _indirect(balls: Floats, depths: Floats, bound: float) -> Cover:
    """Make a cover of balls whose centres have these depths; a ball about the origin of radius `bound` has it all."""
    return assemble_cover(balls, depths, np.array([0.0, 0.0, 0.0, bound * _ROUNDING]))


def _in_row(count: float) -> int:
    if not count < MOST_BALLS:
        raise ValueError(f"{count:.3g} balls in a row are too many: a larger overhang takes fewer")
    return int(np.ceil(count))


def _least_overhang(radius: float, half: float, count: int, delta: float) -> float:
    """The least overhang, at most delta, with which that many balls cover a capsule, by bisection."""
    low, high = 0.0, delta
    for _ in range(60):
        middle = 0.5 * (low + high)
        spacing = 2.0 * (half - middle) / (count - 1)
        enough = 0.25 * spacing * spacing <= 2.0 * radius * middle + middle * middle
        low, high = (low, middle) if enough else (middle, high)
    return high


def _fewest_cells(half: Floats, delta: float) -> Integers | None:
    """Return the fewest cells along each axis of a box whose balls overhang by at most delta; None if too many."""
    most = np.clip(np.ceil(np.sqrt(3.0) * half / delta), 1, _MOST_ALONG).astype(int)
    counts = np.stack(np.meshgrid(*(np.arange(1, n + 1) for n in most), indexing="ij"), axis=-1)
    counts = counts.reshape(-1, 3)
    counts = counts[counts.prod(axis=1) <= _MOST_IN_GRID]
    cells = half / counts
    fits = np.linalg.norm(cells, axis=1) <= delta + cells.min(axis=1)
    if not fits.any():
        return None
    fitting = counts[fits]
    chosen: Integers = fitting[int(fitting.prod(axis=1).argmin())]
    return chosen


def _depth_in_cylinder(points: Floats, radius: float, half: float) -> Floats:
    side = radius - np.linalg.norm(points[:, :2], axis=1)
    end = half - np.abs(points[:, 2])
    outside = np.hypot(np.minimum(side, 0.0), np.minimum(end, 0.0))
    depths: Floats = np.where((side >= 0.0) & (end >= 0.0), np.minimum(side, end), -outside)
    return depths
