"""Columns of messages, split into the joint and the coordinate that each is of."""

from __future__ import annotations

from collections.abc import Sequence

COORDINATES = ("", "x", "y", "z", "theta", "qx", "qy", "qz", "qw", "vx", "vy", "vz", "wx", "wy", "wz")
"""Ends of columns of joints of several coordinates, in their order."""


def split_columns(names: Sequence[str]) -> list[tuple[str, str]]:
    """Split columns into joint and coordinate.

    The name of a joint may have a dot itself: `joint_0.0`, or `base.x` beside no other column of `base`.
    """
    found = []
    for name in names:
        joint, _, coordinate = name.rpartition(".")
        others = sum(other.startswith(f"{joint}.") and other[len(joint) + 1 :] in COORDINATES for other in names)
        found.append((joint, coordinate) if joint and coordinate in COORDINATES[1:] and others > 1 else (name, ""))
    return found
