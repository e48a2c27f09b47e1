"""Parts of kinematics requests and replies: configurations, rates, poses, payloads, packed numbers, and their checks.

Names, order, defaults and meanings of fields are the wire and the Python API: a new one comes last. Docstrings of
messages, and the largest numbers here, are in docs/wire.md and the schemas: after a change, `tools/wire_page`.
"""

from __future__ import annotations

import math
import sys
from array import array
from collections.abc import Sequence
from itertools import chain
from typing import Annotated

import msgspec

from guidefield.messages.scene import VALUES_PER_CHECK
from guidefield.messages.values import (
    LARGEST,
    NO_INERTIA,
    ORIGIN,
    InertiaTensor,
    Mass,
    Message,
    Name,
    Positions,
    QuaternionXYZW,
    Reply,
    Tolerance3,
    Vector3,
    WorldPoint,
    require_finite,
    require_finite_configurations,
    require_finite_number,
    require_load,
    require_unit_quaternion,
)

MOST_POSES = 10_000
"""The largest number of poses of a request."""
MOST_STARTS = 10_000
"""The largest number of configurations from which a search may start."""
MOST_POINTS = 1_000_000
"""The largest number of points of a request."""
MOST_CONFIGURATIONS = 100_000
"""The largest number of configurations of a request."""
MOST_COLUMNS = 2_000
"""The largest number of columns of a table of configurations."""


class ConfigurationTable(Message):
    """Configurations as the rows of a table: smaller and faster to decode than one object for each.

    Attributes:
        names: The columns, named as in `position_names` of a plan's reply, in any order.
        rows: A row for each configuration [rad, m, or entries of a quaternion].
        float64: Instead of `rows` the same numbers packed row by row: little-endian float64, as bytes in MessagePack
            and base64 text in JSON.
    """

    names: Annotated[list[Name], msgspec.Meta(min_length=1, max_length=MOST_COLUMNS)]
    rows: Annotated[list[list[float]], msgspec.Meta(max_length=MOST_CONFIGURATIONS)] | None = None
    float64: bytes | None = None

    def __post_init__(self) -> None:
        if (self.rows is None) == (self.float64 is None):
            raise ValueError("give either `rows` or `float64`")
        width = len(self.names)
        if self.float64 is not None:
            require_packed_rows("float64", self.float64, width, MOST_CONFIGURATIONS)
        for index, row in enumerate(self.rows or ()):
            if len(row) != width:
                raise ValueError(f"`rows[{index}]` has {len(row)} values, but there are {width} `names`")
            if not math.hypot(*row) <= LARGEST:
                require_finite(f"rows[{index}]", row)


ConfigurationBatch = Annotated[list[Positions], msgspec.Meta(max_length=MOST_CONFIGURATIONS)] | ConfigurationTable

JointRates = Annotated[list[Positions], msgspec.Meta(max_length=MOST_CONFIGURATIONS)] | ConfigurationTable
"""Velocities or accelerations of joints, in the tangent space: a number, or the list of a joint with several (planar:
[vx, vy, wz]; spherical: [wx, wy, wz]; floating: [vx, vy, vz, wx, wy, wz]; in the moved frame)."""


class TargetPose(Message):
    """A pose for inverse kinematics; the fields are those of `PoseGoal`, a tolerance of 0 means rounding error."""

    position: WorldPoint
    quaternion_xyzw: QuaternionXYZW
    position_tolerance: Tolerance3 = (0.0, 0.0, 0.0)
    orientation_tolerance: Tolerance3 = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        require_finite("position", self.position)
        require_unit_quaternion("quaternion_xyzw", self.quaternion_xyzw)


class Payload(Message):
    """A rigid load on a link, for dynamics.

    Attributes:
        link: The link that carries it.
        mass: Its mass [kg].
        centre_of_mass: In the link's frame [m].
        inertia: Ixx, Ixy, Ixz, Iyy, Iyz, Izz about its centre of mass, in the axes of the link's frame [kg m^2].
    """

    link: Name
    mass: Mass
    centre_of_mass: Vector3 = ORIGIN
    inertia: InertiaTensor = NO_INERTIA

    def __post_init__(self) -> None:
        require_load(self.mass, self.centre_of_mass, self.inertia)


class PackedNumbers(Reply):
    """Numbers packed row by row.

    Attributes:
        shape: The size along each axis.
        float64: Little-endian float64: bytes in MessagePack and in Python, base64 text in JSON.

    Examples:
        >>> import numpy as np
        >>> from guidefield.messages.replies import PackedNumbers
        >>> packed = PackedNumbers(shape=[2, 1], float64=np.array([[0.5], [1.5]]).tobytes())
        >>> np.frombuffer(packed.float64, "<f8").reshape(packed.shape).tolist()
        [[0.5], [1.5]]
    """

    shape: list[int]
    float64: bytes


def count_configurations(configurations: ConfigurationBatch) -> int:
    """Return the number of configurations."""
    if not isinstance(configurations, ConfigurationTable):
        return len(configurations)
    if configurations.float64 is not None:
        return len(configurations.float64) // (8 * len(configurations.names))
    return len(configurations.rows or ())


def require_rates(field: str, rates: JointRates | None, configurations: ConfigurationBatch) -> None:
    """Raise ValueError unless there is a finite rate for each configuration, or none at all."""
    if rates is None:
        return
    given, needed = count_configurations(rates), count_configurations(configurations)
    if given != needed:
        raise ValueError(f"`{field}` must have one for each of the {needed} configurations, not {given}")
    require_finite_batch(field, rates)


def require_packed_rows(field: str, packed: bytes, width: int, most: int) -> None:
    """Raise ValueError unless packed float64 numbers are finite, and whole rows of a width, at most `most` of them."""
    if len(packed) % (8 * width):
        raise ValueError(f"`{field}` must hold whole rows of {width} numbers ({8 * width} bytes), not {len(packed)}")
    if len(packed) > 8 * width * most:
        raise ValueError(f"`{field}` may hold {most} rows, got {len(packed) // (8 * width)}")
    numbers = array("d", packed)
    if sys.byteorder == "big":
        numbers.byteswap()
    for begin in range(0, len(numbers), VALUES_PER_CHECK):
        if not math.hypot(*numbers[begin : begin + VALUES_PER_CHECK]) <= LARGEST:
            for index, number in enumerate(numbers[begin : begin + VALUES_PER_CHECK], begin):
                row, column = divmod(index, width)
                require_finite_number(f"{field}[{row}][{column}]", number)


def require_finite_batch(field: str, configurations: ConfigurationBatch) -> None:
    """Raise ValueError if a joint value of listed configurations isn't finite; a table checks its own."""
    if not isinstance(configurations, ConfigurationTable):
        require_finite_configurations(field, configurations)


def require_finite_points(field: str, points: Sequence[Vector3]) -> None:
    """Raise ValueError if a number is NaN, infinite or too large."""
    for begin in range(0, len(points), VALUES_PER_CHECK):
        some = points[begin : begin + VALUES_PER_CHECK]
        if not math.hypot(*chain.from_iterable(some)) <= LARGEST:  # the norm of all is at least that of each
            for index, point in enumerate(some, begin):
                require_finite(f"{field}[{index}]", point)
