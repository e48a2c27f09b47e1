"""Decompose a body into convex parts that together contain it, each about what a convex cell holds of it.

Cells are halved by planes, the one whose hull stands off furthest first; each time by the plane, of some along the
cell's principal axes, that leaves the hulls of both halves the least volume. Two cells whose common hull is tight
enough become one again. For all this a small hull represents that of a cell: of the points that are furthest in
directions all around. The parts contain the body by construction, whatever planes are chosen, as long as `OVERLAP`
isn't negative and `_PARALLEL` is tiny: the corners of a cell's body are among those of the triangles clipped at its
sides, and its own corners within the body. How far they stand off (the one-sided Hausdorff distance from the body) is
bounded from above. The other constants choose how many and how tight the parts are, and the time to find them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from guidefield.geometry.convex import convex_hull, hull_planes, polytope_about
from guidefield.geometry.cover import Pieces, bisect_pieces, join_pieces
from guidefield.geometry.solid import Solid, stand_off
from guidefield.geometry.surfaces import Floats, Surface, furthest, heights_along, spread_and_axes, spread_directions
from guidefield.kernels.cover.cut_halves import beyond_any, count_cut, cut_halves, furthest_out

_PARALLEL = 1e-6  # three planes whose normals span less than this meet nowhere that matters


def clip_at(pieces: Pieces, plane: Floats) -> Pieces:
    """Clip triangles at a plane n.p <= d, given as n and d, shape (4,) [m]."""
    heights = heights_along(pieces.corners, plane[:3]) - plane[3]
    below = heights <= 0.0
    count = below.sum(axis=1)
    return join_pieces(
        [pieces.some(count == 3), *_cut(pieces, heights, below, count, 1), *_cut(pieces, heights, below, count, 2)]
    )


def _cut(pieces: Pieces, heights: Floats, below: np.ndarray, count: np.ndarray, corners_below: int) -> list[Pieces]:
    """Return the parts below the plane of triangles with one or two corners below: a triangle each, or two."""
    chosen = np.flatnonzero(count == corners_below)
    rows = np.arange(len(chosen))
    # the corner that is alone on its side comes first
    first = (below[chosen] if corners_below == 1 else ~below[chosen]).argmax(axis=1)
    a, b, c = (pieces.corners[chosen][rows, (first + turn) % 3] for turn in range(3))
    ha, hb, hc = (heights[chosen][rows, (first + turn) % 3][:, None] for turn in range(3))
    sources = pieces.sources[chosen]
    # from what is below, so that neighbours have the same point of their edge, bit for bit
    if corners_below == 1:
        ab, ac = a + ha / (ha - hb) * (b - a), a + ha / (ha - hc) * (c - a)
        return [Pieces(np.stack([a, ab, ac], axis=1), sources)]
    ab, ac = b + hb / (hb - ha) * (a - b), c + hc / (hc - ha) * (a - c)
    return [Pieces(np.stack([ab, b, c], axis=1), sources), Pieces(np.stack([ab, c, ac], axis=1), sources)]


def corners_of_cell(body: Solid, planes: Floats) -> Floats:
    """Return the corners (n, 3) within a closed body of a convex cell with planes (k, 4) [m]."""
    triples = [planes[list(three)] for three in combinations(range(len(planes)), 3)]
    crossing = [three for three in triples if abs(np.linalg.det(three[:, :3])) > _PARALLEL]
    if not crossing:
        return np.empty((0, 3))
    points = np.array([np.linalg.solve(three[:, :3], three[:, 3]) for three in crossing])
    within = (points @ planes[:, :3].T <= planes[:, 3] + 1e-12).all(axis=1)
    points = points[within]
    corners: Floats = points[body.depths(points) > 0.0]
    return corners


PLACES = 7  # planes along each axis that are compared
SAMPLES = 500  # about how many points of a part's surface the comparison looks at
BESIDE = 1e-5  # how far beside a face a plane is tried, as a share of the cell's extent along its normal
DIRECTIONS = 64  # of the points of a half the comparison keeps those furthest in these directions
ALL_AROUND = 96  # a small hull is that of the points furthest in these directions
STAND_OFF_SAMPLES = 64  # least places on a small hull's surface, evenly spread, that its stand-off is estimated by

PLACES_AT_ONCE = 8
"""So many of these places at a time are tested for being inside the body, the furthest from its surface first."""

MOST_BEYOND = 500  # where more points of a cell than these are beyond its small hull, its part is a polytope about them
CELL_GAP = 1e-3  # cells are joined if the boxes about their small hulls are this close [m]
TOLERANCE = 1e-3  # how much too large a part's stand-off may be given, as that of `stand_off`
TOLERANCE_SHARE = 0.25  # the same as a share of the stand-off, where that is more
OVERLAP = 1e-9  # how far a cell reaches beyond its planes [m], so that rounding leaves nothing between two
WORTH = 0.995  # halving has to leave at most this share of the hull's volume


@dataclass(frozen=True, eq=False)
class ConvexPart:
    """A convex part, and how far its surface leaves the body at most [m]."""

    hull: Surface
    stand_off: float


@dataclass(frozen=True, eq=False)
class _Cell:
    """A convex cell: side planes (k, 4), its triangles, points (n, 3) of its hull, small hull, stand-off [m]."""

    planes: Floats
    pieces: Pieces
    points: Floats
    hull: Surface
    stand_off: float


@dataclass(frozen=True, eq=False)
class Decomposition:
    """Convex parts that together contain a body, and one part that contains it all."""

    parts: tuple[ConvexPart, ...]
    hull: ConvexPart

    @property
    def stand_off(self) -> float:
        """How far a part leaves the body, at most [m]."""
        return max(part.stand_off for part in self.parts)


def decompose(body: Solid, tight: float, most: int) -> Decomposition:
    """Decompose a body, or the surface of an open one, and the finer mesh that it represents, into convex parts.

    Args:
        tight: Parts that stand off by no more than this are not halved [m].
        most: How many there may be, before those are joined that can be.

    Raises:
        ValueError: if the body has no hull: it is flat.
    """
    corners = body.surface.corners
    whole = _cell(body, np.empty((0, 4)), Pieces(corners, np.arange(len(corners))), body.surface.vertices)
    if whole is None:
        raise ValueError("a body that is flat has no convex parts")
    open_cells = [whole]
    settled: list[_Cell] = []
    while open_cells and len(open_cells) + len(settled) < most:
        open_cells.sort(key=lambda cell: cell.stand_off)
        worst = open_cells.pop()
        halves = _halves(body, worst) if worst.stand_off > tight else None
        if halves is None:
            settled.append(worst)
        else:
            open_cells += halves
    parts = tuple(_part(body, cell) for cell in _merge_cells(body, settled + open_cells, tight))
    return Decomposition(parts, parts[0] if len(parts) == 1 else _part(body, whole))


def _cell(body: Solid, planes: Floats, pieces: Pieces, points: Floats) -> _Cell | None:
    """A cell that holds triangles with these points among its own; None if there is no hull."""
    if body.closed:
        points = np.vstack([points, corners_of_cell(body, planes)])
    hull = _small_hull(points)
    if hull is None:
        return None
    return _Cell(planes, pieces, points, hull, _stand_off(hull, body))


def _stand_off(hull: Surface, body: Solid) -> float:
    """Estimate a hull's stand-off [m]: that of the middles of small triangles of its surface, and a share more."""
    pieces = Pieces(hull.corners, np.zeros(len(hull.triangles), np.int64))
    pieces = bisect_pieces(pieces, max(float(np.sqrt(4.0 * pieces.area / STAND_OFF_SAMPLES)), _LEAST))
    middles = pieces.corners.mean(axis=1)
    distances = body.distances(middles)
    for some in np.split(np.argsort(-distances, kind="stable"), range(PLACES_AT_ONCE, len(middles), PLACES_AT_ONCE)):
        outside = body.depths(middles[some]) < 0.0  # that takes longer than the distance
        if outside.any():
            return (1.0 + TOLERANCE_SHARE) * float(distances[some][outside].max())
    return 0.0


