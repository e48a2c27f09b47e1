"""The plan request, to a goal or through steps that move, pause, pick up and put down.

Names, order, defaults and meanings of fields are the wire and the Python API: a new one comes last. Docstrings of
messages, and the largest numbers here, are in docs/wire.schema.json: after a change, `tools/wire_page`.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from guidefield.messages.conditions import (
    AllowedCollisions,
    AttachedObjects,
    CartesianLimits,
    JointLimits,
    Objective,
    PathConstraints,
    RobotReference,
    SceneReference,
    settle_scene,
)
from guidefield.messages.execution import ExecutionOptions
from guidefield.messages.scene import GuidePlanes
from guidefield.messages.values import (
    IDENTITY,
    NO_INERTIA,
    ORIGIN,
    PLANNING_TIME,
    AllowedTime,
    Goal,
    GuidePlaneGoal,
    InertiaTensor,
    JointSetGoal,
    JointsGoal,
    Mass,
    Message,
    Name,
    NonNegative,
    Placement,
    PoseGoal,
    Positions,
    Positive,
    QuaternionXYZW,
    RunId,
    Vector3,
    require_finite,
    require_finite_number,
    require_finite_positions,
    require_load,
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

    One that moves is attached where it comes to rest; the robot waits for that.

    Attributes:
        object: Name of the obstacle: a box, ball, cylinder, capsule or mesh.
        link: The link that holds it; null: the link that carries the step's tip.
        touch_links: Further links that it may touch while it is held.
        touch_objects: Obstacles that it may touch until it is 5 mm away from them (`min_clearance`, if that is more),
            and again after it is last so far away, until it is detached.
        mass: Its mass [kg]; null: nothing of it counts in torques.
        centre_of_mass: In the obstacle's own frame [m].
        inertia: Ixx, Ixy, Ixz, Iyy, Iyz, Izz about its centre of mass, in the axes of that frame [kg m^2].
    """

    object: Name
    link: Name | None = None
    touch_links: list[Name] = []
    touch_objects: list[Name] = []
    mass: Mass | None = None
    centre_of_mass: Vector3 = ORIGIN
    inertia: InertiaTensor = NO_INERTIA

    def __post_init__(self) -> None:
        require_load(self.mass, self.centre_of_mass, self.inertia)


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
        cartesian_limits: Limits of speed in space during its motion; null: the request's.
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
    cartesian_limits: CartesianLimits | None = None

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


MOST_STEPS = 200
"""The largest number of steps of a request."""


