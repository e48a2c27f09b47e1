"""Cover a body for certain with few bounding spheres ("balls") that leave it by no more than a given overhang.

A ball of radius depth(c) + delta about a point c of a body stays within delta of it: the first depth(c) of every ray
from c is in the body. The surface is cut into small elements; a ball contains a triangle if it contains its corners, so
the chosen balls contain the surface exactly, and by a margin. That the inside is contained too is proved by halving a
box about the body until each cell is in a ball, outside, or within the margin of the surface; a cell that isn't gets a
ball. Depths are distances to triangles, so both promises hold up to rounding, whatever the shape.

Candidates are balls about points of the medial axis. Few are chosen by a greedy set cover (Chvatal, Mathematics of
Operations Research 4, 1979), and shrink to what they own. Most constants trade the number of balls against the time to
find them. The containment is proved as long as elements make up the surface without a gap, `_ROOT_SLACK` and
`_CELLS_AT_ONCE` are at least 1, and `MARGIN` isn't negative; the overhang is kept by `_ROUNDING` below 1 and
`LEAST_OVERHANG` of at most 1. By `LEAST_REACHES` and `MOST_BALLS` bodies are refused. Collision kernels read `Cover`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from guidefield.geometry.curve_order import curve_order
from guidefield.geometry.solid import Solid
from guidefield.geometry.surfaces import Floats, Integers, area_of
from guidefield.kernels.cover.ball_cover import contained, greedy_choice, reaches
from guidefield.kernels.cover.enclosing_ball import ball_around_balls, largest_distances, smallest_ball, smallest_balls
from guidefield.kernels.cover.inscribed import tangent_balls, uncovered_cells
from guidefield.kernels.cover.pieces import (
    balls_about,
    cell_middles,
    distinct_points,
    gather,
    grid_cells,
    halve,
    longest_edges,
    stable_order,
)


class Pieces(NamedTuple):
    """Triangles, shape (n, 3, 3) [m], that are parts of those of a surface, shape (n,)."""

    corners: Floats
    sources: Integers

    @property
    def area(self) -> float:
        """Area of all [m^2]."""
        return area_of(self.corners)

    def some(self, chosen: np.ndarray | slice) -> Pieces:
        """Return the pieces that indices (k,), a mask (n,) or a slice choose."""
        return Pieces(self.corners[chosen], self.sources[chosen])


class Elements(NamedTuple):
    """Pieces of a surface that lie together, at least one in each element."""

    pieces: Pieces  # those of the same element together
    first: Integers  # first piece of each element, and the number of all, shape (m + 1,)
    points: Floats  # corners of the pieces of each element, equal ones once, shape (k, 3) [m]
    first_point: Integers  # first point of each element, and the number of all, shape (m + 1,)
    bounds: Floats  # a ball about each element: centre and radius, shape (m, 4) [m]

    def some(self, chosen: np.ndarray) -> Elements:
        """Return the elements that a mask, shape (m,), chooses."""
        if chosen.all():
            return self
        counts, of_points = np.diff(self.first), np.diff(self.first_point)
        return Elements(
            self.pieces.some(np.repeat(chosen, counts)),
            _starts(counts[chosen]),
            self.points[np.repeat(chosen, of_points)],
            _starts(of_points[chosen]),
            np.ascontiguousarray(self.bounds[chosen]),
        )


def bisect_pieces(pieces: Pieces, size: float) -> Pieces:
    """Pieces halved at the middle of their longest edge until none has an edge longer than `size` [m]."""
    corners, sources = np.ascontiguousarray(pieces.corners), np.ascontiguousarray(pieces.sources)
    done = []
    while len(corners):
        edges = np.empty(len(corners), np.int64)
        large = longest_edges(corners, size, edges)
        small, halves = _allocate(len(corners) - large), _allocate(2 * large)
        halve(corners, sources, edges, *small, *halves)
        done.append(small)
        corners, sources = halves
    return join_pieces(done)


def _allocate(count: int) -> Pieces:
    return Pieces(np.empty((count, 3, 3)), np.empty(count, np.int64))


def join_pieces(parts: list[Pieces]) -> Pieces:
    """Return all pieces of several."""
    return Pieces(np.concatenate([part.corners for part in parts]), np.concatenate([part.sources for part in parts]))


def gather_elements(pieces: Pieces, size: float) -> Elements:
    """Elements of pieces whose centroids lie in the same cell of a grid of width `size` [m]; neighbours together."""
    corners, count = np.ascontiguousarray(pieces.corners), len(pieces.sources)
    cells, order, first = np.empty(count, np.int64), np.empty(count, np.int64), np.empty(count + 1, np.int64)
    grid_cells(corners, size, cells)
    stable_order(cells, order)
    middles = np.empty((count, 3))
    found = cell_middles(corners, cells, order, first, middles)
    turn = curve_order(middles[:found])
    together, starts = _allocate(count), np.empty(found + 1, np.int64)
    gather(corners, np.ascontiguousarray(pieces.sources), order, first, turn, *together, starts)
    points, first_point = np.empty((3 * count, 3)), np.empty(found + 1, np.int64)
    points = points[: distinct_points(together.corners.reshape(-1, 3), 3 * starts, points, first_point)]
    return Elements(together, starts, points, first_point, _balls(points, first_point))


def blocks(elements: Elements) -> Floats:
    """A ball about every 64 elements, the last perhaps fewer, shape (m / 64 rounded up, 4) [m]."""
    first = np.append(elements.first_point[:-1:64], elements.first_point[-1])
    return _balls(elements.points, first)


def _balls(points: Floats, first: Integers) -> Floats:
    balls = np.empty((len(first) - 1, 4))
    balls_about(points, first, balls)
    return balls


def unite_elements(parts: list[Elements]) -> Elements:
    """Return all elements of several."""
    return Elements(
        join_pieces([part.pieces for part in parts]),
        _starts(np.concatenate([np.diff(part.first) for part in parts])),
        np.concatenate([part.points for part in parts]),
        _starts(np.concatenate([np.diff(part.first_point) for part in parts])),
        np.concatenate([part.bounds for part in parts]),
    )


def _starts(counts: Integers) -> Integers:
    return np.concatenate([[0], np.cumsum(counts)])


def medial_balls(body: Solid, elements: Elements, most: int, resolution: float, slack: float = 0.0) -> Floats:
    """Find the largest balls within a closed body that all but touch its surface in elements of it.

    A ball within the body is moved away from the nearest surface and grown until it touches another: on the medial
    axis.

    Args:
        elements: Of its surface.
        most: About how many pieces of them to start from.
        resolution: Of balls with centres closer than about this, one is kept [m].
        slack: By how much balls may miss the surface, so that they grow past facets of a round one [m].

    Returns:
        Centre and depth, shape (n, 4) [m], the deepest first.
    """
    corners, sources = elements.pieces.some(slice(None, None, max(1, len(elements.pieces.sources) // most)))
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    wide = lengths > 0.0
    points = np.ascontiguousarray(corners[wide].mean(axis=1))
    inward = -normals[wide] / lengths[wide, None]
    centres = np.empty_like(points)
    size = float(np.linalg.norm(np.ptp(body.surface.vertices, axis=0)))
    tangent_balls(points, inward, body.owners[sources[wide]], body.tables, body.spans, size, slack, centres)
    depths = body.depths(centres)
    order = np.argsort(-depths, kind="stable")
    order = order[depths[order] > 0.0]
    cells = np.floor(centres[order] / resolution).astype(np.int64)
    cells -= cells.min(axis=0) if len(cells) else 0  # each cell gets a number of its own
    counts = cells.max(axis=0, initial=0) + 1
    _, first = np.unique((cells[:, 0] * counts[1] + cells[:, 1]) * counts[2] + cells[:, 2], return_index=True)
    kept = order[np.sort(first)]
    return np.column_stack([centres[kept], depths[kept]])


MARGIN = 0.02  # by how much balls contain the surface, as a share of delta
ELEMENT = 0.3  # longest edge of an element's triangles, as a share of delta
CANDIDATE = 0.5  # about the spacing of candidates along the surface, as a share of delta
RESOLUTION = 0.1  # of candidates closer to each other than this, one is kept; as a share of delta

MOST_PIECES = 50_000
"""Where a body is so large that there would be more, its elements are larger, as long as balls contain them.

