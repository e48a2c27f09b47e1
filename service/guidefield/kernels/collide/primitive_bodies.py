"""Boxes, cylinders and capsules as bodies that the distance kernels read."""

from __future__ import annotations

from numba import void

from guidefield.kernels.collide.placed_rotation import write_rotation
from guidefield.kernels.collide.primitive import BOX, CAPSULE
from guidefield.kernels.distance.distance import BOX as BOX_BODY, CAPSULE as CAPSULE_BODY, CYLINDER as CYLINDER_BODY
from guidefield.kernels.jit.signatures import (
    BLOCKS_OUT,
    INDICES_OUT,
    MATRIX,
    MATRIX_OUT,
    SCALAR,
    Floats,
    Integers,
    exact_kernel,
)


@exact_kernel(void(MATRIX, SCALAR, INDICES_OUT, MATRIX_OUT, MATRIX_OUT, BLOCKS_OUT, MATRIX_OUT))
def primitive_bodies(
    placed: Floats,
    rounding: float,
    kinds: Integers,
    sizes: Floats,
    bounds: Floats,
    placements: Floats,
    boxes: Floats,
) -> None:
    """Write the rows of bodies, as `DistanceTables` has them.

    Args:
        placed: How they are declared, `PLACED` of each, shape (n, 12); of what is neither rows say nothing.
        rounding: By how much boxes in the world are made larger [m, and a share].
        kinds: Gets their kinds, shape (n,).
        sizes: Gets their sizes, shape (n, 3) [m].
        bounds: Gets boxes about them in their own frames, shape (n, 6) [m].
        placements: Gets their placements, shape (n, 3, 4) [m].
        boxes: Gets boxes about them along the world's axes, shape (n, 6) [m].
    """
    for i in range(placed.shape[0]):
        row, placement = placed[i], placements[i]
        write_rotation(row, placement)
        for k in range(3):
            placement[k, 3] = row[5 + k]
        radius, half = row[11], row[10]
        if row[0] == BOX:
            kinds[i] = BOX_BODY
            sizes[i, 0], sizes[i, 1], sizes[i, 2] = row[8], row[9], row[10]
            bounds[i, 3], bounds[i, 4], bounds[i, 5] = row[8], row[9], row[10]
        else:
            is_capsule = row[0] == CAPSULE
            kinds[i] = CAPSULE_BODY if is_capsule else CYLINDER_BODY
            sizes[i, 0], sizes[i, 1], sizes[i, 2] = radius, half, 0.0
            bounds[i, 3], bounds[i, 4], bounds[i, 5] = radius, radius, half + radius if is_capsule else half
        for k in range(3):
            bounds[i, k] = -bounds[i, 3 + k]
        for k in range(3):
            turned = placement[k]
            reach = abs(turned[0]) * bounds[i, 3] + abs(turned[1]) * bounds[i, 4] + abs(turned[2]) * bounds[i, 5]
            reach += rounding * (1.0 + abs(turned[3]))
            boxes[i, k], boxes[i, 3 + k] = turned[3] - reach, turned[3] + reach
