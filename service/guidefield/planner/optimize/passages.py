"""Places that a motion passes, each at a time that is free: a guide plane that the tip crosses, or a waypoint.

Where the curve comes nearest to such a place, at the parameter s, it misses it by m. The objective has

    w / 2 · |m|²

for each. As |m| is least at s, the derivative of s plays no part in the gradient. In Gauss and Newton's Hessian what a
change of s makes up for counts for nothing either: with a = dm/ds, and A the derivative of m by coordinates, it is

    w Aᵀ (1 - a aᵀ / (|a|² + κ²)) A

So a motion that crosses a plane within its polygon is held by nothing; one that leaves the polygon is held at its edge,
and one that only reaches the plane is held on it. What is missed in the end is taken away exactly, to `REACHED`: that
near are the motions of plans to their planes, and no passed goal has a smaller radius (`NO_RADIUS` of
sequence/rounding.py). With less of `SHORTEST` pieces become so short that their jerk is rounding. The other constants
are a search, whose failure loses the motion. Kernels compute `missed` and `rows` of a plane by the same formulas
(`Place.tip_plane`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from guidefield.kernels.optimize.tip_plane import SAMPLES, TipPlane, add_crossing, nearest_crossing
from guidefield.planner.guide.guide import inset_at
from guidefield.planner.motion.bspline import ENDS, BSpline, basis
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.task.problem import Problem
from guidefield.read_only import ReadOnly, read_only
from guidefield.robot.model.joints import LocalPoint, LocalPoints, LocalRates
from guidefield.scene.guide_plane import GuidePlane

SPACING = 0.25  # of samples about where a motion came nearest, in pieces
CLOSER = 0.125  # share of that with which samples are taken again, below 1
SHIFTS = 8  # how often samples are taken at most
REACHED = 1e-6  # what may be missed in the end [m at size 1, or rad]
CORRECTIONS = 60  # how often a motion is moved onto all places at most
LEAST_SHARES = 1e-3  # least sum of squares of a place's shares of inner control points, above 0: below, it is at an end
SHORTEST = 1e-3  # a place that is nearer to a knot than this, in pieces, is the knot


@dataclass(frozen=True)
class PlanePlace:
    """The tip on a guide plane, at least `inset` from its edges.

    Its misses are the height over the plane, and for each edge how far the tip is beyond it [m, at size 1].
    """

    problem: Problem
    plane: GuidePlane
    inset: float  # distance that the tip keeps from the polygon's edges [m]

    @classmethod
    def through(cls, problem: Problem, plane: GuidePlane, z: LocalPoint) -> PlanePlace:
        """Where a path crosses a plane: the tip keeps a share of the guide's inset, or, if less, its own depth there.

        Args:
            z: Local coordinates with the tip on it, shape (nv,).
        """
        return cls(problem, plane, inset_at(problem, plane, problem.kinematics.tip_positions(z[None])[0]))

    @cached_property
    def tip_plane(self) -> TipPlane:
        """As in `Place`."""
        directions, offsets = self._heights
        rows = np.ascontiguousarray(directions.T), offsets + self.plane.flat.origin @ directions
        read_only(*rows)
        return TipPlane(self.problem.kinematics.tip, *rows)

    def misses(self, zs: LocalPoints) -> np.ndarray:
        """As in `Place`, shape (n, 1 + edges)."""
        directions, offsets = self._heights
        missed: np.ndarray = (self.problem.kinematics.tip_positions(zs) - self.plane.flat.origin) @ directions - offsets
        np.minimum(missed[:, 1:], 0.0, out=missed[:, 1:])
        return missed

    @cached_property
    def _heights(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions (3, 1 + edges) and offsets (1 + edges,) of the heights over the plane and its inset edges.

        Both are over the robot's size.
        """
        plane, size = self.plane, self.problem.group.size
        directions = np.vstack([plane.normal, plane.inward @ plane.flat.axes]).T
        rows = directions / size, np.r_[0.0, plane.offsets + self.inset] / size
        read_only(*rows)
        return rows

    def rows(self, z: LocalPoint) -> np.ndarray:
        """As in `Place`, shape (1 + edges, nv); zero for an edge that the tip is inside of."""
        rows: np.ndarray = self._heights[0].T @ self.problem.kinematics.tip_slopes(z)
        rows[1:][self.misses(z[None])[0, 1:] >= 0.0] = 0.0
        return rows


_MIDDLE = SAMPLES // 2
_AROUND = np.arange(SAMPLES) - float(_MIDDLE)  # where samples are taken about a place, in their spacing


class Place(Protocol):
    """A place that a motion has to pass."""

    @property
    def tip_plane(self) -> TipPlane | None:
        """The same as kernels read it, if it is a plane that the tip crosses."""

    def misses(self, zs: LocalPoints) -> np.ndarray:
        """The misses of points (n, nv) from the place, shape (n, k): zero where they are there [m or rad]."""
        ...

    def rows(self, z: LocalPoint) -> np.ndarray:
        """The misses' derivative by local coordinates z (nv,), shape (k, nv); zero of one-sided ones that are zero."""
        ...


@dataclass(frozen=True, eq=False)
class Passage(ReadOnly):
    """A place to pass, and where a path that was found does."""

    place: Place
    waypoint: LocalPoint  # local coordinates of the path there, shape (nv,) [rad or m]


def first_places(passages: Sequence[Passage], motion: Trajectory, pieces: int, sizes: np.ndarray) -> tuple[float, ...]:
    """The places on a spline of some pieces, evenly in time, of a motion's passages through all their waypoints.

    Coordinates count by their sizes (nv,).
    """
    places, first = [], 0
    for passage in passages:
        away = np.linalg.norm((motion.positions[first:] - passage.waypoint) / sizes, axis=1)
        first += int(np.argmin(away))
        places.append(float(pieces * (motion.times[first] - motion.times[0]) / motion.duration))
    return tuple(places)


