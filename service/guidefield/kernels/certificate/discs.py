"""The support point of a disc: the point of its rim that is farthest along a direction."""

from __future__ import annotations

import math

from guidefield.kernels.jit.no_refcount import lane_uncounted

PARALLEL = 2e-15
"""A direction whose part across an axis is no larger than this share of it is parallel to the axis: that part is
rounding alone, and points anywhere. Where it is taken for 0, a support value falls short by this share of the radius.
"""


@lane_uncounted
def unit_across(
    x: float, y: float, z: float, axis_x: float, axis_y: float, axis_z: float
) -> tuple[float, float, float]:
    """The unit vector across a unit axis that is nearest to a direction; 0 if they are parallel.

    What is left of a nearly parallel direction after one projection is rounding in part, and that part can point along
    the axis: a second projection removes it ("twice is enough", Parlett 1980, section 6.9).
    """
    size = max(abs(x), abs(y), abs(z))
    if not size > 0.0:
        return 0.0, 0.0, 0.0
    x, y, z = x / size, y / size, z / size
    for _ in range(2):
        along = x * axis_x + y * axis_y + z * axis_z
        x, y, z = x - along * axis_x, y - along * axis_y, z - along * axis_z
    across = math.sqrt(x * x + y * y + z * z)
    if across <= PARALLEL:
        return 0.0, 0.0, 0.0
    return x / across, y / across, z / across
