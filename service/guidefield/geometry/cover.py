"""Few balls that contain a body for certain, and leave it by no more than a given overhang.

A ball of radius depth(c) + delta about a point c of a body stays within delta of it: the first depth(c) of every ray
from c is in the body. The surface is cut into small elements; a ball contains a triangle if it contains its corners, so
the chosen balls contain the surface exactly, and by a margin. That the inside is contained too is proved by halving a
box about the body until each cell is in a ball, outside, or within the margin of the surface; a cell that isn't gets a
ball. Depths are distances to triangles, not to samples. So both promises hold up to rounding, whatever the shape.

Choosing few balls is a set cover: greedy, then improved by local search; the balls then shrink to what they own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from guidefield.geometry.elements import Elements, Pieces, bisected, blocks, gathered, joined, united
from guidefield.geometry.grouping import enclosing_ball, grouped
from guidefield.geometry.interior import contain_interior
from guidefield.geometry.medial import medial_balls
from guidefield.geometry.shrinking import shrunk
from guidefield.geometry.solid import Solid
from guidefield.geometry.surfaces import Floats, Integers
from guidefield.kernels.cover.ball_cover import contained
from guidefield.kernels.cover.greedy_set_cover import greedy_choice
from guidefield.kernels.cover.set_cover import fewer

MARGIN = 0.02
"""By how much balls contain the surface, as a share of delta."""

ELEMENT = 0.3
"""Longest edge of an element's triangles, as a share of delta."""

CANDIDATE = 0.5
"""About the spacing of candidates along the surface, as a share of delta."""

RESOLUTION = 0.1
"""Of candidates closer than this one is kept, as a share of delta."""

MOST_PIECES = 50_000
"""Where a body is so large that there would be more, its elements are larger, as long as balls contain them.

That begins at 1125 squares of delta. Covers of the 43 links of five large arms take 0.54 of the time that a million
took, and have 9 % more balls; with 30,000 they take 0.72 of that again, and have 6 % more still.
"""

LEAST_REACHES = 5.0
"""Delta has to be this many times as far as a body is from the mesh that it stands for."""

MOST_BALLS = 200_000
"""A cover that may need more is refused."""

CHUNK = 30_000
"""So many elements are looked at together."""

_ROUNDING = 1.0 - 1e-9
"""Which share of delta is used, so that no rounding leads beyond it."""

LEAST_CANDIDATES, MOST_CANDIDATES = 300, 2_000
"""Of candidates for the elements that are looked at together."""

EXCHANGES = 200
EXCHANGES_PER_BALL = 2
"""Steps of the local search: the larger of the two. A fifth of the balls of the greedy choice go; with five times the
steps 4 % more."""

Offer = Callable[[Solid, Elements, int, float], Floats]
"""Offers balls, centre and depth (n, 4) [m], for a body and elements: how many, and how close they may be [m]."""


@dataclass(frozen=True, eq=False)
class Cover:
    """Balls that contain a body; all arrays are read-only and in the body's frame.

    Attributes:
        spheres: Centre and radius, shape (n, 4) [m]; those of a group together.
        overhangs: By how much each leaves the body at most, shape (n,) [m].
        groups: Balls about groups of them, shape (g, 4) [m]: what touches none of these touches none of those.
        first: First sphere of each group, and the number of all, shape (g + 1,).
        bound: One small ball about the body, shape (4,) [m].
    """

    spheres: Floats
    overhangs: Floats
    groups: Floats
    first: Integers
    bound: Floats

    @property
    def overhang(self) -> float:
        """The largest overhang [m]."""
        return float(self.overhangs.max())


def cover(body: Solid, delta: float) -> Cover:
    """Balls that contain a body and leave it by at most `delta`.

    The same body gives the same balls.

    Args:
        body: The body. Where gaps of its surface were closed, the overhang is that over the closed surface. Where it
            stands for a finer mesh, balls contain that, and leave it by no more.
        delta: Largest overhang [m].

    Raises:
        ValueError: if `delta` is not positive, or so small for the body that there might be very many balls, or for
            how far it is from the mesh that it stands for.
    """
    if not (delta > 0.0 and np.isfinite(delta)):
        raise ValueError(f"`delta` must be positive, got {delta} m")
    if delta < LEAST_REACHES * body.reach:
        raise ValueError(f"an overhang of {delta} m is too little for a body that stands for one {body.reach} m off")
    if body.area > MOST_BALLS * delta * delta:
        raise ValueError(f"an overhang of {delta} m takes too many balls for a surface of {body.area} m^2")
    delta = _ROUNDING * delta - body.reach
    margin = MARGIN * delta + body.reach
    balls, elements = _chosen(body, delta, margin)
    balls = shrunk(body, balls, elements, delta, margin)
    if body.closed:
        balls = contain_interior(body, balls, delta, margin)
    bound = enclosing_ball(body.surface.vertices) + np.array([0.0, 0.0, 0.0, body.reach])
    return assembled(balls, body.depths(balls[:, :3]) - body.reach, bound)


