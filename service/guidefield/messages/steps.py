"""The steps of a sequence: goals one after the other, and what is picked up and put down on the way."""

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
"""For so long a robot may wait after a step [s]."""


class RelativeGoal(Message, tag_field="type", tag="relative"):
    """Move the tip from where it is when the step begins.

    Attributes:
        position: By how much [m].
        quaternion_xyzw: How it is turned.
        frame: In whose axes both are: "tip": the tip's own; "world".
    """

    position: Vector3 = ORIGIN
    quaternion_xyzw: QuaternionXYZW = IDENTITY
    frame: Literal["tip", "world"] = "tip"

    def __post_init__(self) -> None:
        require_finite("position", self.position)
        require_unit_quaternion("quaternion_xyzw", self.quaternion_xyzw)


StepGoal = JointsGoal | JointSetGoal | PoseGoal | GuidePlaneGoal | RelativeGoal


class Attach(Message):
    """Have a link hold an obstacle of the scene, where it is, from the end of a step on.

    Attributes:
        object: Name of the obstacle: a box, ball, cylinder, capsule or mesh.
        link: What holds it; null: the link that carries the step's tip.
        touch_links: Links that it may touch beside that one while it is held.
        touch_objects: Obstacles that it may touch until it is 5 mm away from them (`min_clearance`, if that is more),
            and again from when it is last so far away until it is detached.
    """

    object: Name
    link: Name | None = None
    touch_links: list[Name] = []
    touch_objects: list[Name] = []


class PlanStep(Message):
    """One step of a sequence: a motion, a pause, then `detach` and `attach`, each where it is given.

    Attributes:
        goal: What to reach; null: nothing moves.
        group: Joints that move; null: the request's.
        tip: Frame that the goal is about; null: the request's.
        linear: Whether the tip goes straight to a pose or relative goal, turning evenly.
        line_tolerance: How far the tip may be from the straight way, where `linear` [m].
        turn_tolerance: How far it may be turned otherwise than evenly, where `linear` [rad].
        guide_planes: Planes to cross, in order; "auto": derived.
        max_velocity_scaling_factor: Share of the velocity limits that is used; null: the request's.
        max_acceleration_scaling_factor: Share of the acceleration limits that is used; null: the request's.
        objective: What its motion is optimised for; null: as the request says.
        pause: For how long the robot waits after its motion [s].
        detach: Name of an object that is put down where it is then: an obstacle from the end of the step on.
        attach: What is picked up at the end of the step, after what is put down.
        stop: Whether the robot comes to rest at the step's end; false: it passes the goal on its way to the next one.
        radius: How far from a goal that is passed the robot may leave its way: the tip's place [m] and its turn [rad]
            for a pose or relative goal, every joint [rad or m] for one of joints.
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
