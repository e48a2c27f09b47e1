"""Symmetric systems of a few rows, solved where they stand."""

from __future__ import annotations

from guidefield.kernels.jit.signatures import Floats, inlined


@inlined
def invert(matrix: Floats, size: int) -> None:
    """Replace the leading square of a symmetric, positive definite matrix by its inverse (Gauss and Jordan).

    Args:
        matrix: Shape (n, n).
        size: Rows of that square.
    """
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
    """Solve (M + ridge 1) x = b for three unknowns, by cofactors.

    Args:
        matrix: M, symmetric, shape (3, 3).
        ridge: What keeps it regular.
        right: b, shape (3,).
        solution_out: x, shape (3,).
    """
    xx, yy, zz = matrix[0, 0] + ridge, matrix[1, 1] + ridge, matrix[2, 2] + ridge
    xy, xz, yz = matrix[0, 1], matrix[0, 2], matrix[1, 2]
    cxx, cxy, cxz = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    cyy, cyz, czz = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    over = 1.0 / (xx * cxx + xy * cxy + xz * cxz)
    solution_out[0] = over * (cxx * right[0] + cxy * right[1] + cxz * right[2])
    solution_out[1] = over * (cxy * right[0] + cyy * right[1] + cyz * right[2])
    solution_out[2] = over * (cxz * right[0] + cyz * right[1] + czz * right[2])
