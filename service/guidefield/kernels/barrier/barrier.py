"""The barrier between a point and what it must stay away from, as a function of their signed distance.

At the distance d it is b(d / range), b(x) = (1 - x)^2 / x^3 below 1 and 0 beyond, once continuously differentiable.
Below `SOFT` it is the parabola that continues it, so that what is inside an obstacle is pushed out with a finite force.
It is the field's near-surface law 2 pi/d to a higher power, cut off smoothly at a range: the field itself, with all
that is far away, was measured to be the wrong objective for a motion.

Besides, what comes nearer than a floor costs the square of what is wanting: the barrier alone trades a narrow place
for wide ones, also where it need not be narrow.
"""

from __future__ import annotations

from typing import Any

from guidefield.kernels.jit.signatures import inlined
from guidefield.kernels.simd.vector import select

SOFT = 0.01
"""Below this distance the barrier is its parabola [m]; below half the range where that is less."""

STEEPNESS = 100.0
"""What a point costs on top of the barrier where nothing is left of the floor."""


@inlined
def barrier(distance: Any, reach: float) -> tuple[Any, Any, Any]:
    """The barrier of range `reach` at a distance, or at one in each lane: value and two derivatives by the distance."""
    soft = min(SOFT, 0.5 * reach)
    within = distance < reach
    x = select(distance > soft, distance, soft) * (1.0 / reach)
    over = 1.0 / x
    cube = over * over * over
    gap = 1.0 - x
    value = gap * gap * cube
    slope = -(2.0 * gap + 3.0 * gap * gap * over) * cube / reach
    curvature = (2.0 + 12.0 * gap * over + 12.0 * gap * gap * over * over) * cube / (reach * reach)
    deeper = select(distance < soft, distance - soft, 0.0)
    return (
        select(within, value + deeper * (slope + 0.5 * deeper * curvature), 0.0),
        select(within, slope + deeper * curvature, 0.0),
        select(within, curvature, 0.0),
    )


@inlined
def deficit(distance: Any, floor: float) -> tuple[Any, Any, Any]:
    """What a distance below a floor, positive, costs, or one in each lane: value and two derivatives by it."""
    wanting = select(distance < floor, 1.0 - distance * (1.0 / floor), 0.0)
    curvature = select(distance < floor, 0.0 * distance + 2.0 * STEEPNESS / (floor * floor), 0.0)
    return STEEPNESS * wanting * wanting, -2.0 * STEEPNESS * wanting / floor, curvature