That begins at an area of 1125 delta^2. Measured on the 43 links of five large arms: covers take 0.54 of the time that a
limit of a million took, and have 9 % more balls; 30,000 would take 0.39 of it, with 16 % more balls.
"""

LEAST_REACHES = 5.0  # delta has to be at least this many times `Solid.reach`; well above 2, as `cover` takes off two
MOST_BALLS = 200_000  # a cover that may need more is refused; above `LARGE` of robot/link_bounds.py, or robots are, too
CHUNK = 30_000  # this many elements are examined together
_ROUNDING = 1.0 - 1e-9  # which share of delta is used, so that no rounding leads beyond it

LEAST_CANDIDATES, MOST_CANDIDATES = 300, 2_000  # of candidates for the elements that are examined together

Offer = Callable[[Solid, Elements, int, float], Floats]
"""Propose balls, centre and depth (n, 4) [m], for a body and elements: about how many, and how close at least [m]."""


@dataclass(frozen=True, eq=False)
class Cover:
    """Balls that contain a body; read-only, in the body's frame."""

    spheres: Floats  # centre and radius, shape (n, 4) [m]; those of a group together
    overhangs: Floats  # by how much each leaves the body at most, shape (n,) [m]
    groups: Floats  # balls about groups of them, shape (g, 4) [m]
    first: Integers  # first sphere of each group, and the number of all, shape (g + 1,)
    bound: Floats  # one small ball about the body, shape (4,) [m]

    @property
    def overhang(self) -> float:
        """The largest overhang [m]."""
        return float(self.overhangs.max())


