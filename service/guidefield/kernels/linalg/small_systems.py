"""Small linear algebra: symmetric systems of a few rows, products of vectors, principal axes, and a stable order.

Kernels of every kind compile these in: another order of operations changes the last bits of what they find. Callers
rely on `write_stable_order` to leave equal keys in order.
"""

from __future__ import annotations

import math

from guidefield.kernels.jit.arrays import Floats, Integers, RowOut, RowsOut, Vector3
from guidefield.kernels.jit.decorators import inlined, kernel, vector_part


@inlined
def invert(matrix: Floats, size: int) -> None:
    """Replace the leading square of a symmetric, positive definite matrix (n, n) by its inverse (Gauss and Jordan)."""
    for p in range(size):
        over = 1.0 / matrix[p, p]
        matrix[p, p] = 1.0
        for c in range(size):
            matrix[p, c] *= over
        for r in range(size):
            if r != p:
                share = matrix[r, p]
                matrix[r, p] = 0.0
                for c in range(size):
                    matrix[r, c] -= share * matrix[p, c]


@inlined
def solve_three(matrix: Floats, ridge: float, right: Floats, solution_out: Floats) -> None:
    """Solve (M + ridge 1) x = b (3,) for a symmetric M (3, 3), by cofactors."""
    xx, yy, zz = matrix[0, 0] + ridge, matrix[1, 1] + ridge, matrix[2, 2] + ridge
    xy, xz, yz = matrix[0, 1], matrix[0, 2], matrix[1, 2]
    cxx, cxy, cxz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    cyy, cyz, czz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    over = 1.0 / (xx * cxx + xy * cxy + xz * cxz)
    solution_out[0] = over * (cxx * right[0] + cxy * right[1] + cxz * right[2])
    solution_out[1] = over * (cxy * right[0] + cyy * right[1] + cyz * right[2])
    solution_out[2] = over * (cxz * right[0] + cyz * right[1] + czz * right[2])


@inlined
def dot(a: Vector3, b: Vector3) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector3, b: Vector3) -> Vector3:
    """Vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@vector_part
def unit_in_plane(x: float, y: float) -> tuple[float, float]:
    """The unit vector along a vector of any length in a plane; 0 for the vector 0."""
    size = max(abs(x), abs(y))
    if not size > 0.0:
        return 0.0, 0.0
    x, y = x / size, y / size  # squares of what is smaller than 1e-154 would vanish
    length = math.sqrt(x * x + y * y)
    return x / length, y / length


_ORTHOGONAL = 1e-15  # cosine of columns that count as orthogonal
_SWEEPS = 30  # most rounds over all pairs; four or five are usual, fewer give other axes, and robots other convex parts


@inlined
def _rotation(points: Floats, p: int, q: int) -> tuple[float, float]:
    """Cosine and sine of the rotation that makes two columns orthogonal; 1 and 0 if they are."""
    first = second = both = 0.0
    for i in range(points.shape[0]):
        x, y = points[i, p], points[i, q]
        first += x * x
        second += y * y
        both += x * y
    if first == 0.0 or second == 0.0 or abs(both) <= _ORTHOGONAL * math.sqrt(first) * math.sqrt(second):
        return 1.0, 0.0
    cotangent = 0.5 * (second - first) / both
    tangent = math.copysign(1.0, cotangent) / (abs(cotangent) + math.hypot(1.0, cotangent))
    cosine = 1.0 / math.hypot(1.0, tangent)
    return cosine, cosine * tangent


@inlined
def _sort(spread_out: Floats, axes_out: Floats) -> None:
    for p in (0, 1, 0):
        if spread_out[p] < spread_out[p + 1]:
            spread_out[p], spread_out[p + 1] = spread_out[p + 1], spread_out[p]
            for k in range(3):
                axes_out[p, k], axes_out[p + 1, k] = axes_out[p + 1, k], axes_out[p, k]


@kernel
def principal_axes(points: RowsOut, spread_out: RowOut, axes_out: RowsOut) -> None:
    """Write the singular values (3,) and right singular vectors (3, 3), one a row, of points (n, 3), the largest first.

    The points are left turned into the axes.
    """
    for k in range(9):
        axes_out[k // 3, k % 3] = 1.0 if k % 4 == 0 else 0.0
    for _ in range(_SWEEPS):
        turned = False
        for p, q in ((0, 1), (0, 2), (1, 2)):
            cosine, sine = _rotation(points, p, q)
            if sine == 0.0:
                continue
            turned = True
            for i in range(points.shape[0]):
                x, y = points[i, p], points[i, q]
                points[i, p], points[i, q] = cosine * x - sine * y, sine * x + cosine * y
            for k in range(3):
                x, y = axes_out[p, k], axes_out[q, k]
                axes_out[p, k], axes_out[q, k] = cosine * x - sine * y, sine * x + cosine * y
        if not turned:
            break
    for p in range(3):
        square = 0.0
        for i in range(points.shape[0]):
            square += points[i, p] * points[i, p]
        spread_out[p] = math.sqrt(square)
    _sort(spread_out, axes_out)


@inlined
def _sift(keys: Floats, order: Integers, at: int, end: int) -> None:
    """Let an entry of a heap, the last one in the order on top, sink to its place."""
    one = order[at]
    while 2 * at + 1 < end:
        child = 2 * at + 1
        key, other = keys[order[child]], keys[order[child + 1]] if child + 1 < end else keys[order[child]]
        if other > key or (other == key and child + 1 < end and order[child + 1] > order[child]):
            child += 1
        if keys[one] > keys[order[child]] or (keys[one] == keys[order[child]] and one > order[child]):
            break
        order[at] = order[child]
        at = child
    order[at] = one


@inlined
def write_stable_order(keys: Floats, order_out: Integers) -> None:
    """Write the order (n,) of numbers (n,), of equal ones that of their places: heap sort by number, then place."""
    count = keys.shape[0]
    for i in range(count):
        order_out[i] = i
    for at in range(count // 2 - 1, -1, -1):
        _sift(keys, order_out, at, count)
    for end in range(count - 1, 0, -1):
        order_out[0], order_out[end] = order_out[end], order_out[0]
        _sift(keys, order_out, 0, end)