def nearest(place: Place, spline: BSpline, about: float) -> float:
    """Find where a spline comes nearest to a place, in pieces from the start, next to where it was.

    Samples are taken about the least, closer each time; a parabola through the last three says where. If the motion
    is still at the place where it was, the search ends.
    """
    spacing, plane = SPACING, place.tip_plane
    if plane is not None:
        found: float = nearest_crossing(plane, spline.points, about, spacing, CLOSER, SHIFTS)
        return found
    for _ in range(SHIFTS):
        at = np.minimum(np.maximum(about + spacing * _AROUND, 0.0), float(spline.pieces))
        missed = place.misses(spline.at(at))
        squares = np.einsum("nk,nk->n", missed, missed)
        if squares[_MIDDLE] == 0.0:
            return float(at[_MIDDLE])
        least = int(np.argmin(squares))
        about = float(at[least])
        if least in (0, SAMPLES - 1):
            continue
        if spacing < SPACING:
            before, here, after = squares[least - 1 : least + 2]
            bend = before - 2.0 * here + after
            about += 0.5 * spacing * float((before - after) / bend) if bend > 0.0 else 0.0
            return min(max(about, 0.0), float(spline.pieces))
        spacing *= CLOSER
    return about


def add_passage(
    place: Place,
    spline: BSpline,
    at: float,
    weight: float,
    crossing: float,
    s: int,
    gradient_out: np.ndarray,
    pieces_out: np.ndarray,
    basis_out: np.ndarray,
    hessians_out: np.ndarray,
) -> float:
    """Add what passing a place adds to the objective of a motion, as place s of a `ClearanceModel`; return its value.

    The weight is w [1/m² or 1/rad²], the crossing κ [m or rad]; outputs are those of the model: (n, nv), (places,),
    (places, 4), (places, nv, nv).
    """
    plane, where = place.tip_plane, np.array([at])
    if plane is not None:
        value: float = add_crossing(
            plane, spline.points, at, weight, crossing, s, gradient_out, pieces_out, basis_out, hessians_out
        )
        return value
    z, slope = spline.at(where)[0], spline.slopes(where)[0]
    missed, rows = place.misses(z[None])[0], place.rows(z)
    a = rows @ slope
    held = rows - np.outer(a, a @ rows) / (a @ a + crossing**2)
    (piece,), t = spline.piece_of(where)
    pieces_out[s], basis_out[s], hessians_out[s] = piece, basis(t)[0], weight * (rows.T @ held)
    gradient_out[piece : piece + 4] += np.outer(basis_out[s], weight * (missed @ rows))
    return 0.5 * weight * float(missed @ missed)


def move_onto_places(
    spline: BSpline, passages: Sequence[Passage], places: Sequence[float], sizes: np.ndarray
) -> tuple[BSpline, list[float]] | None:
    """A motion that passes all places exactly, and where; None where it can't be, or not in their order.

    Coordinates count by their sizes (nv,).
    """
    at = [nearest(one.place, spline, about) for one, about in zip(passages, places, strict=True)]
    # or at the knot next to it: no piece becomes too short
    at = [float(np.round(one)) if abs(one - np.round(one)) < SHORTEST else one for one in at]
    if (np.diff(at) < 0.0).any():
        return None
    for _ in range(CORRECTIONS):
        worst = 0.0
        for passage, where in zip(passages, at, strict=True):
            spline, missed = _move_onto(passage.place, spline, where, sizes)
            worst = max(worst, missed)
        if worst <= REACHED:
            return spline, at
    return None


def _move_onto(place: Place, spline: BSpline, at: float, sizes: np.ndarray) -> tuple[BSpline, float]:
    """The motion with control points about a place moved least to be there to first order; what it missed."""
    where = np.array([at])
    z = spline.at(where)[0]
    missed = place.misses(z[None])[0]
    (piece,), t = spline.piece_of(where)
    inner = np.clip(piece + np.arange(4), ENDS, len(spline.points) - ENDS - 1) == piece + np.arange(4)
    shares = np.where(inner, basis(t)[0], 0.0)
    if not missed.any() or shares @ shares < LEAST_SHARES:
        return spline, float(np.abs(missed).max())
    rows = place.rows(z)[missed != 0.0] * sizes
    move = -np.linalg.pinv(rows, rcond=1e-6) @ missed[missed != 0.0] * sizes
    points = spline.points.copy()
    points[piece : piece + 4] += np.outer(shares / (shares @ shares), move)
    return dataclasses.replace(spline, points=points), float(np.abs(missed).max())


def with_knots(
    spline: BSpline, places: Sequence[float]
) -> tuple[tuple[np.ndarray, LocalPoints, LocalRates], tuple[int, ...]]:
    """A motion's knots as `BSpline.knots` has them, with one at each place; and which of them are at the places.

    Returns:
        Times, shape (n,) [s], positions and velocities, shape (n, nv); the index of each place among them.
    """
    times, positions, velocities = spline.knots()
    within = np.array([place for place in sorted(set(places)) if place != round(place)])
    if len(within):
        before = np.ceil(within).astype(int)
        times = np.insert(times, before, spline.step * within)
        positions = np.insert(positions, before, spline.at(within), axis=0)
        velocities = np.insert(velocities, before, spline.slopes(within) / spline.step, axis=0)
    at = tuple(int(np.argmin(np.abs(times - spline.step * place))) for place in places)
    return (times, positions, velocities), at
