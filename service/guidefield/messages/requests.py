"""The requests of clients: the plan request and the tagged requests of the other keys."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from guidefield.messages.certify_request import CertifyRequest as CertifyRequest, GivenTrajectory as GivenTrajectory
from guidefield.messages.conditions import (
    AllowedCollisions,
    AttachedObject as AttachedObject,
    AttachedObjects,
    JointLimits as JointLimits,
    LineConstraint as LineConstraint,
    Objective as Objective,
    OrientationCone as OrientationCone,
    PathConstraint as PathConstraint,
    PathConstraints,
    PlaneConstraint as PlaneConstraint,
)
from guidefield.messages.goals import (
    Goal as Goal,
    GuidePlaneGoal as GuidePlaneGoal,
    JointSetGoal as JointSetGoal,
    JointsGoal as JointsGoal,
    JointValue as JointValue,
    PoseGoal as PoseGoal,
    Positions as Positions,
    Tolerance3 as Tolerance3,
    require_finite_positions,
)
from guidefield.messages.kinematics_requests import (
    Clearance as Clearance,
    ConfigurationBatch as ConfigurationBatch,
    ConfigurationTable as ConfigurationTable,
    Dynamics as Dynamics,
    ForwardKinematics as ForwardKinematics,
    InverseKinematics as InverseKinematics,
    Jacobian as Jacobian,
    KinematicsRequest as KinematicsRequest,
    Payload as Payload,
    Potential as Potential,
    ReferenceFrame as ReferenceFrame,
    TargetPose as TargetPose,
)
from guidefield.messages.references import (
    ROBOT_DESCRIPTIONS as ROBOT_DESCRIPTIONS,
    RobotReference as RobotReference,
    SceneReference as SceneReference,
    UrdfFile as UrdfFile,
    UrdfText as UrdfText,
    settle_scene,
)
from guidefield.messages.scene import GuidePlanes
from guidefield.messages.steps import (
    Attach as Attach,
    PlanStep as PlanStep,
    RelativeGoal as RelativeGoal,
)
from guidefield.messages.store_requests import (
    ChangeScene as ChangeScene,
    DeleteRobot as DeleteRobot,
    DeleteRun as DeleteRun,
    DeleteScene as DeleteScene,
    ReadInfo as ReadInfo,
    ReadRobot as ReadRobot,
    ReadRobots as ReadRobots,
    ReadRun as ReadRun,
    ReadRuns as ReadRuns,
    ReadScene as ReadScene,
    ReadScenes as ReadScenes,
    RobotFiles as RobotFiles,
    StoreRequest,
    StoreRobot as StoreRobot,
    StoreScene as StoreScene,
)
from guidefield.messages.values import (
    PLANNING_TIME,
    AllowedTime,
    Message,
    Name,
    NonNegative,
    Placement,
    RunId,
    require_finite_number,
)

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
        schema: Version of this message.
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
        max_velocity_scaling_factor: Fraction of the velocity limits that is used.
        max_acceleration_scaling_factor: Fraction of the acceleration limits that is used.
        allowed_planning_time: From the request's arrival [s].
        optimization_iterations: Rounds that shorten a connection, within half of the remaining time, and most steps of
            the optimisation; null: no rounds, and the optimisation's own stopping rule; 0: the path as it was found, at
            the highest speed.
        objective: Objective of the optimisation: "balanced": fast, and well away from obstacles; "time": the fastest
            motion found, with more tries; "clearance": in the middle of the free space. `min_clearance` holds always.
        leave_start_contact: Whether the motion first leaves a start in slight contact, instead of being refused.
        sample_rate: Samples per second of the trajectory in the reply [1/s]; null: the knots of the curve.
        recording: Extent of the recording.
        seed: Of all randomness.
        steps: Steps in order, instead of a goal, as one motion; guide planes are then the steps' own.
        proof: Whether to keep a proof with the run that the motion is free; anybody can check it (`referee.md`).

    Example:
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

    def __post_init__(self) -> None:
        settle_scene(self)
        if (self.goal is None) == (not self.steps):
            raise ValueError(f"give a `goal` or `steps`, got {'both' if self.steps else 'neither'}")
        require_finite_positions("start", self.start)
        for field in ("start_velocities", "start_accelerations", "end_velocities"):
            for joint, rate in getattr(self, field).items():
                require_finite_number(f"{field}.{joint}", rate)
        require_finite_number("min_clearance", self.min_clearance)


MotionRequest = PlanRequest | CertifyRequest
TaggedRequest = KinematicsRequest | CertifyRequest | StoreRequest
Request = PlanRequest | TaggedRequest
