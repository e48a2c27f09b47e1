"""The barrier between a point and what it must stay away from, as a function of their signed distance.

At the distance d it is b(d / range), b(x) = (1 - x)^2 / x^3 below 1 and 0 beyond, once continuously differentiable.
Below `SOFT` it is the parabola that continues it, so that what is inside an obstacle is pushed out with a finite force.
It is the field's near-surface law 2 pi/d to a higher power, cut off smoothly at a range: the field itself, with all
that is far away, was measured to be the wrong objective for a motion.

Besides, what comes nearer than a floor costs the square of what is wanting: the barrier alone trades a narrow place
for wide ones, also where it need not be narrow.
"""

from __future__ import annotations

from guidefield.kernels.jit.signatures import inlined

SOFT = 0.01
"""Below this distance the barrier is its parabola [m]; below half the range where that is less."""

STEEPNESS = 100.0
"""What a point costs on top of the barrier where nothing is left of the floor."""


@inlined
def barrier(distance: float, reach: float) -> tuple[float, float, float]:
    """The barrier of range `reach` at a distance: value, first and second derivative by the distance."""
    if distance >= reach:
        return 0.0, 0.0, 0.0
    soft = min(SOFT, 0.5 * reach)
    x = max(distance, soft) / reach
    over = 1.0 / x
    cube = over * over * over
    gap = 1.0 - x
    value = gap * gap * cube
    slope = -(2.0 * gap + 3.0 * gap * gap * over) * cube / reach
    curvature = (2.0 + 12.0 * gap * over + 12.0 * gap * gap * over * over) * cube / (reach * reach)
    deeper = min(distance - soft, 0.0)
    return value + deeper * (slope + 0.5 * deeper * curvature), slope + deeper * curvature, curvature


@inlined
def deficit(distance: float, floor: float) -> tuple[float, float, float]:
    """What a distance below a floor, positive, costs: value, first and second derivative by the distance."""
    if distance >= floor:
        return 0.0, 0.0, 0.0
    wanting = 1.0 - distance / floor
    return STEEPNESS * wanting * wanting, -2.0 * STEEPNESS * wanting / floor, 2.0 * STEEPNESS / (floor * floor)