def _small_hull(points: Floats) -> Surface | None:
    """Return the hull of the points that are furthest in directions all around; None if it is flat."""
    if not len(points):
        return None
    extent = np.ptp(points, axis=0)
    scale = np.maximum(extent, max(_THINNEST * float(extent.max()), _LEAST))
    try:
        return convex_hull(points[np.unique(furthest(points, _ALL_AROUND / scale))])
    except ValueError:
        return None


def _part(body: Solid, cell: _Cell) -> ConvexPart:
    hull = _hull_about(cell)
    if body.reach > 0.0:
        hull = convex_hull((hull.vertices[:, None] + body.reach * _CUBE).reshape(-1, 3))
    return ConvexPart(hull, body.reach + stand_off(hull, body, tolerance=TOLERANCE, share=TOLERANCE_SHARE))


def _hull_about(cell: _Cell) -> Surface:
    """The hull of a cell's points; where many are beyond its small hull, a polytope about them."""
    beyond, planes = np.empty(len(cell.points), np.bool_), hull_planes(cell.hull, len(cell.hull.triangles))
    beyond_any(np.ascontiguousarray(cell.points), planes, 0.0, beyond)
    if np.count_nonzero(beyond) <= MOST_BEYOND:
        return convex_hull(np.concatenate([cell.hull.vertices, cell.points[beyond]]))
    return convex_hull(polytope_about(cell.points))


