"""The curve that a controller draws of a motion, and the rows that it is sent."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from guidefield.messages.values import Message, NonNegative, Reply, require_finite_number

Interpolation = Literal["linear", "cubic", "quintic", "first_order_hold", "zero_order_hold"]
MOST_SENT_ROWS = 100_000
"""The largest number of rows, or of commands, that a controller is sent."""

HOLDS = ("first_order_hold", "zero_order_hold")
"""Interpolations of commands at the ticks of a clock; the others draw between rows, as a ROS trajectory is read."""


class ExecutionOptions(Message):
    """The curve that a controller draws, and how well the robot follows it.

    Attributes:
        interpolation: Between rows: "linear" in the joints, "cubic" by positions and velocities, "quintic" by
            accelerations too, as ros2_control's JointTrajectoryController draws them; between commands at ticks:
            "first_order_hold", straight from one to the next, "zero_order_hold", steps.
        rate: Of the ticks [1/s]; of rows the least, more are sent where the curve would leave the plan too far; null:
            the knots of the plan are sent.
        tolerance: How far each joint may be from that curve at each time, for all joints or by name [rad or m].
    """

    interpolation: Interpolation
    rate: Annotated[float, msgspec.Meta(ge=0.1, le=10_000.0)] | None = None
    tolerance: NonNegative | dict[str, NonNegative] = 0.0

    def __post_init__(self) -> None:
        if self.interpolation in HOLDS and self.rate is None:
            raise ValueError(f"`interpolation` {self.interpolation!r} needs the `rate` of its ticks")
        each = self.tolerance if isinstance(self.tolerance, dict) else {"": self.tolerance}
        for joint, value in each.items():
            require_finite_number(f"tolerance.{joint}" if joint else "tolerance", value)


class MotionDeviation(Reply):
    """How far a motion leaves the planned one, at the same times, between rows too.

    Attributes:
        largest: Of any joint [rad or m].
        joint: The joint.
        time: When [s].
        joints: The largest of each, by the names of `position_names`.
    """

    largest: float
    joint: str
    time: float
    joints: dict[str, float]


class ExecutionFigures(Reply):
    """A motion as a controller executes it: the rows to send, in columns as the reply's, and what is certified of it.

    Attributes:
        interpolation: The request's.
        rate: The request's [1/s].
        tolerance: Of each column of `position_names` [rad or m].
        deviation: Of the drawn curve from the planned one, without the tolerance.
        times: Of the rows, strictly increasing [s].
        positions: The rows [rad or m].
        velocities: The same [rad/s or m/s]; null where the interpolation reads none.
        accelerations: The same [rad/s^2 or m/s^2].
        end: When the motion has ended: one tick after the last row of a zero-order hold [s].
    """

    interpolation: str
    rate: float | None
    tolerance: list[float]
    deviation: MotionDeviation
    times: list[float]
    positions: list[list[float]]
    velocities: list[list[float]] | None
    accelerations: list[list[float]] | None
    end: float


def describe_deviation(found: MotionDeviation) -> str:
    """Say in words how far a motion leaves the planned one."""
    return f"{found.largest:.3g} rad or m at most, {found.joint} at {found.time:.3f} s"


def describe_execution(figures: ExecutionFigures) -> str:
    """Say in words what a motion is certified for: interpolation, rate, and the largest tolerance."""
    rate = "" if figures.rate is None else f" at {figures.rate:g} Hz"
    widest = max(figures.tolerance, default=0.0)
    return f"{figures.interpolation}{rate}, within {widest:g} rad or m of it"
