"""Draw the field in a plane through a scene, also at a time: dark valleys between bright walls, with contours.

A unit charge is pushed down into the valleys; where the potential is Phi it is as if a large wall were 2 pi/Phi away.
Colours and contours follow that distance: it is what a person can read. Accuracy is a few thousandths, for recordings
alone; descents of the planner read `single_tables`, and nothing else here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.geometry.far_tree import with_far_trees
from guidefield.kernels.field.field import Field, FieldTables, field_at_points, single_precision
from guidefield.memo import memoized
from guidefield.scene.scene import Scene

Origin = tuple[float, float, float]


@memoized
def single_tables(scene: Scene, origin: Origin) -> FieldTables:
    """Return the scene's field in single precision, relative to an origin near the points of interest [m, world]."""
    return single_precision(scene.tables, np.array(origin))


@memoized
def coarse_tables(scene: Scene, origin: Origin) -> FieldTables:
    """Return `single_tables` with expansions for all that is far away, for pictures: see `with_far_trees`."""
    return single_precision(with_far_trees(scene.tables), np.array(origin))


def field_in_time(
    scene: Scene, points: np.ndarray, times: np.ndarray | None, origin: Origin
) -> tuple[np.ndarray, np.ndarray]:
    """Return potential (n, p) [1/m] and gradient (n, p, 3) [1/m^2] at points (n, p, 3) to a few thousandths.

    Each row of points has its time [s], (n,); None: all obstacles are at their first placements. The origin is a place
    in the midst of the points [m, world].
    """
    field = field_at_points(coarse_tables(scene.resting, origin), points.reshape(-1, 3))
    potential, gradient = field.potential.reshape(points.shape[:2]), field.gradient.reshape(points.shape)
    if scene.moves:
        for_movers = field_of_movers(scene, points, times)
        potential, gradient = potential + for_movers[0], gradient + for_movers[1]
    return potential, gradient


