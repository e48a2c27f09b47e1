"""The curve that columns of a message describe, evaluated at many times: written from the page, not from our code."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

COORDINATES = ("", "x", "y", "z", "theta", "qx", "qy", "qz", "qw", "vx", "vy", "vz", "wx", "wy", "wz")
"""Ends of columns of joints of several coordinates, in their order."""


def split_columns(names: Sequence[str]) -> list[tuple[str, str]]:
    """Split columns into joint and coordinate.

    The name of a joint may have a dot itself: `joint_0.0`, or `base.x` beside no other column of `base`.
    """
    found = []
    for name in names:
        joint, _, coordinate = name.rpartition(".")
        others = sum(other.startswith(f"{joint}.") and other[len(joint) + 1 :] in COORDINATES for other in names)
        found.append((joint, coordinate) if joint and coordinate in COORDINATES[1:] and others > 1 else (name, ""))
    return found


Values = dict[str, np.ndarray]
"""By joint, a row for each of n times: (n,) angles or lengths, (n, 3) planar, (n, 4) ball, (n, 7) floating."""
Columns = list[list[float]]

ROTATION = {4: slice(0, 3), 7: slice(3, 6)}
"""Place of the rotation vector in the local coordinates of a joint, by its number of positions."""


@dataclass(frozen=True)
class Part:
    """One joint of a curve.

    Attributes:
        name: Of the joint.
        width: How many position columns it has.
        at: Its coordinates in local coordinates.
        origin: The quaternion (x, y, z, w) that its rotation vectors start from, shape (4,); of no meaning to others.
    """

    name: str
    width: int
    at: slice
    origin: np.ndarray


@dataclass(frozen=True, eq=False)
class Curve:
    """Cubic Hermite pieces between knots in local coordinates, or straight ones if there are no velocities.

    Attributes:
        parts: The joints.
        times: Shape (k,) [s]; of a path without time the numbers of its waypoints.
        points: Local coordinates, shape (k, nv) [rad or m].
        rates: Shape (k, nv) [1/s]; None for straight pieces.
    """

    parts: tuple[Part, ...]
    times: np.ndarray
    points: np.ndarray
    rates: np.ndarray | None

    @classmethod
    def of(
        cls,
        names: list[str],
        positions: Columns,
        times: list[float] | None = None,
        velocities: Columns | None = None,
        *,
        continuous: Collection[str] = (),
        spline: bool = False,
    ) -> Curve:
        """From a message's columns.

        Args:
            names: Of the position columns; velocities stand in the same order of joints.
            positions: A row for each knot.
            times: Of the knots [s]; None: of a path.
            velocities: A row for each knot, tangents in the moved frame; None: straight pieces, or a spline.
            continuous: Joints that go the shorter way from each row to the next.
            spline: Whether the cubic spline through the knots is meant, twice continuously differentiable.
        """
        rows = np.array(positions, float).reshape(len(positions), -1)
        widths: dict[str, int] = {}
        for joint, _ in split_columns(names):
            widths[joint] = widths.get(joint, 0) + 1
        parts, points, rates, column, first = [], [], [], 0, 0
        speeds = None if velocities is None else np.array(velocities, float).reshape(len(rows), -1)
        for joint, width in widths.items():
            mine = rows[:, column : column + width]
            nv = {4: 3, 7: 6}.get(width, width)
            origin = mine[0, -4:] if width in ROTATION else np.zeros(4)
            part = Part(joint, width, slice(first, first + nv), origin)
            if joint in continuous or width == 3:
                mine[:, -1] = np.unwrap(mine[:, -1])
            parts.append(part)
            z = _local(part, mine)
            points.append(z)
            if speeds is not None:
                rates.append(_local_rates(part, mine, z, speeds[:, first : first + nv]))
            column, first = column + width, first + nv
        knots = np.arange(len(rows), dtype=float) if times is None else np.array(times, float)
        z = np.hstack(points)
        if spline and len(knots) > 1:
            rates = [CubicSpline(knots, z).derivative()(knots)]
        return cls(tuple(parts), knots, z, np.hstack(rates) if rates else None)

    def local_at(self, times: np.ndarray) -> np.ndarray:
        """Local coordinates at times (n,), shape (n, nv)."""
        if len(self.times) == 1:
            return np.repeat(self.points, len(times), axis=0)
        piece = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        h = np.diff(self.times)[piece]
        s = np.clip((times - self.times[piece]) / h, 0.0, 1.0)[:, None]
        p, q = self.points[piece], self.points[piece + 1]
        if self.rates is None:
            return p + s * (q - p)
        v, w, h = self.rates[piece], self.rates[piece + 1], h[:, None]
        basis = (1.0 + 2.0 * s) * (1.0 - s) ** 2, s * (1.0 - s) ** 2, s**2 * (3.0 - 2.0 * s), s**2 * (s - 1.0)
        return basis[0] * p + basis[1] * h * v + basis[2] * q + basis[3] * h * w

    def at(self, times: np.ndarray) -> Values:
        """Values of the joints at times (n,)."""
        z = self.local_at(times)
        return {part.name: _values(part, z[:, part.at]) for part in self.parts}


def _local(part: Part, rows: np.ndarray) -> np.ndarray:
    """Local coordinates of rows of positions; rotation vectors go the shorter way from each to the next."""
    if part.width not in ROTATION:
        return rows.copy()
    found, back = [], pin.Quaternion(part.origin).normalized().conjugate()
    for row in rows:
        turn = _turn(back * pin.Quaternion(row[-4:].copy()).normalized())
        angle = float(np.linalg.norm(turn))
        before = found[-1] if found else np.zeros(3)
        if angle > 0.0:
            other = turn * (1.0 - 2.0 * np.pi / angle)
            turn = min((turn, other), key=lambda one: float(np.linalg.norm(one - before)))
        found.append(turn)
    return np.hstack([rows[:, :-4], np.array(found)])


def _turn(quaternion: pin.Quaternion) -> np.ndarray:
    """The rotation vector of a unit quaternion, by at most half a turn; a matrix's is less certain towards that."""
    x, y, z, w = quaternion.coeffs() if quaternion.w >= 0.0 else -quaternion.coeffs()
    vector = np.array([x, y, z])
    sine = float(np.linalg.norm(vector))
    return vector * (2.0 * np.arctan2(sine, w) / sine) if sine > 0.0 else vector


