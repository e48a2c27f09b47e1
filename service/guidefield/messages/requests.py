"""All requests of clients, by the names under which everybody imports them, and their union.

The files of requests say what may be changed in them; a new request enters a union of its file.
"""

from __future__ import annotations

from guidefield.messages.certify_request import CertifyRequest as CertifyRequest, GivenTrajectory as GivenTrajectory
from guidefield.messages.conditions import (
    ROBOT_DESCRIPTIONS as ROBOT_DESCRIPTIONS,
    AttachedObject as AttachedObject,
    CartesianLimit as CartesianLimit,
    ConfigurationTable as ConfigurationTable,
    JointLimits as JointLimits,
    LineConstraint as LineConstraint,
    Objective as Objective,
    OrientationCone as OrientationCone,
    PathConstraint as PathConstraint,
    Payload as Payload,
    PlaneConstraint as PlaneConstraint,
    RobotReference as RobotReference,
    SceneReference as SceneReference,
    TargetPose as TargetPose,
    UrdfFile as UrdfFile,
    UrdfText as UrdfText,
)
from guidefield.messages.execution import ExecutionOptions as ExecutionOptions
from guidefield.messages.kinematics import (
    Clearance as Clearance,
    Dynamics as Dynamics,
    ForwardKinematics as ForwardKinematics,
    InverseKinematics as InverseKinematics,
    Jacobian as Jacobian,
    KinematicsRequest as KinematicsRequest,
    Potential as Potential,
    ReferenceFrame as ReferenceFrame,
)
from guidefield.messages.plan_request import (
    Attach as Attach,
    PlanRequest as PlanRequest,
    PlanStep as PlanStep,
    RelativeGoal as RelativeGoal,
)
from guidefield.messages.service import ReadInfo as ReadInfo
from guidefield.messages.stored import (
    LARGEST_PAGE as LARGEST_PAGE,
    RUNNING as RUNNING,
    UNREADABLE as UNREADABLE,
    ChangeScene as ChangeScene,
    DeleteRobot as DeleteRobot,
    DeleteRun as DeleteRun,
    DeleteScene as DeleteScene,
    ReadRobot as ReadRobot,
    ReadRobots as ReadRobots,
    ReadRun as ReadRun,
    ReadRuns as ReadRuns,
    ReadScene as ReadScene,
    ReadScenes as ReadScenes,
    RobotFiles as RobotFiles,
    StoredRequest,
    StoreRobot as StoreRobot,
    StoreScene as StoreScene,
)
from guidefield.messages.values import (
    Goal as Goal,
    GuidePlaneGoal as GuidePlaneGoal,
    JointSetGoal as JointSetGoal,
    JointsGoal as JointsGoal,
    JointValue as JointValue,
    PoseGoal as PoseGoal,
    Positions as Positions,
)

MotionRequest = PlanRequest | CertifyRequest
TaggedRequest = KinematicsRequest | CertifyRequest | StoredRequest | ReadInfo
Request = PlanRequest | TaggedRequest