def assembled(balls: Floats, depths: Floats, bound: Floats) -> Cover:
    """Balls in groups, with what is known about them.

    Args:
        balls: Centre and radius, shape (n, 4) [m].
        depths: Depths of their centres, shape (n,) [m]; negative outside.
        bound: A ball that contains the body, shape (4,) [m].
    """
    order, groups, first = grouped(balls)
    result = Cover(
        spheres=np.ascontiguousarray(balls[order]),
        overhangs=np.maximum(balls[:, 3] - depths, 0.0)[order],
        groups=groups,
        first=first,
        bound=bound,
    )
    for array in (result.spheres, result.overhangs, groups, first, bound):
        array.setflags(write=False)
    return result


def _chosen(body: Solid, delta: float, margin: float) -> tuple[Floats, Elements]:
    """Balls, as large as they may be, that contain the surface by a margin; the elements of the surface.

    What no ball about the medial axis contains is offered balls about the elements themselves, then smaller elements.
    """
    corners = body.surface.corners
    pieces = Pieces(corners, np.arange(len(corners)))
    size = max(ELEMENT * delta, float(np.sqrt(4.0 * body.area / MOST_PIECES)))
    offer = medial_balls if body.closed else _about_elements
    balls: list[Floats] = []
    covered: list[Elements] = []
    while len(pieces.sources):
        left_out = []
        elements = gathered(bisected(pieces, size), 0.8 * size)
        while len(elements.bounds):
            now = np.arange(len(elements.bounds)) < CHUNK
            looked_at = elements.some(now)
            candidates = _candidates(body, looked_at, offer, delta)
            chosen = _few(candidates[candidates[:, 3] > margin], looked_at, margin)
            inside = _unite(_bits(chosen, elements, margin), len(elements.bounds))
            balls.append(chosen)
            covered.append(elements.some(inside))
            left_out.append(elements.some(now & ~inside).pieces)
            elements = elements.some(~now & ~inside)
        pieces = joined(left_out)
        size *= 1.0 if offer is medial_balls else 0.5
        offer = _about_elements
    return np.concatenate(balls), united(covered)


def _candidates(body: Solid, elements: Elements, offer: Offer, delta: float) -> Floats:
    """Balls to choose from, shape (n, 4) [m]: what is offered, as large as it may be."""
    most = int(np.clip(elements.pieces.area / (CANDIDATE * delta) ** 2, LEAST_CANDIDATES, MOST_CANDIDATES))
    balls = offer(body, elements, most, RESOLUTION * delta)
    return np.column_stack([balls[:, :3], balls[:, 3] + delta])


def _about_elements(body: Solid, elements: Elements, most: int, resolution: float) -> Floats:
    """Centres of about `most` elements, and balls about the medial axis; with depths, which may be negative."""
    centres = np.ascontiguousarray(elements.bounds[:: max(1, len(elements.bounds) // most), :3])
    own = np.column_stack([centres, body.depths(centres)])
    return np.vstack([own, medial_balls(body, elements, most, resolution)]) if body.closed else own


def _few(balls: Floats, elements: Elements, margin: float) -> Floats:
    """Few of the balls, that contain by a margin all elements that any ball so contains."""
    bits = _bits(balls, elements, margin)
    chosen = np.empty(len(bits), np.int64)
    count = greedy_choice(bits, chosen)
    count = fewer(bits, count, max(EXCHANGES, EXCHANGES_PER_BALL * count), chosen)
    return balls[np.sort(chosen[:count])]


def _bits(balls: Floats, elements: Elements, margin: float) -> np.ndarray:
    """Which ball contains which element by a margin, 64 to a word."""
    bits = np.zeros((len(balls), -(-len(elements.bounds) // 64)), np.uint64)
    reduced = np.column_stack([balls[:, :3], balls[:, 3] - margin])
    contained(reduced, elements.points, elements.first_point, elements.bounds, blocks(elements), bits)
    return bits


def _unite(bits: np.ndarray, count: int) -> np.ndarray:
    """Which of `count` elements are in any ball."""
    together = np.bitwise_or.reduce(bits, axis=0, initial=np.uint64(0))
    return np.unpackbits(together.view(np.uint8), bitorder="little", count=count).astype(bool)