def field_of_movers(scene: Scene, points: np.ndarray, times: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Return what the moving obstacles add to the field; the arguments and the result are those of `field_in_time`."""
    potential, gradient = np.zeros(points.shape[:2]), np.zeros(points.shape)
    for tables, motion in _movers(scene):
        moves = [_move(motion, time) for time in ([-np.inf] * len(points) if times is None else times.tolist())]
        rotations, translations = np.array([m[:3, :3] for m in moves]), np.array([m[:3, 3] for m in moves])
        in_its_frame = (points - translations[:, None]) @ rotations
        field = field_at_points(tables, in_its_frame.reshape(-1, 3))
        potential += field.potential.reshape(points.shape[:2])
        gradient += field.gradient.reshape(points.shape) @ rotations.swapaxes(1, 2)
    return potential, gradient


def _move(motion: Any, time: float) -> np.ndarray:
    """Return the motion of an obstacle from its first placement to that at a time [s], shape (4, 4)."""
    move: np.ndarray = (motion.at(time) * motion.placements[0].inverse()).homogeneous
    return move


@memoized
def _movers(scene: Scene) -> tuple[tuple[FieldTables, Any], ...]:
    movers = [(index, scene.obstacles[index]) for index in scene.others]
    return tuple(
        (single_precision(scene.of([index]).tables, one.placement.translation), one.motion)
        for index, one in movers
        if one.motion is not None
    )


MARGIN = 0.5  # margin around a path in a picture, over the path's extent
LEAST_MARGIN = 0.3  # least margin [m]
STRAIGHT = 0.05  # a path is straight if it strays from a line by less than this share of its length
_UPRIGHT = 0.3  # up in a picture is the world's vertical if at least this share of it lies in the plane


@dataclass(frozen=True, eq=False)
class SlicePlane:
    """A rectangle in the world; a picture on it has its first row and column at the corner (3,) [m].

    The first row leads `across` (3,) to the last column, the first column `down` (3,), at right angles to that [m].
    """

    corner: np.ndarray
    across: np.ndarray
    down: np.ndarray

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [m]."""
        return float(np.linalg.norm(self.across)), float(np.linalg.norm(self.down))

    @property
    def pose(self) -> Any:
        """T_world_plane, a pinocchio.SE3: from the rectangle's centre, x to the right, y up, z to who looks at it."""
        x, y = self.across / self.size[0], -self.down / self.size[1]
        return pin.SE3(np.column_stack([x, y, np.cross(x, y)]), self.corner + 0.5 * (self.across + self.down))

    @property
    def corners(self) -> np.ndarray:
        """Corners: the picture's first, the end of its first row, its last, the end of its first column; (4, 3) [m]."""
        corners: np.ndarray = self.corner + np.outer([0, 1, 1, 0], self.across) + np.outer([0, 0, 1, 1], self.down)
        return corners

    def pixels(self, resolution: int) -> tuple[int, int]:
        """Return rows and columns of a picture, by its pixels along the longer side; ValueError if not positive."""
        if resolution < 1:
            raise ValueError(f"`resolution` must be positive, got {resolution}")
        width, height = self.size
        return (
            max(1, round(resolution * height / max(width, height))),
            max(1, round(resolution * width / max(width, height))),
        )

    def points(self, rows: int, columns: int) -> np.ndarray:
        """Centres of the pixels, shape (rows, columns, 3) [m]."""
        s, t = (np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows
        points: np.ndarray = self.corner + s[None, :, None] * self.across + t[:, None, None] * self.down
        return points

    def projected(self, points: np.ndarray, rows: int, columns: int) -> np.ndarray:
        """Project points of the world, shape (n, 3) [m], to column and row of a picture, shape (n, 2) [pixels]."""
        offsets = np.asarray(points, float) - self.corner
        return np.column_stack(
            [
                offsets @ self.across * (columns / (self.across @ self.across)),
                offsets @ self.down * (rows / (self.down @ self.down)),
            ]
        )


def planes_along(path: np.ndarray) -> tuple[SlicePlane, SlicePlane]:
    """Choose two planes in which a path can be followed: the one that fits it best, and one across that along it.

    Both go through the middle of the tip's path, shape (n, 3) [m, world], and contain its main direction, so that a
    path that is nearly flat runs in the first and, from the side, along the second. For a straight path the first is as
    level as it can be. They show the path with a margin on all sides; up in the picture is up in the world, or, seen
    from above, the world's y. Raises ValueError if there are no positions, or one isn't finite.
    """
    path = np.asarray(path, dtype=np.float64)
    if path.ndim != 2 or path.shape[1] != 3 or not len(path) or not np.isfinite(path).all():
        raise ValueError(f"`path` must be finite positions, shape (n, 3), got shape {path.shape}")
    middle = 0.5 * (path.min(axis=0) + path.max(axis=0))
    _, strays, axes = np.linalg.svd(path - path.mean(axis=0), full_matrices=len(path) < 3)
    strays = np.r_[strays, np.zeros(3 - len(strays))]
    main = axes[0] if strays[0] > 0.0 else np.array([1.0, 0.0, 0.0])
    if strays[1] > STRAIGHT * strays[0]:
        sideways = axes[1]
    else:
        level = np.cross([0.0, 0.0, 1.0], main)
        sideways = level / np.linalg.norm(level) if np.linalg.norm(level) > STRAIGHT else np.array([0.0, 1.0, 0.0])
    normal = np.cross(main, sideways)
    return _frame(path, middle, normal / np.linalg.norm(normal)), _frame(path, middle, sideways)


def _frame(path: np.ndarray, middle: np.ndarray, normal: np.ndarray) -> SlicePlane:
    """Return the rectangle across a normal that shows a path with its margin, seen from above or from the front."""
    vertical = np.array([0.0, 0.0, 1.0])
    up = vertical - (normal @ vertical) * normal
    if np.linalg.norm(up) < _UPRIGHT:
        normal = normal if normal[2] > 0.0 else -normal
        up = np.array([0.0, 1.0, 0.0]) - normal[1] * normal
    up /= np.linalg.norm(up)
    right = np.cross(up, normal)
    spans = []
    for axis in (right, up):
        along = (path - middle) @ axis
        margin = max(LEAST_MARGIN, MARGIN * float(np.ptp(path @ axis)))
        spans.append((along.min() - margin, along.max() + margin))
    (left, past), (bottom, top) = spans
    return SlicePlane(middle + left * right + top * up, (past - left) * right, (bottom - top) * up)


CONTOURS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Distances of a wall whose potential the contour lines mark [m]."""

FINE_CONTOURS = (0.015, 0.025, 0.03, 0.04, 0.06, 0.07, 0.08, 0.15, 0.25, 0.3, 0.4, 0.6, 0.7, 0.8, 1.5, 2.5, 3.0, 4.0)
"""Distances of fainter lines between them: they show the valley of a narrow passage."""

NEAREST = 0.015  # a wall at this distance or nearer has the brightest colour [m]
LEAST_DECADES = 0.5  # the least number of powers of ten that the colours span
SOLID_COLOR = (98, 101, 108)  # inside of solids

_VIRIDIS = np.array(
    [(68, 1, 84), (72, 40, 120), (62, 74, 137), (49, 104, 142), (38, 130, 142), (31, 158, 137), (53, 183, 121),
     (109, 205, 89), (180, 222, 44), (253, 231, 37)], float
)  # fmt: skip
"""Colours of equal steps from far to near, that differ as much in brightness for every eye."""

_LINE = 0.9  # half width of a contour line [pixels]

_LINE_OPACITY, _FINE_OPACITY = 0.6, 0.25


@dataclass(frozen=True, eq=False)
class FieldSlice:
    """A picture, and where it belongs."""

    image: np.ndarray  # RGB, shape (rows, columns, 3), uint8; the first row is on top
    # the rectangle of the world; `plane.corners` go with texture coordinates (0, 0), (1, 0), (1, 1), (0, 1)
    plane: SlicePlane
    # log10 of the potential [1/m], shape (rows, columns); NaN in solids, -inf without charges
    log_potential: np.ndarray

    @property
    def pose(self) -> Any:
        """T_world_picture, a pinocchio.SE3: of its centre, x to the right, y up."""
        return self.plane.pose

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [m]."""
        return self.plane.size


def field_slice(
    scene: Scene, plane: SlicePlane, resolution: int = 320, origin: Origin | None = None, every: int = 1
) -> FieldSlice:
    """Draw the scene's field in a plane, as a picture of `resolution` pixels along the longer side.

    Dark is far from everything, bright near a surface, by the logarithm of the potential; grey is inside of a solid.
    Contour lines are where the potential is that of a wall 1, 2, 5, 10 .. cm away. Tables are kept for an origin near
    the rectangle [m, world], by default its centre; the field is evaluated at every n-th pixel of a row and of a
    column, and interpolated between. Raises ValueError if the resolution is not positive.
    """
    rows, columns = plane.pixels(resolution)
    x, y, z = plane.pose.translation.tolist()
    tables = coarse_tables(scene, origin or (x, y, z))  # far finer than colours are
    field = _interpolate(tables, plane, rows, columns, every)
    with np.errstate(divide="ignore"):
        log_potential = np.log10(field.potential)
    solid = field.winding > 0.5
    colors = _blend(_colors(log_potential, solid), _contours(field, plane, plane.size[0] / columns) * ~solid)
    colors[solid] = SOLID_COLOR
    log_potential[solid] = np.nan
    image = np.round(colors).astype(np.uint8).reshape(rows, columns, 3)
    values = log_potential.reshape(rows, columns)
    for array in (image, values):
        array.setflags(write=False)
    return FieldSlice(image, plane, values)


def _interpolate(tables: FieldTables, plane: SlicePlane, rows: int, columns: int, every: int) -> Field:
    """Return the field at the centres of pixels; far from all walls it is interpolated between fewer pixels.

    Potentials are interpolated by their logarithms, as they span powers of ten, and gradients relative to them.
    """
    coarse = [1 + (count - 1) // every for count in (rows, columns)]
    field = field_at_points(tables, plane.points(*coarse).reshape(-1, 3))
    if every == 1:
        return field
    down, across = (_weights(count, few) for count, few in zip((rows, columns), coarse, strict=True))

    def interpolate(values: np.ndarray) -> np.ndarray:
        fine: np.ndarray = down @ values.reshape(coarse) @ across.T
        return fine.ravel()

    potential = np.maximum(field.potential, np.finfo(float).tiny)  # 0 where nothing is charged
    fine = np.exp(interpolate(np.log(potential))) * (field.potential.max() > 0.0)
    slopes = (field.gradient / potential[:, None]).T
    gradient = np.column_stack([interpolate(slope) for slope in slopes]) * fine[:, None]
    found = Field(fine, gradient, interpolate(field.curvature), interpolate(field.winding))
    near = np.flatnonzero(fine > math.pi / (every * plane.size[0] / columns))  # a wall is within two larger pixels
    for values, exact in zip(
        found, field_at_points(tables, plane.points(rows, columns).reshape(-1, 3)[near]), strict=True
    ):
        values[near] = exact
    return found


def _weights(count: int, coarse: int) -> np.ndarray:
    """Return weights (count, coarse) that interpolate linearly between the centres of fewer pixels along a line."""
    at = np.clip((np.arange(count) + 0.5) * coarse / count - 0.5, 0.0, coarse - 1.0)
    weights: np.ndarray = np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(coarse)))
    return weights


def _colors(log_potential: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """Return the colours of logarithms, shape (n, 3): from the lowest of them up to that of the nearest wall."""
    shown = log_potential[np.isfinite(log_potential) & ~solid]
    low = float(shown.min()) if len(shown) else 0.0
    high = max(math.log10(2.0 * math.pi / NEAREST), low + LEAST_DECADES)
    at = np.clip((log_potential - low) / (high - low), 0.0, 1.0) * (len(_VIRIDIS) - 1)
    steps = np.arange(len(_VIRIDIS))
    return np.column_stack([np.interp(at, steps, channel) for channel in _VIRIDIS.T])


def _contours(field: Field, plane: SlicePlane, pixel: float) -> np.ndarray:
    """Return the share of contour lines in each pixel, (n,): by their distance, from the gradient in the plane."""
    rotation = plane.pose.rotation
    in_plane = field.gradient @ rotation[:, :2]
    # Potential, relative, that a pixel makes: no line is wider than where it changes by a thousandth.
    slope = np.maximum(np.linalg.norm(in_plane, axis=1) * pixel, 1e-3 * field.potential) + 1e-9
    inked = np.zeros(len(field.potential))
    for distances, opacity in ((CONTOURS, _LINE_OPACITY), (FINE_CONTOURS, _FINE_OPACITY)):
        levels = 2.0 * math.pi / np.array(distances[::-1])
        after = np.clip(np.searchsorted(levels, field.potential), 1, len(levels) - 1)
        nearest = np.minimum(*(np.abs(field.potential - levels[index]) for index in (after - 1, after)))
        inked = np.maximum(inked, opacity * np.clip(_LINE + 0.5 - nearest / slope, 0.0, 1.0))
    return inked


def _blend(colors: np.ndarray, inked: np.ndarray) -> np.ndarray:
    bright = colors @ np.array([0.299, 0.587, 0.114]) > 140.0
    ink = np.where(bright, 20.0, 245.0)[:, None]
    blended: np.ndarray = (1.0 - inked[:, None]) * colors + inked[:, None] * ink
    return blended