def _halves(body: Solid, cell: _Cell) -> tuple[_Cell, _Cell] | None:
    """The two halves of a cell by the best plane that is worth it; None if there is none."""
    for plane in _planes(cell):
        halves = []
        for side in (plane, -plane):
            beyond = np.append(side[:3], side[3] + OVERLAP)
            half = _half(body, cell, beyond)
            if half is not None:
                halves.append(half)
        if len(halves) == 2:
            return halves[0], halves[1]
    return None


def _half(body: Solid, cell: _Cell, beyond: Floats) -> _Cell | None:
    below = heights_along(cell.pieces.corners, beyond[:3]) <= beyond[3]
    whole, across = below.all(axis=1), below.any(axis=1) & ~below.all(axis=1)
    cut = clip_at(cell.pieces.some(across), beyond)
    points = cell.points[heights_along(cell.points, beyond[:3]) <= beyond[3]]
    return _cell(
        body,
        np.vstack([cell.planes, beyond]),
        join_pieces([cell.pieces.some(whole), cut]),
        np.concatenate([points, cut.corners.reshape(-1, 3)]),
    )


def _planes(cell: _Cell) -> Floats:
    """Planes (n, 4) that are worth halving a cell by, the best first."""
    samples = _Samples(cell)
    whole = samples.volume()
    rated = []
    for axis in _different(np.vstack([samples.axes, np.eye(3)])):
        rated += [(left, *axis, place) for place, left in samples.volumes_across(axis) if left < WORTH * whole]
    planes: Floats = np.array(sorted(rated)[:4]).reshape(-1, 5)[:, 1:]
    return planes


def _different(axes: Floats) -> Floats:
    """Drop unit vectors (n, 3) along an earlier one."""
    along = np.tril(np.abs(axes @ axes.T), -1) > _SAME_AXIS
    different: Floats = axes[~along.any(axis=1)]
    return different


