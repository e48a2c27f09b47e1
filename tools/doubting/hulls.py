"""The distance of two convex bodies by Wolfe's algorithm: another way than Coal's to the same number."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

ROUNDS = 300
"""Steps after which no answer is given."""
STILL = 1e-14
"""A step that gains less than this, times the squares of the lengths at hand, is none."""


def rounded_hull(shape: Any) -> tuple[np.ndarray, float] | None:
    """Points (n, 3) and a radius: the shape is their hull, widened by it; None of shapes that are no such body."""
    if isinstance(shape, coal.Sphere):
        return np.zeros((1, 3)), float(shape.radius)
    if isinstance(shape, coal.Capsule):
        return np.array([[0.0, 0.0, z] for z in (-shape.halfLength, shape.halfLength)]), float(shape.radius)
    if isinstance(shape, coal.Box):
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return signs * np.array(shape.halfSide), 0.0
    if isinstance(shape, coal.ConvexBase):
        return np.array(shape.points()), 0.0
    return None


def distance(first: Any, placed: Any, second: Any, there: Any) -> float | None:
    """Distance of two shapes where they are placed [m]; None where it isn't known, or they may overlap."""
    one, other = rounded_hull(first), rounded_hull(second)
    if one is None or other is None:
        return None
    a = one[0] @ placed.rotation.T + placed.translation
    b = other[0] @ there.rotation.T + there.translation
    apart = least_norm((a[:, None] - b[None]).reshape(-1, 3))
    return None if apart is None or apart <= 0.0 else apart - one[1] - other[1]


def least_norm(points: np.ndarray) -> float | None:
    """The distance of the origin from the hull of points (n, 3), 0 within; None if it isn't found.

    Wolfe, Finding the nearest point in a polytope, 1976: a corral of affinely independent points whose affine hull's
    nearest point is in its hull; the point that is farthest towards the origin joins it, until none gains anything.
    """
    corral = [int(np.argmin((points**2).sum(axis=1)))]
    weights = np.ones(1)
    for _ in range(ROUNDS):
        x = weights @ points[corral]
        along = points @ x
        k = int(np.argmin(along))
        if along[k] >= x @ x - STILL * max(float(x @ x), float((points[k] ** 2).sum())) or k in corral:
            return float(np.linalg.norm(x))
        corral.append(k)
        weights = np.append(weights, 0.0)
        while True:
            best = _affine(points[corral])
            if best is None:
                return None
            if (best > 1e-13).all():
                weights = best
                break
            falling = best < weights
            share = np.where(falling & (best <= 1e-13), weights / np.where(falling, weights - best, 1.0), np.inf).min()
            weights = weights + min(1.0, float(share)) * (best - weights)
            kept = weights > 1e-13
            if kept.all():
                kept[int(np.argmin(weights))] = False
            corral = [index for index, stays in zip(corral, kept.tolist(), strict=True) if stays]
            weights = weights[kept] / weights[kept].sum()
    return None


def _affine(corral: np.ndarray) -> np.ndarray | None:
    """Weights (k,) that sum to 1 of the point of an affine hull (k, 3) that is nearest to the origin."""
    if len(corral) > 4:
        return None
    base, arms = corral[0], (corral[1:] - corral[0]).T
    steps = np.linalg.lstsq(arms, -base, rcond=None)[0] if arms.shape[1] else np.zeros(0)
    return np.concatenate([[1.0 - steps.sum()], steps])
