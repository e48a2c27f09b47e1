"""The rotation of a primitive that is declared with a quaternion."""

from __future__ import annotations

from guidefield.kernels.jit.signatures import Floats, lane_part


@lane_part
def write_rotation(placed: Floats, rotation: Floats) -> None:
    """Write the rotation of a primitive, `PLACED` of it of shape (12,), to the first three columns of (3, k)."""
    x, y, z, w = placed[1], placed[2], placed[3], placed[4]
    rotation[0, 0], rotation[0, 1] = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w)
    rotation[1, 0], rotation[1, 1] = 2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z)
    rotation[2, 0], rotation[2, 1] = 2.0 * (x * z - y * w), 2.0 * (y * z + x * w)
    rotation[0, 2], rotation[1, 2] = 2.0 * (x * z + y * w), 2.0 * (y * z - x * w)
    rotation[2, 2] = 1.0 - 2.0 * (x * x + y * y)
