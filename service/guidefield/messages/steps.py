"""The steps of a sequence: goals in order, and the objects that are attached and detached between them."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from guidefield.messages.conditions import Objective
from guidefield.messages.goals import GuidePlaneGoal, JointSetGoal, JointsGoal, PoseGoal
from guidefield.messages.scene import GuidePlanes
from guidefield.messages.values import (
    IDENTITY,
    ORIGIN,
    Message,
    Name,
    NonNegative,
    Positive,
    QuaternionXYZW,
    Vector3,
    require_finite,
    require_finite_number,
    require_unit_quaternion,
)

LONGEST_PAUSE = 3600.0
"""The longest pause after a step [s]."""


class RelativeGoal(Message, tag_field="type", tag="relative"):
    """Move the tip relative to its placement at the beginning of the step.

    Attributes:
        position: Translation [m].
        quaternion_xyzw: Rotation.
        frame: Axes of both: "tip": the tip's own; "world".
    """

    position: Vector3 = ORIGIN
    quaternion_xyzw: QuaternionXYZW = IDENTITY
    frame: Literal["tip", "world"] = "tip"

    def __post_init__(self) -> None:
        require_finite("position", self.position)
        require_unit_quaternion("quaternion_xyzw", self.quaternion_xyzw)


StepGoal = JointsGoal | JointSetGoal | PoseGoal | GuidePlaneGoal | RelativeGoal


class Attach(Message):
    """Attach an obstacle of the scene, where it stands, to a link from the end of a step on.

    Attributes:
        object: Name of the obstacle: a box, ball, cylinder, capsule or mesh.
        link: The link that holds it; null: the link that carries the step's tip.
        touch_links: Further links that it may touch while it is held.
        touch_objects: Obstacles that it may touch until it is 5 mm away from them (`min_clearance`, if that is more),
            and again after it is last so far away, until it is detached.
    """

    object: Name
    link: Name | None = None
    touch_links: list[Name] = []
    touch_objects: list[Name] = []


class PlanStep(Message):
    """One step of a sequence: a motion, a pause, then `detach` and `attach`, each optional.

    Attributes:
        goal: The goal; null: nothing moves.
        group: Joints that move; null: the request's.
        tip: Frame of the goal; null: the request's.
        linear: Whether the tip moves straight to a pose or relative goal, turning at a constant rate.
        line_tolerance: Largest distance of the tip from the straight line, if `linear` [m].
        turn_tolerance: Largest deviation from the constant turning, if `linear` [rad].
        guide_planes: Planes to cross, in order; "auto": derived.
        max_velocity_scaling_factor: Fraction of the velocity limits that is used; null: the request's.
        max_acceleration_scaling_factor: Fraction of the acceleration limits that is used; null: the request's.
        objective: The objective of its optimisation; null: the request's.
        pause: Time that the robot waits after its motion [s].
        detach: Name of an object that is put down where it is then: an obstacle from the end of the step on.
        attach: Object that is picked up at the end of the step, after `detach`.
        stop: Whether the robot comes to rest at the step's end; false: it passes the goal and goes on to the next one.
        radius: Largest deviation from a goal that is passed: of the tip's position [m] and rotation [rad] for a pose or
            relative goal, of every joint [rad or m] for a goal of joints.
    """

    goal: StepGoal | None = None
    group: str | list[Name] | None = None
    tip: Name | None = None
    linear: bool = False
    line_tolerance: Positive = 1e-3
    turn_tolerance: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 1e-2
    guide_planes: GuidePlanes | Literal["auto"] = []
    max_velocity_scaling_factor: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] | None = None
    max_acceleration_scaling_factor: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] | None = None
    objective: Objective | None = None
    pause: Annotated[NonNegative, msgspec.Meta(le=LONGEST_PAUSE)] = 0.0
    detach: Name | None = None
    attach: Attach | None = None
    stop: bool = True
    radius: Positive = 0.05

    def __post_init__(self) -> None:
        for field in ("line_tolerance", "turn_tolerance", "pause", "radius"):
            require_finite_number(field, getattr(self, field))
        if self.goal is None and not self.pause and self.detach is None and self.attach is None:
            raise ValueError("a step must have a `goal`, a `pause`, or something to `attach` or `detach`")
        self._require_passed()
        self._require_straight()

    def _require_passed(self) -> None:
        if self.stop:
            return
        if self.goal is None:
            raise ValueError("`stop: false` needs a `goal`: there is nothing to pass")
        if isinstance(self.goal, GuidePlaneGoal):
            raise ValueError("`stop: false` needs a `goal` of joints or a pose: a plane is crossed with `guide_planes`")
        for field in ("pause", "detach", "attach"):
            if getattr(self, field):
                raise ValueError(f"`stop: false` goes without `{field}`: that takes a robot at rest")

    def _require_straight(self) -> None:
        if not self.linear:
            return
        if not isinstance(self.goal, PoseGoal | RelativeGoal):
            raise ValueError("`linear` needs a `goal` of type 'pose' or 'relative': a straight way leads to a pose")
        if self.guide_planes:
            raise ValueError("`linear` goes without `guide_planes`: the way is given")
        if isinstance(self.goal, PoseGoal) and None in (
            *self.goal.position_tolerance,
            *self.goal.orientation_tolerance,
        ):
            raise ValueError("`linear` needs a `goal` that is free in no axis: a straight way leads to one pose")
