"""The certify request: a motion that anybody made is to be judged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from typing import Annotated, Literal

import msgspec

from guidefield.messages.conditions import AllowedCollisions, AttachedObjects, JointLimits, PathConstraints
from guidefield.messages.goals import Positions, require_finite_positions
from guidefield.messages.references import RobotReference, SceneReference, settle_scene
from guidefield.messages.values import (
    LARGEST,
    PLANNING_TIME,
    AllowedTime,
    Message,
    Name,
    NonNegative,
    Placement,
    Positive,
    RunId,
    require_finite,
    require_finite_number,
)

MOST_ROWS = 1_000_000
"""Rows that a motion may have."""

TOGETHER = 20_000
"""So many rows are checked at one go, in some milliseconds."""

_ROWS = ("positions", "velocities", "accelerations")

GivenRows = Annotated[list[list[float]], msgspec.Meta(min_length=1, max_length=MOST_ROWS)]


class GivenTrajectory(Message):
    """A motion in time: with velocities the knots of a cubic Hermite curve, without them samples.

    Attributes:
        positions: A row for each time, in the columns of `position_names` [rad, m, or entries of a quaternion].
        times: Increasing [s]; null: the request's `time_step` says them.
        velocities: A row for each time, in the columns of `velocity_names` [rad/s or m/s].
        accelerations: May stand here, as in a plan's reply. The curve follows from the others; a warning says where it
            has other accelerations.
    """

    positions: GivenRows
    times: list[float] | None = None
    velocities: GivenRows | None = None
    accelerations: GivenRows | None = None

    def __post_init__(self) -> None:
        if self.times is not None:
            require_finite("times", self.times)
        for field in _ROWS:
            if (rows := getattr(self, field)) is not None:
                require_finite_rows(field, rows)
        self.require_same_lengths()

    def require_same_lengths(self) -> None:
        """Raise ValueError unless there are as many times, and rows of each kind, as there are positions."""
        for field in _ROWS:
            if (rows := getattr(self, field)) is not None and len(rows) != len(self.positions):
                raise ValueError(f"`{field}` must have a row for each of `positions`, {len(self.positions)} in all")
        if self.times is not None and len(self.times) != len(self.positions):
            raise ValueError(
                f"`times` must have one for each row of `positions`, {len(self.positions)}, not {len(self.times)}"
            )


class CertifyRequest(Message, tag_field="type", tag="certify"):
    """Ask whether a motion is free and within limits: one of your own, of another planner's, or one that was kept.

    Give `path`, waypoints with straight pieces between them, or `trajectory`, a motion in time. Rows are joint values
    in the columns of `position_names`, as a plan's reply names them, in any order.

    Attributes:
        robot: A name of the catalog or of a stored robot, or the robot itself.
        scene: A name, or the scene itself.
        path: Waypoints, a row for each; between them the motion is straight in the joints' coordinates.
        trajectory: Knots or samples in time, instead of a path.
        schema: Version of this message.
        run_id: What to call the run; null: the service makes a name.
        robot_placement: Of the robot's root in the world.
        group: Joints that move: a group's name or their names; null: those of the columns.
        tip: Frame whose way a recording shows; null: the robot's own.
        start: Of joints without a column, which stand still; those left out here are at rest as the robot has it.
        position_names: Columns of positions; null: those of a plan's reply for this group.
        velocity_names: Columns of velocities; null: those of the same joints in the same order.
        time_step: Between rows of the trajectory, in place of its times [s].
        interpolation: Which curve through samples is judged: "spline", twice continuously differentiable, or "linear",
            straight pieces.
        min_clearance: What moving links have to keep from obstacles [m].
        attached_objects: What links hold.
        allowed_collisions: Pairs of links and obstacles that may touch.
        path_constraints: What frames have to keep all along the motion.
        limits: Of joints, by name.
        max_velocity_scaling_factor: Share of the velocity limits that may be used.
        max_acceleration_scaling_factor: Share of the acceleration limits that may be used.
        leave_start_contact: Whether a start in slight contact may be left, instead of being refused.
        allowed_time: From the request's arrival [s].
        recording: How much is recorded.
        proof: Whether a proof that the motion is free is kept with the run: anybody can check it (`referee.md`).

    Example:
        >>> from guidefield import CertifyRequest
        >>> names = ["shoulder_pan_joint", "elbow_joint"]
        >>> request = CertifyRequest("ur5", "table", path=[[0.0, 1.0], [0.4, 1.2]], position_names=names)
        >>> request.interpolation, request.allowed_time
        ('spline', 5.0)

        `guidefield.answer(request)` judges it here, `Client.certify(request)` in a service.
    """

    robot: RobotReference
    scene: SceneReference
    path: GivenRows | None = None
    trajectory: GivenTrajectory | None = None
    schema: Literal[1] = 1
    run_id: RunId | None = None
    robot_placement: Placement = Placement()
    group: str | list[Name] | None = None
    tip: Name | None = None
    start: Positions = {}
    position_names: list[Name] | None = None
    velocity_names: list[Name] | None = None
    time_step: Positive | None = None
    interpolation: Literal["spline", "linear"] = "spline"
    min_clearance: NonNegative = 0.0
    attached_objects: AttachedObjects = []
    allowed_collisions: AllowedCollisions = []
    path_constraints: PathConstraints = []
    limits: dict[str, JointLimits] = {}
    max_velocity_scaling_factor: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 1.0
    max_acceleration_scaling_factor: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 1.0
    leave_start_contact: bool = False
    allowed_time: AllowedTime = PLANNING_TIME
    recording: Literal["full", "summary", "off"] = "full"
    proof: bool = False

    def __post_init__(self) -> None:
        settle_scene(self)
        require_finite_positions("start", self.start)
        require_finite_number("min_clearance", self.min_clearance)
        if self.time_step is not None:
            require_finite_number("time_step", self.time_step)
        if self.path is not None:
            require_finite_rows("path", self.path)
        if (self.path is None) == (self.trajectory is None):
            raise ValueError("give either a `path` or a `trajectory`")
        if self.trajectory is None:
            if self.time_step is not None:
                raise ValueError("a `path` has no times: `time_step` is for a `trajectory`")
            if self.velocity_names is not None:
                raise ValueError("a `path` has no velocities: `velocity_names` is for a `trajectory` that has some")
            return
        given: object = self.trajectory
        if not isinstance(given, GivenTrajectory):
            return  # plain data, in Python: it is checked when it is decoded
        if (given.times is None) == (self.time_step is None):
            raise ValueError("a `trajectory` has either `times`, or the request a `time_step`")
        if self.velocity_names is not None and given.velocities is None:
            raise ValueError("`velocity_names` is for a `trajectory` that has `velocities`")


def require_finite_rows(field: str, rows: Sequence[Sequence[float]]) -> None:
    """Raise ValueError if a number is NaN, infinite or too large, or the rows aren't equally long.

    Args:
        field: What they are called.
        rows: The rows.
    """
    for begin in range(0, len(rows), TOGETHER):
        some = rows[begin : begin + TOGETHER]
        if {*map(len, some)} == {len(rows[0])} and math.hypot(*chain.from_iterable(some)) <= LARGEST:
            continue  # the norm of all is more than that of each
        for index, row in enumerate(some, begin):
            if not sum(map(abs, row)) <= LARGEST:
                require_finite(f"{field}[{index}]", row)
            if len(row) != len(rows[0]):
                raise ValueError(f"`{field}[{index}]` has {len(row)} values, `{field}[0]` has {len(rows[0])}")