def cover(body: Solid, delta: float) -> Cover:
    """Cover a body, and the finer mesh within `Solid.reach` of it, with balls that leave it by at most `delta` [m].

    Where gaps of its surface were closed, the overhang is that over the closed surface.

    Raises:
        ValueError: if `delta` is not positive, or so small that there might be very many balls, or less than
            `LEAST_REACHES` times `Solid.reach`.
    """
    if not (delta > 0.0 and np.isfinite(delta)):
        raise ValueError(f"`delta` must be positive, got {delta} m")
    if delta < LEAST_REACHES * body.reach:
        raise ValueError(f"an overhang of {delta} m is too little for a body that stands for one {body.reach} m off")
    if body.area > MOST_BALLS * delta * delta:
        raise ValueError(f"an overhang of {delta} m takes too many balls for a surface of {body.area} m^2")
    delta = _ROUNDING * delta - body.reach
    margin = MARGIN * delta + body.reach
    balls, elements = _choose_balls(body, delta, margin)
    balls = shrink_balls(body, balls, elements, delta, margin)
    if body.closed:
        balls = contain_interior(body, balls, delta, margin)
    bound = enclosing_ball(body.surface.vertices) + np.array([0.0, 0.0, 0.0, body.reach])
    return assemble_cover(balls, body.depths(balls[:, :3]) - body.reach, bound)


def assemble_cover(balls: Floats, depths: Floats, bound: Floats) -> Cover:
    """Group balls (n, 4) whose centres have depths (n,) in a body within a ball (4,) [m]."""
    order, groups, first = group_balls(balls)
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


def _choose_balls(body: Solid, delta: float, margin: float) -> tuple[Floats, Elements]:
    """Choose balls, as large as they may be, that contain the surface by a margin; return also the surface's elements.

    Elements that no medial ball contains are offered balls about the elements themselves, then smaller elements.
    """
    corners = body.surface.corners
    pieces = Pieces(corners, np.arange(len(corners)))
    size = max(ELEMENT * delta, float(np.sqrt(4.0 * body.area / MOST_PIECES)))
    offer = medial_balls if body.closed else _about_elements
    balls: list[Floats] = []
    covered: list[Elements] = []
    while len(pieces.sources):
        left_out = []
        elements = gather_elements(bisect_pieces(pieces, size), 0.8 * size)
        while len(elements.bounds):
            now = np.arange(len(elements.bounds)) < CHUNK
            looked_at = elements.some(now)
            candidates = _candidates(body, looked_at, offer, delta)
            chosen = _choose_few(candidates[candidates[:, 3] > margin], looked_at, margin)
            united_bits = np.bitwise_or.reduce(_bits(chosen, elements, margin), axis=0, initial=np.uint64(0))
            count = len(elements.bounds)
            inside = np.unpackbits(united_bits.view(np.uint8), bitorder="little", count=count).astype(bool)
            balls.append(chosen)
            covered.append(elements.some(inside))
            left_out.append(elements.some(now & ~inside).pieces)
            elements = elements.some(~now & ~inside)
        pieces = join_pieces(left_out)
        size *= 1.0 if offer is medial_balls else 0.5
        offer = _about_elements
    return np.concatenate(balls), unite_elements(covered)