class _Samples:
    """Points on the surface of a cell's share, with principal axes, to compare the hulls of its halves by."""

    axes: Floats

    def __init__(self, cell: _Cell) -> None:
        size = max(float(np.sqrt(4.0 * cell.pieces.area / SAMPLES)), 1e-9)
        self._pieces = bisect_pieces(cell.pieces, size)
        corners = self._pieces.corners.reshape(-1, 3)
        cells = np.floor((corners - corners.min(axis=0)) / size).astype(np.int64)
        _, first = np.unique(np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1)), return_index=True)
        self._pieces = self._pieces.some(np.unique(first // 3))
        self._points = np.vstack([corners[np.sort(first)], cell.hull.vertices])
        spread, self.axes = spread_and_axes(self._points - self._points.mean(axis=0))
        self._seen = np.ascontiguousarray((self.axes.T / np.maximum(spread, 1e-9 * spread[0])) @ _DIRECTIONS.T)

    def volume(self) -> float:
        corners = self._points[furthest(self._points, self._seen.T)]
        return float(_volumes(corners[None], self._points[:1])[0])

    def volumes_across(self, axis: Floats) -> list[tuple[float, float]]:
        """Return places of planes across an axis [m], and estimates of both halves' hull volumes together [m^3]."""
        along, corners = heights_along(self._points, axis), heights_along(self._pieces.corners, axis)
        places = np.array(_places(along))
        cut, first = np.empty((count_cut(corners, places), 3)), np.empty(2 * len(places) + 1, np.int64)
        cut_halves(self._pieces.corners, corners, places, cut, first)
        origins, corners_of = np.empty((2 * len(places), 3)), np.empty((2 * len(places), DIRECTIONS, 3))
        furthest_out(self._points, along, cut, first, places, self._seen, origins, corners_of)
        volumes = _volumes(corners_of, origins)
        volumes[np.isnan(origins[:, 0])] = 0.0
        return list(zip(places.tolist(), (volumes[::2] + volumes[1::2]).tolist(), strict=True))


def _places(along: Floats) -> list[float]:
    """Return the places of planes to try [m]; beside a face that lies in one, so that one half has it all."""
    low, high = float(along.min()), float(along.max())
    beside = BESIDE * (high - low)
    found = []
    for place in low + (high - low) * np.arange(1, PLACES + 1) / (PLACES + 1):
        in_plane = bool((np.abs(along - place) < 0.5 * beside).any())
        found += [place - beside, place + beside] if in_plane else [place]
    return found


def _volumes(corners: Floats, origins: Floats) -> Floats:
    """Estimate the volumes (n,) of hulls [m^3] by corners (n, d, 3) furthest in `_DIRECTIONS`, about origins (n, 3).

    They are joined as the directions are, which a hull's own corners nearly are.
    """
    x, y, z = np.moveaxis(corners - origins[:, None], 2, 0)
    (ax, bx, cx), (ay, by, cy), (az, bz, cz) = (np.moveaxis(along[:, _FACES], 2, 0) for along in (x, y, z))
    products = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    volumes: Floats = np.abs(products.sum(axis=1)) / 6.0
    return volumes


_DIRECTIONS, _FACES = convex_hull(spread_directions(DIRECTIONS))
"""Directions over the sphere, about evenly, and the triangles between neighbours."""

_ALL_AROUND = spread_directions(ALL_AROUND)

_CUBE = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))  # corners of a cube that contains the ball of radius 1

_THINNEST, _LEAST = 1e-9, 1e-12
"""Extents that directions are scaled by: at least this share of the largest one, and this [m]."""

_SAME_AXIS = 0.999  # cosine of axes that are not told apart


def _merge_cells(body: Solid, cells: list[_Cell], tight: float) -> list[_Cell]:
    tried: set[tuple[int, int]] = set()
    while True:
        pairs = [(a, b) for a, b in itertools.combinations(cells, 2) if (id(a), id(b)) not in tried and _touch(a, b)]
        for a, b in pairs:
            tried.add((id(a), id(b)))
            if _is_open_between(body, a, b, tight):
                continue
            hull = _small_hull(np.vstack([a.hull.vertices, b.hull.vertices]))
            if hull is None:
                continue
            distance = _stand_off(hull, body)
            if distance <= tight:
                pieces, points = join_pieces([a.pieces, b.pieces]), np.vstack([a.points, b.points])
                together = _Cell(np.empty((0, 4)), pieces, points, hull, distance)
                cells = [cell for cell in cells if cell not in (a, b)] + [together]
                break
        else:
            return cells


def _is_open_between(body: Solid, a: _Cell, b: _Cell, tight: float) -> bool:
    """Whether a point between two small hulls, so of their common hull, is further than `tight` [m] from the body."""
    ends, middle = [cell.hull.vertices[furthest(cell.hull.vertices, _DIRECTIONS)] for cell in (a, b)], DIRECTIONS // 2
    between = np.concatenate([0.5 * (ends[0] + ends[1]), 0.5 * (ends[0] + np.roll(ends[1], middle, axis=0))])
    return bool((body.depths(between) < -tight).any())


def _touch(a: _Cell, b: _Cell) -> bool:
    """Whether the boxes about two small hulls are as close as they may be where their cells touch."""
    low = np.maximum(a.hull.vertices.min(axis=0), b.hull.vertices.min(axis=0))
    high = np.minimum(a.hull.vertices.max(axis=0), b.hull.vertices.max(axis=0))
    return bool((low <= high + CELL_GAP).all())