class PlanRequest(Message):
    """Ask for a motion: a certified, timed path from `start` to `goal`, or through `steps` in order.

    Robot, scene, and goal or steps are enough. Lengths are in metres, angles in radians, times in seconds; joints go by
    name.

    Attributes:
        robot: A name of the catalog or of a stored robot, or the robot itself.
        scene: A name, the scene itself, or changes of a stored one (`RequestScene`).
        goal: The goal; null: there are `steps`.
        run_id: Name of the run; null: the service makes a name.
        robot_placement: Of the robot's root in the world.
        group: Joints that move: a group's name or their names; null: every actuated joint between root and tip.
        tip: Frame that reaches goals and guide planes; null: the robot's own.
        start: Joints left out are at the robot's rest configuration.
        start_velocities: Velocities of joints at the start, by name; others are at rest [rad/s or m/s].
        start_accelerations: Accelerations of joints at the start, by name; others have none [rad/s^2 or m/s^2].
        end_velocities: Velocities of joints at a goal of joints, by name; others are at rest [rad/s or m/s].
        guide_planes: Planes to cross, in order; null: the scene's; "auto": derived, and sent back in the reply.
        planner: "guided": guide planes alone; "tree": a connection alone; "auto": first the planes, then a connection.
        minimizer: Descent of the guided planner; "univariate" is for chains of ball or universal joints only.
        min_clearance: Smallest allowed distance of moving links to obstacles [m].
        attached_objects: Objects held by links.
        allowed_collisions: Pairs of links and obstacles that may touch.
        path_constraints: Constraints of frames along the whole motion.
        limits: Limits of joints, by name.
        cartesian_limits: Limits of the speed of frames and links in space.
        max_velocity_scaling_factor: Fraction of the velocity limits that is used.
        max_acceleration_scaling_factor: Fraction of the acceleration limits that is used.
        allowed_planning_time: From the request's arrival [s].
        optimization_iterations: Rounds that shorten a connection, within half of the remaining time, and most steps of
            the optimisation; null: rounds for detours alone, and the optimisation's own stopping rule; 0: the path as
            it was found, at the highest speed.
        objective: Objective of the optimisation: "balanced": fast, and well away from obstacles; "time": the fastest
            motion found, with more tries; "clearance": in the middle of the free space. `min_clearance` holds always.
        leave_start_contact: Whether the motion first leaves a start in slight contact, instead of being refused.
        sample_rate: Samples per second of the trajectory in the reply [1/s]; null: the knots of the curve.
        recording: Extent of the recording.
        seed: Of all randomness.
        steps: Steps in order, instead of a goal, as one motion; guide planes are then the steps' own.
        proof: Whether to keep a proof with the run that the motion is free; anybody can check it (docs/referee.md).
        execution: The curve that a controller draws of the motion, certified instead of it (docs/execution.md).

    Examples:
        >>> from guidefield import Box, JointsGoal, PlanRequest, Scene
        >>> crate = Box(name="crate", size=(0.2, 0.2, 0.2), position=(0.6, 0.6, 0.3))
        >>> goal = JointsGoal({"elbow_joint": 1.2})
        >>> request = PlanRequest("ur5", Scene("mine", obstacles=[crate]), goal, min_clearance=0.01)
        >>> request.planner, request.allowed_planning_time
        ('auto', 5.0)

        `guidefield.answer(request)` plans it in this process, `Client.plan(request)` in a service.
    """

    robot: RobotReference
    scene: SceneReference
    goal: Goal | None = None
    schema: Literal[1] = 1
    run_id: RunId | None = None
    robot_placement: Placement = Placement()
    group: str | list[Name] | None = None
    tip: Name | None = None
    start: Positions = {}
    start_velocities: dict[str, float] = {}
    start_accelerations: dict[str, float] = {}
    end_velocities: dict[str, float] = {}
    guide_planes: GuidePlanes | Literal["auto"] | None = None
    planner: Literal["auto", "guided", "tree"] = "auto"
    minimizer: Literal["projected", "univariate"] = "projected"
    min_clearance: NonNegative = 0.0
    attached_objects: AttachedObjects = []
    allowed_collisions: AllowedCollisions = []
    path_constraints: PathConstraints = []
    limits: dict[str, JointLimits] = {}
    max_velocity_scaling_factor: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 1.0
    max_acceleration_scaling_factor: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 1.0
    allowed_planning_time: AllowedTime = PLANNING_TIME
    optimization_iterations: Annotated[int, msgspec.Meta(ge=0, le=1_000_000)] | None = None
    objective: Objective = "balanced"
    leave_start_contact: bool = False
    sample_rate: Annotated[float, msgspec.Meta(gt=0.0, le=10_000.0)] | None = None
    recording: Literal["full", "summary", "off"] = "full"
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**53)] = 0
    steps: Annotated[list[PlanStep], msgspec.Meta(max_length=MOST_STEPS)] = []
    proof: bool = False
    execution: ExecutionOptions | None = None
    cartesian_limits: CartesianLimits = []

    def __post_init__(self) -> None:
        settle_scene(self)
        if (self.goal is None) == (not self.steps):
            raise ValueError(f"give a `goal` or `steps`, got {'both' if self.steps else 'neither'}")
        require_finite_positions("start", self.start)
        for field in ("start_velocities", "start_accelerations", "end_velocities"):
            for joint, rate in getattr(self, field).items():
                require_finite_number(f"{field}.{joint}", rate)
        require_finite_number("min_clearance", self.min_clearance)
