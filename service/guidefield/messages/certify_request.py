"""The certify request: certify a given motion, from any source; the handlers' certify_problem.py reads its curve.

Names, order, defaults and meanings of fields are the wire and the Python API: a new one comes last. Docstrings of
messages are in docs/wire.md and the schemas, and `MOST_ROWS` among its limits: after a change, `tools/wire_page`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import chain
from typing import Annotated, Literal

import msgspec

from guidefield.messages.conditions import (
    AllowedCollisions,
    AttachedObjects,
    CartesianLimits,
    JointLimits,
    PathConstraints,
    RobotReference,
    SceneReference,
    settle_scene,
)
from guidefield.messages.execution import ExecutionOptions
from guidefield.messages.values import (
    LARGEST,
    PLANNING_TIME,
    AllowedTime,
    Message,
    Name,
    NonNegative,
    Placement,
    Positions,
    Positive,
    RunId,
    require_finite,
    require_finite_number,
    require_finite_positions,
)

MOST_ROWS = 1_000_000
"""The largest number of rows of a motion."""

ROWS_PER_CHECK = 20_000
"""Rows checked by one call, which holds the interpreter for some milliseconds."""

_ROWS = ("positions", "velocities", "accelerations")

GivenRows = Annotated[list[list[float]], msgspec.Meta(min_length=1, max_length=MOST_ROWS)]


class GivenTrajectory(Message):
    """A motion in time: with velocities the knots of a cubic Hermite curve, without them samples.

    Attributes:
        positions: A row for each time, in the columns of `position_names` [rad, m, or entries of a quaternion].
        times: Increasing [s]; null: multiples of the request's `time_step`.
        velocities: A row for each time, in the columns of `velocity_names` [rad/s or m/s].
        accelerations: Optional, as in a plan's reply. The curve follows from the others; if it has other accelerations,
            a warning names the place.
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
        self._require_same_lengths()

    def _require_same_lengths(self) -> None:
        for field in _ROWS:
            if (rows := getattr(self, field)) is not None and len(rows) != len(self.positions):
                raise ValueError(f"`{field}` must have a row for each of `positions`, {len(self.positions)} in all")
        if self.times is not None and len(self.times) != len(self.positions):
            raise ValueError(
                f"`times` must have one for each row of `positions`, {len(self.positions)}, not {len(self.times)}"
            )


class CertifyRequest(Message, tag_field="type", tag="certify"):
    """Ask whether a motion is free and within limits: your own, another planner's, or one of a stored run.

    Give `path`, waypoints with straight pieces between them, or `trajectory`, a motion in time. Rows are joint values
    in the columns of `position_names`, as a plan's reply names them, in any order.

    Attributes:
        robot: A name of the catalog or of a stored robot, or the robot itself.
        scene: A name, or the scene itself.
        path: Waypoints, a row for each; between them the motion is straight in the joints' coordinates.
        trajectory: Knots or samples in time, instead of a path.
        run_id: Name of the run; null: the service makes a name.
        robot_placement: Of the robot's root in the world.
        group: Joints that move: a group's name or their names; null: those of the columns.
        tip: Frame whose path a recording shows; null: the robot's own.
        start: Positions of joints without a column, which stand still; joints left out here too are at the robot's rest
            configuration.
        position_names: Columns of positions; null: those of a plan's reply for this group.
        velocity_names: Columns of velocities; null: those of the same joints in the same order.
        time_step: Between rows of the trajectory, instead of its times [s].
        interpolation: The curve through samples: "spline", twice continuously differentiable, or "linear", straight
            pieces.
        min_clearance: Smallest allowed distance of moving links to obstacles [m].
        attached_objects: Objects held by links.
        allowed_collisions: Pairs of links and obstacles that may touch.
        path_constraints: Constraints of frames along the whole motion.
        limits: Limits of joints, by name.
        cartesian_limits: Limits of the speed of frames and links in space; for a `trajectory`.
        max_velocity_scaling_factor: Allowed fraction of the velocity limits.
        max_acceleration_scaling_factor: Allowed fraction of the acceleration limits.
        leave_start_contact: Whether a start in slight contact may be left, instead of being refused.
        allowed_time: From the request's arrival [s].
        recording: Extent of the recording.
        proof: Whether to keep a proof with the run that the motion is free; anybody can check it (docs/referee.md).
        execution: The curve that a controller draws of the trajectory, judged instead of it (docs/execution.md).
        planned: The motion that the trajectory was to follow, in the same columns, with `times`: the reply says how far
            it was left, and a recording shows both.

    Examples:
        >>> from guidefield import CertifyRequest
        >>> names = ["shoulder_pan_joint", "elbow_joint"]
        >>> request = CertifyRequest("ur5", "table", path=[[0.0, 1.0], [0.4, 1.2]], position_names=names)
        >>> request.interpolation, request.allowed_time
        ('spline', 5.0)

        `guidefield.answer(request)` certifies it in this process, `Client.certify(request)` in a service.
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
    execution: ExecutionOptions | None = None
    cartesian_limits: CartesianLimits = []
    planned: GivenTrajectory | None = None

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
            self._require_untimed()
            return
        given: object = self.trajectory
        if not isinstance(given, GivenTrajectory):
            return  # plain data, in Python: the decoder checks it
        if (given.times is None) == (self.time_step is None):
            raise ValueError("a `trajectory` has either `times`, or the request a `time_step`")
        if self.planned is not None and self.execution is not None:
            raise ValueError("give `planned` or `execution`: what is executed was drawn already")
        if isinstance(self.planned, GivenTrajectory) and self.planned.times is None:
            raise ValueError("`planned` must have `times`")
        if self.velocity_names is not None and given.velocities is None:
            raise ValueError("`velocity_names` is for a `trajectory` that has `velocities`")

    def _require_untimed(self) -> None:
        lacking = {
            "execution": (self.execution, "no times", "is"),
            "planned": (self.planned, "no times", "is"),
            "time_step": (self.time_step, "no times", "is"),
            "cartesian_limits": (self.cartesian_limits or None, "no speed", "are"),
        }
        for field, (value, what, verb) in lacking.items():
            if value is not None:
                raise ValueError(f"a `path` has {what}: `{field}` {verb} for a `trajectory`")
        if self.velocity_names is not None:
            raise ValueError("a `path` has no velocities: `velocity_names` is for a `trajectory` that has some")


def require_finite_rows(field: str, rows: Sequence[Sequence[float]]) -> None:
    """Raise ValueError if a number is NaN, infinite or too large, or the rows aren't equally long."""
    for begin in range(0, len(rows), ROWS_PER_CHECK):
        some = rows[begin : begin + ROWS_PER_CHECK]
        if {*map(len, some)} == {len(rows[0])} and math.hypot(*chain.from_iterable(some)) <= LARGEST:
            continue  # the norm of all is at least that of each
        for index, row in enumerate(some, begin):
            if not sum(map(abs, row)) <= LARGEST:
                require_finite(f"{field}[{index}]", row)
            if len(row) != len(rows[0]):
                raise ValueError(f"`{field}[{index}]` has {len(row)} values, `{field}[0]` has {len(rows[0])}")