def _local_rates(part: Part, rows: np.ndarray, z: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """Local velocities of tangents (k, nv) in the moved frame."""
    rates = tangents.copy()
    if part.width == 3:
        c, s = np.cos(z[:, 2]), np.sin(z[:, 2])
        rates[:, 0], rates[:, 1] = c * tangents[:, 0] - s * tangents[:, 1], s * tangents[:, 0] + c * tangents[:, 1]
    if part.width in ROTATION:
        at = ROTATION[part.width]
        for k, row in enumerate(rows):
            rates[k, at] = np.linalg.solve(pin.Jexp3(np.ascontiguousarray(z[k, at])), tangents[k, at])
            if part.width == 7:
                rates[k, :3] = pin.Quaternion(row[-4:].copy()).normalized().matrix() @ tangents[k, :3]
    return rates


def _values(part: Part, z: np.ndarray) -> np.ndarray:
    if part.width == 1:
        return z[:, 0]
    if part.width not in ROTATION:
        return z
    turn = z[:, ROTATION[part.width]]
    half = 0.5 * np.linalg.norm(turn, axis=1, keepdims=True)
    vector, scalar = 0.5 * np.sinc(half / np.pi) * turn, np.cos(half)
    v, w = part.origin[:3], part.origin[3]
    quaternion = np.hstack([w * vector + scalar * v + np.cross(v, vector), w * scalar - vector @ v[:, None]])
    return np.hstack([z[:, :-3], quaternion])