def _candidates(body: Solid, elements: Elements, offer: Offer, delta: float) -> Floats:
    most = int(np.clip(elements.pieces.area / (CANDIDATE * delta) ** 2, LEAST_CANDIDATES, MOST_CANDIDATES))
    balls = offer(body, elements, most, RESOLUTION * delta)
    return np.column_stack([balls[:, :3], balls[:, 3] + delta])


def _about_elements(body: Solid, elements: Elements, most: int, resolution: float) -> Floats:
    """Centres of about `most` elements, and balls about the medial axis; with depths, which may be negative."""
    centres = np.ascontiguousarray(elements.bounds[:: max(1, len(elements.bounds) // most), :3])
    own = np.column_stack([centres, body.depths(centres)])
    return np.vstack([own, medial_balls(body, elements, most, resolution)]) if body.closed else own


def _choose_few(balls: Floats, elements: Elements, margin: float) -> Floats:
    bits = _bits(balls, elements, margin)
    chosen = np.empty(len(bits), np.int64)
    count = greedy_choice(bits, chosen)
    return balls[np.sort(chosen[:count])]


def _bits(balls: Floats, elements: Elements, margin: float) -> np.ndarray:
    """Return the bit matrix of which ball contains which element by a margin, 64 elements to a word."""
    bits = np.zeros((len(balls), -(-len(elements.bounds) // 64)), np.uint64)
    reduced = np.column_stack([balls[:, :3], balls[:, 3] - margin])
    contained(reduced, elements.points, elements.first_point, elements.bounds, blocks(elements), bits)
    return bits


MOVES = (1.0, 0.5, 0.25)
"""Shares, tried in turn, of a centre's way to the centre of the smallest ball about the elements it owns."""

LEAST_OVERHANG = 0.1
"""Least overhang of a ball, as a share of delta: less would make the proof for the inside look at very many cells."""


def shrink_balls(body: Solid, balls: Floats, elements: Elements, delta: float, margin: float) -> Floats:
    """Give each element to one of the balls (n, 4) that contain it by a margin [m]; shrink balls to what they own.

    Balls that own nothing go. None of those returned, (m, 4), leaves the body by more than `delta` [m].
    """
    radii, owners = np.empty(len(balls)), np.empty(len(elements.bounds), np.int64)
    reduced = np.column_stack([balls[:, :3], balls[:, 3] - margin])
    reaches(reduced, elements.points, elements.first_point, elements.bounds, blocks(elements), radii, owners)
    kept, owners = np.unique(owners, return_inverse=True)
    owners = owners.reshape(-1)
    small = np.column_stack([balls[kept, :3], radii[kept] + margin])
    small = _recentre(body, small, elements, owners, delta, margin)
    small[:, 3] = np.maximum(small[:, 3], body.depths(small[:, :3]) + LEAST_OVERHANG * delta)
    return small


def _recentre(body: Solid, balls: Floats, elements: Elements, owners: Integers, delta: float, margin: float) -> Floats:
    """Move balls towards the smallest about what they own, where that makes them smaller and keeps the overhang."""
    owned, first = _find_owned_points(elements, owners, len(balls))
    targets, radii = np.empty((len(balls), 4)), np.empty(len(balls))
    smallest_balls(owned, first, targets)
    result = balls.copy()
    for share in MOVES:
        centres = balls[:, :3] + share * (targets[:, :3] - balls[:, :3])
        largest_distances(owned, first, centres, radii)
        radii += margin
        better = (radii < result[:, 3]) & (radii <= body.depths(centres) + delta)
        result[better] = np.column_stack([centres, radii])[better]
    return result


def _find_owned_points(elements: Elements, owners: Integers, balls: int) -> tuple[Floats, Integers]:
    """The points (k, 3) of what each ball owns together [m], and where those of each begin, and k."""
    of_points = np.repeat(owners, np.diff(elements.first_point))
    order, first = np.empty(len(of_points), np.int64), np.zeros(balls + 1, np.int64)
    stable_order(of_points, order)
    np.cumsum(np.bincount(of_points, minlength=balls), out=first[1:])
    return elements.points[order], first


GROUP = 8  # most balls of a group


def enclosing_ball(points: Floats) -> Floats:
    """Return centre and radius, shape (4,) [m], of the smallest ball about points (n, 3)."""
    ball = np.empty(4)
    smallest_ball(np.ascontiguousarray(points), ball)
    return ball


def group_balls(balls: Floats) -> tuple[Integers, Floats, Integers]:
    """Group neighbouring balls (n, 4), n >= 1.

    Returns:
        The order of balls by group, shape (n,); a ball around each group, shape (g, 4) [m]; the first ball of each,
        and n, shape (g + 1,).
    """
    groups = _halve(balls, np.arange(len(balls)))
    around = np.empty((len(groups), 4))
    for group, members in enumerate(groups):
        ball_around_balls(np.ascontiguousarray(balls[members]), around[group])
    return np.concatenate(groups), around, np.concatenate([[0], np.cumsum([len(members) for members in groups])])


def _halve(balls: Floats, members: Integers) -> list[Integers]:
    """Members split across their longest extent, in as equal halves as groups of full size allow."""
    if len(members) <= GROUP:
        return [members]
    centres = balls[members, :3]
    axis = int(np.ptp(centres, axis=0).argmax())
    order = members[np.argsort(centres[:, axis], kind="stable")]
    half = GROUP * -(-len(members) // (2 * GROUP))
    return _halve(balls, order[:half]) + _halve(balls, order[half:])


_CELLS_AT_ONCE = 4096  # most uncovered cells that the kernel returns at a time

_ROOT_SLACK = 1.0 + 1e-9  # by which the box about the body is larger, so that rounding leaves nothing outside


def contain_interior(body: Solid, balls: Floats, delta: float, margin: float) -> Floats:
    """Grow balls (n, 4) that contain a closed body's surface by a margin [m] to (m, 4) that contain all of it.

    For every cell of the inside that is in no ball, the ball that has to grow least is grown; if none may, because it
    would leave the body by more than `delta` [m], there is a new one about the cell.
    """
    balls = np.ascontiguousarray(balls)
    allowed = body.depths(balls[:, :3]) + delta
    low, high = body.surface.vertices.min(axis=0), body.surface.vertices.max(axis=0)
    box = np.array([[*(0.5 * (low + high)), 0.5 * float((high - low).max()) * _ROOT_SLACK]])
    cells = np.empty((_CELLS_AT_ONCE, 5))  # centre (3), half size, depth of the centre [m]
    while count := uncovered_cells(balls, box, margin, body.tables, body.spans, cells):
        for cell in cells[:count]:
            needed = _corner_distance(balls, cell)
            if (needed <= balls[:, 3]).any():
                continue
            growth = np.where(needed <= allowed, needed - balls[:, 3], np.inf)
            best = int(growth.argmin())
            if growth[best] < np.inf:
                balls[best, 3] = needed[best]
                continue
            largest = cell[4] + delta
            balls, allowed = np.vstack([balls, [*cell[:3], largest]]), np.append(allowed, largest)
    return balls


def _corner_distance(balls: Floats, cell: Floats) -> Floats:
    """Distances (n,) from the balls' centres to the farthest corner of a cell: centre and half size [m]."""
    offsets = np.abs(balls[:, :3] - cell[:3]) + cell[3]
    # a little more, so that the kernel's rounding agrees that the cell is contained
    distances: Floats = np.sqrt((offsets * offsets).sum(axis=1)) * (1.0 + 1e-12)
    return distances
