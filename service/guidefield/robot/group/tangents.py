"""Rates in the chart as tangents, all rows of a motion at once: what `PlanningGroup.tangent_map` says of one point.

A tangent is T(z) z', and its rate of change T(z) z'' + T' z'. Of a rotation vector p with angle a = |p| the map is the
right Jacobian of the exponential map, T x = x - f p x x + g p x (p x x) with f = (1 - cos a) / a^2 and
g = (a - sin a) / a^3 (T. D. Barfoot, State Estimation for Robotics, 2017), so that

    T' p' = -f' p x p' + g' p x (p x p') + g p' x (p x p').

What slides beside a turn is seen from the moved frame: T x = R^T x, and T' x = -w x R^T x with the angular velocity w.
"""

from __future__ import annotations

from typing import cast

import numpy as np
import pinocchio as pin

from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model import chart
from guidefield.robot.model.model import Joint, JointKind
from guidefield.robot.model.spaces import ChartPoints, ChartRates, Tangents

SERIES_BELOW = 0.25
"""Of smaller angles f, g and their derivatives are taken from their series; terms left out are below 1e-15 [rad]."""

_TERMS = 6  # terms of these series


def tangents(group: PlanningGroup, zs: ChartPoints, rates: ChartRates) -> Tangents:
    """Return tangents T(z) z', shape (n, nv), of rates or other rows (n, nv) at chart points (n, nv)."""
    found = cast(Tangents, np.array(rates, float))
    if group.is_euclidean:
        return found
    turns = _rotation_columns(group)
    if turns.size:
        vectors, rows = zs[:, turns], rates[:, turns]
        (f, g, _, _), once = _factors(vectors), _cross(vectors, rows)
        found[:, turns] = rows - f * once + g * _cross(vectors, once)
    for joint in group.joints:
        if joint.kind is JointKind.PLANAR or joint.kind is JointKind.FLOATING:
            at = _slides(joint)
            found[:, at] = _see_from(group, joint, zs, rates[:, at])
    return found


def tangent_accelerations(
    group: PlanningGroup, zs: ChartPoints, rates: ChartRates, accelerations: ChartRates
) -> Tangents:
    """Return T(z) z'' + T' z', shape (n, nv), of chart points, rates and accelerations, each of shape (n, nv)."""
    found = tangents(group, zs, accelerations)
    if group.is_euclidean:
        return found
    there, turns = tangents(group, zs, rates), _rotation_columns(group)
    if turns.size:
        vectors, rows = zs[:, turns], rates[:, turns]
        (_, g, df, dg), once = _factors(vectors), _cross(vectors, rows)
        growing = 2.0 * (vectors * rows).sum(axis=-1, keepdims=True)  # of a^2
        found[:, turns] += growing * (dg * _cross(vectors, once) - df * once) + g * _cross(rows, once)
    for joint in group.joints:
        first = joint.idx_v
        if joint.kind is JointKind.PLANAR:
            found[:, first] += there[:, first + 2] * there[:, first + 1]
            found[:, first + 1] -= there[:, first + 2] * there[:, first]
        elif joint.kind is JointKind.FLOATING:
            found[:, first : first + 3] -= _cross(there[:, first + 3 : first + 6], there[:, first : first + 3])
    return found


def _rotation_columns(group: PlanningGroup) -> np.ndarray:
    """Which chart coordinates are the rotation vectors of joints, shape (k, 3)."""
    columns = [
        np.arange(j.idx_v, j.idx_v + j.nv)[chart.ROTATION[j.kind]] for j in group.joints if j.kind in chart.ROTATION
    ]
    return np.array(columns, int).reshape(-1, 3)


def _slides(joint: Joint) -> slice:
    return slice(joint.idx_v, joint.idx_v + (2 if joint.kind is JointKind.PLANAR else 3))


def _see_from(group: PlanningGroup, joint: Joint, zs: ChartPoints, rows: np.ndarray) -> np.ndarray:
    """Translations (n, 2) or (n, 3) seen from the frame that a planar or floating joint has moved."""
    if joint.kind is JointKind.PLANAR:
        return _turn_back(zs[:, joint.idx_v + 2], rows)
    reference = pin.Quaternion(np.asarray(group.q_origin[joint.idx_q + 3 : joint.idx_q + 7], float)).normalized()
    return _rotate_back(zs[:, joint.idx_v + 3 : joint.idx_v + 6], rows @ reference.matrix())


def _turn_back(angles: np.ndarray, rows: np.ndarray) -> np.ndarray:
    c, s = np.cos(angles), np.sin(angles)
    return np.column_stack([c * rows[:, 0] + s * rows[:, 1], c * rows[:, 1] - s * rows[:, 0]])


def _rotate_back(vectors: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Rows (n, 3) seen from frames turned by rotation vectors (n, 3): Rodrigues' formula, turned back."""
    angles, once = np.linalg.norm(vectors, axis=1, keepdims=True), _cross(vectors, rows)
    back: np.ndarray = rows - np.sinc(angles / np.pi) * once + _factors(vectors)[0] * _cross(vectors, once)
    return back


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products, shape (..., 3) each; NumPy's own takes several times as long."""
    return np.stack([a[..., i] * b[..., j] - a[..., j] * b[..., i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=-1)


def _factors(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """f, g and their derivatives by a^2, for rotation vectors (..., 3); each of shape (..., 1).

    f = sum (-s)^k / (2 k + 2)! and g = sum (-s)^k / (2 k + 3)! with s = a^2.
    """
    s = (vectors * vectors).sum(axis=-1, keepdims=True)
    a = np.sqrt(np.maximum(s, SERIES_BELOW**2))
    sine, opposite = np.sin(a), 2.0 * np.sin(0.5 * a) ** 2  # 1 - cos a
    exact = (
        opposite / a**2,
        (a - sine) / a**3,
        (0.5 * a * sine - opposite) / a**4,
        (0.5 * a * opposite - 1.5 * (a - sine)) / a**5,
    )
    k = np.arange(_TERMS)
    f = np.cumprod(np.r_[0.5, -1.0 / ((2 * k[1:] + 1) * (2 * k[1:] + 2))])
    g = np.cumprod(np.r_[1.0 / 6.0, -1.0 / ((2 * k[1:] + 2) * (2 * k[1:] + 3))])
    series = s**k @ f, s**k @ g, s ** k[:-1] @ (k[1:] * f[1:]), s ** k[:-1] @ (k[1:] * g[1:])
    f0, g0, df, dg = (
        np.where(s < SERIES_BELOW**2, few[..., None], one) for few, one in zip(series, exact, strict=True)
    )
    return f0, g0, df, dg
