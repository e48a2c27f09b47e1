"""Time-optimal speed along a given path, under velocity and acceleration limits of every joint.

With s the parameter of a path q(s), x = (ds/dt)² and u = d²s/dt², constant over a step h_i of the grid, every limit is
linear in (x, u):

    |q'_j|² x <= V_j²        |q'_j u + q''_j x| <= A_j        x_{i+1} = x_i + 2 h_i u_i

Backward, the *controllable* x_i is the largest from which some u reaches a controllable x_{i+1}: a linear program in
two variables. The path ends at rest, so x = u = 0 is always allowed and the controllable sets are intervals [0, K_i].
Forward from rest, the greatest u that stays controllable is optimal. Theory: H. Pham and Q.-C. Pham, "A new approach
to time-optimal path parameterization based on reachability analysis", IEEE Transactions on Robotics 34(3), 2018.
"""

from __future__ import annotations

from numba import void

from guidefield.kernels.jit.signatures import MATRIX, VECTOR, VECTOR_OUT, Floats, compiled, inlined

# A coefficient of u below this is none: dividing by it could overflow. Derivatives of a path are far above, or zero.
_NONE = 1e-100


@inlined
def _bounds_of_u(
    first: Floats, second: Floats, steps: Floats, limits: Floats, i: int, x_next: float, x: float
) -> tuple[float, float, float, float]:
    """The two bounds of u over step i that bind at x, as lines in x.

    The step's far end counts as its near one, with x + 2 h u in the place of x, and 0 <= x + 2 h u <= x_next.

    Returns:
        (a, b, c, d) with a x - b <= u <= c x + d; b and d are never negative.
    """
    width = 2.0 * steps[i]
    low_slope, low_reach, high_slope, high_reach = -1.0 / width, 0.0, -1.0 / width, x_next / width
    low, high = low_slope * x, high_slope * x + high_reach
    for j in range(first.shape[1]):
        for end in range(2):
            on_x = second[i + end, j]
            on_u = first[i + end, j] + end * width * on_x
            if abs(on_u) <= _NONE:
                continue
            slope = -on_x / on_u
            reach = limits[i, j] / abs(on_u)
            if slope * x - reach > low:
                low, low_slope, low_reach = slope * x - reach, slope, reach
            if slope * x + reach < high:
                high, high_slope, high_reach = slope * x + reach, slope, reach
    return low_slope, low_reach, high_slope, high_reach


@inlined
def _bound_without_u(first: Floats, second: Floats, steps: Floats, limits: Floats, i: int, cap: float) -> float:
    """The cap on x, lowered by the limits of step i that u has no part in: |q''_j| x <= A_j."""
    for j in range(first.shape[1]):
        for end in range(2):
            on_x = second[i + end, j]
            on_u = first[i + end, j] + end * 2.0 * steps[i] * on_x
            if abs(on_u) <= _NONE and abs(on_x) * cap > limits[i, j]:
                cap = limits[i, j] / abs(on_x)
    return cap


@inlined
def _largest_controllable(
    first: Floats, second: Floats, steps: Floats, limits: Floats, i: int, x_next: float, cap: float
) -> float:
    """The largest x <= cap for which some u over step i keeps the limits and leads to at most x_next.

    Where the range of u is empty, the two lines that bind cross at a smaller x, which is tried next. The range's width
    is concave and piecewise linear in x and not negative at 0, so this is Newton's method from the right: it never
    passes the zero and ends after as many rounds as there are lines at most; two or three do.
    """
    x = cap
    for _ in range(4 * first.shape[1] + 2):
        low_slope, low_reach, high_slope, high_reach = _bounds_of_u(first, second, steps, limits, i, x_next, x)
        if low_slope * x - low_reach <= high_slope * x + high_reach:
            break
        crossing = (low_reach + high_reach) / (low_slope - high_slope)
        if not crossing < x:  # nothing but rounding is left
            break
        x = crossing
    return x


@compiled(void(MATRIX, MATRIX, VECTOR, VECTOR, MATRIX, VECTOR_OUT, VECTOR_OUT))
def fastest_speeds(
    first: Floats,
    second: Floats,
    steps: Floats,
    caps: Floats,
    limits: Floats,
    controllable_out: Floats,
    squared_speeds_out: Floats,
) -> None:
    """Largest squared speed x = (ds/dt)² at every grid point of a path that starts and ends at rest.

    Args:
        first: q' at the grid points, shape (g, nv).
        second: q'' at the grid points, shape (g, nv).
        steps: Differences of s between grid points, shape (g - 1,), positive.
        caps: Largest x at each grid point by the velocity limits, shape (g,), positive.
        limits: Acceleration limits over each step, shape (g - 1, nv), positive; kept at both ends of the step.
        controllable_out: Largest x from which the end can still be reached at rest, shape (g,).
        squared_speeds_out: The result x, shape (g,); 0 at both ends.
    """
    last = steps.shape[0]
    controllable_out[last] = 0.0
    for i in range(last - 1, -1, -1):
        cap = _bound_without_u(first, second, steps, limits, i, caps[i])
        controllable_out[i] = _largest_controllable(first, second, steps, limits, i, controllable_out[i + 1], cap)
    squared_speeds_out[0] = 0.0
    for i in range(last):
        x = squared_speeds_out[i]
        _, _, slope, reach = _bounds_of_u(first, second, steps, limits, i, controllable_out[i + 1], x)
        x_next = x + 2.0 * steps[i] * (slope * x + reach)
        # the bounds only cut off what rounding adds
        squared_speeds_out[i + 1] = min(max(x_next, 0.0), controllable_out[i + 1])
