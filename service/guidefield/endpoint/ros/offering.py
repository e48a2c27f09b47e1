"""The service on ROS, from the robot's name to a node that is there."""

from __future__ import annotations

import contextlib
import functools
import json
import logging
from collections.abc import Iterator

import zenoh

from guidefield.endpoint.link import UNLESS_TOLD
from guidefield.endpoint.ros.cdr import Types
from guidefield.endpoint.ros.engine_door import Ask, EngineDoor
from guidefield.endpoint.ros.known_robot import KnownRobot
from guidefield.endpoint.ros.node import RosNode
from guidefield.endpoint.ros.options import LATCHING, Distribution, RosSettings
from guidefield.endpoint.ros.snapshot import KnownScene, Snapshot
from guidefield.robot.model.model import RobotModel
from guidefield.robot.urdf.encoding import read_xml

MESSAGES: dict[str, str] = {
    "builtin_interfaces/Time": "int32 sec, uint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec, uint32 nanosec",
    "service_msgs/ServiceEventInfo": (
        "uint8 event_type, builtin_interfaces/Time stamp, uint8[16] client_gid, int64 sequence_number"
    ),
    "std_msgs/Header": "builtin_interfaces/Time stamp, string frame_id",
    "std_msgs/String": "string data",
    "std_msgs/ColorRGBA": "float32 r, float32 g, float32 b, float32 a",
    "geometry_msgs/Point": "float64 x, float64 y, float64 z",
    "geometry_msgs/Point32": "float32 x, float32 y, float32 z",
    "geometry_msgs/Polygon": "Point32[] points",
    "geometry_msgs/Vector3": "float64 x, float64 y, float64 z",
    "geometry_msgs/Quaternion": "float64 x, float64 y, float64 z, float64 w",
    "geometry_msgs/Pose": "Point position, Quaternion orientation",
    "geometry_msgs/PoseStamped": "std_msgs/Header header, Pose pose",
    "geometry_msgs/Transform": "Vector3 translation, Quaternion rotation",
    "geometry_msgs/TransformStamped": "std_msgs/Header header, string child_frame_id, Transform transform",
    "geometry_msgs/Twist": "Vector3 linear, Vector3 angular",
    "geometry_msgs/Accel": "Vector3 linear, Vector3 angular",
    "geometry_msgs/Wrench": "Vector3 force, Vector3 torque",
    "sensor_msgs/JointState": (
        "std_msgs/Header header, string[] name, float64[] position, float64[] velocity, float64[] effort"
    ),
    "sensor_msgs/MultiDOFJointState": (
        "std_msgs/Header header, string[] joint_names, geometry_msgs/Transform[] transforms,"
        " geometry_msgs/Twist[] twist, geometry_msgs/Wrench[] wrench"
    ),
    "trajectory_msgs/JointTrajectoryPoint": (
        "float64[] positions, float64[] velocities, float64[] accelerations, float64[] effort,"
        " builtin_interfaces/Duration time_from_start"
    ),
    "trajectory_msgs/JointTrajectory": "std_msgs/Header header, string[] joint_names, JointTrajectoryPoint[] points",
    "trajectory_msgs/MultiDOFJointTrajectoryPoint": (
        "geometry_msgs/Transform[] transforms, geometry_msgs/Twist[] velocities,"
        " geometry_msgs/Twist[] accelerations, builtin_interfaces/Duration time_from_start"
    ),
    "trajectory_msgs/MultiDOFJointTrajectory": (
        "std_msgs/Header header, string[] joint_names, MultiDOFJointTrajectoryPoint[] points"
    ),
    "shape_msgs/SolidPrimitive": "uint8 type, float64[<=3] dimensions, geometry_msgs/Polygon polygon",
    "shape_msgs/MeshTriangle": "uint32[3] vertex_indices",
    "shape_msgs/Mesh": "MeshTriangle[] triangles, geometry_msgs/Point[] vertices",
    "shape_msgs/Plane": "float64[4] coef",
    "object_recognition_msgs/ObjectType": "string key, string db",
    "octomap_msgs/Octomap": "std_msgs/Header header, bool binary, string id, float64 resolution, int8[] data",
    "octomap_msgs/OctomapWithPose": "std_msgs/Header header, geometry_msgs/Pose origin, Octomap octomap",
    "moveit_msgs/AllowedCollisionEntry": "bool[] enabled",
    "moveit_msgs/AllowedCollisionMatrix": (
        "string[] entry_names, AllowedCollisionEntry[] entry_values, string[] default_entry_names,"
        " bool[] default_entry_values"
    ),
    "moveit_msgs/AttachedCollisionObject": (
        "string link_name, CollisionObject object, string[] touch_links,"
        " trajectory_msgs/JointTrajectory detach_posture, float64 weight"
    ),
    "moveit_msgs/BoundingVolume": (
        "shape_msgs/SolidPrimitive[] primitives, geometry_msgs/Pose[] primitive_poses, shape_msgs/Mesh[] meshes,"
        " geometry_msgs/Pose[] mesh_poses"
    ),
    "moveit_msgs/CartesianPoint": (
        "geometry_msgs/Pose pose, geometry_msgs/Twist velocity, geometry_msgs/Accel acceleration"
    ),
    "moveit_msgs/CartesianTrajectory": (
        "std_msgs/Header header, string tracked_frame, CartesianTrajectoryPoint[] points"
    ),
    "moveit_msgs/CartesianTrajectoryPoint": "CartesianPoint point, builtin_interfaces/Duration time_from_start",
    "moveit_msgs/CollisionObject": (
        "std_msgs/Header header, geometry_msgs/Pose pose, string id, object_recognition_msgs/ObjectType type,"
        " shape_msgs/SolidPrimitive[] primitives, geometry_msgs/Pose[] primitive_poses, shape_msgs/Mesh[] meshes,"
        " geometry_msgs/Pose[] mesh_poses, shape_msgs/Plane[] planes, geometry_msgs/Pose[] plane_poses,"
        " string[] subframe_names, geometry_msgs/Pose[] subframe_poses, byte operation"
    ),
    "moveit_msgs/Constraints": (
        "string name, JointConstraint[] joint_constraints, PositionConstraint[] position_constraints,"
        " OrientationConstraint[] orientation_constraints, VisibilityConstraint[] visibility_constraints"
    ),
    "moveit_msgs/ConstraintEvalResult": "bool result, float64 distance",
    "moveit_msgs/ContactInformation": (
        "std_msgs/Header header, geometry_msgs/Point position, geometry_msgs/Vector3 normal, float64 depth,"
        " string contact_body_1, uint32 body_type_1, string contact_body_2, uint32 body_type_2"
    ),
    "moveit_msgs/CostSource": "float64 cost_density, geometry_msgs/Vector3 aabb_min, geometry_msgs/Vector3 aabb_max",
    "moveit_msgs/DisplayTrajectory": ("string model_id, RobotTrajectory[] trajectory, RobotState trajectory_start"),
    "moveit_msgs/GenericTrajectory": (
        "std_msgs/Header header, trajectory_msgs/JointTrajectory[] joint_trajectory,"
        " CartesianTrajectory[] cartesian_trajectory"
    ),
    "moveit_msgs/JointConstraint": (
        "string joint_name, float64 position, float64 tolerance_above, float64 tolerance_below, float64 weight"
    ),
    "moveit_msgs/LinkPadding": "string link_name, float64 padding",
    "moveit_msgs/LinkScale": "string link_name, float64 scale",
    "moveit_msgs/MotionPlanRequest": (
        "WorkspaceParameters workspace_parameters, RobotState start_state, Constraints[] goal_constraints,"
        " Constraints path_constraints, TrajectoryConstraints trajectory_constraints,"
        " GenericTrajectory[] reference_trajectories, string pipeline_id, string planner_id, string group_name,"
        " int32 num_planning_attempts, float64 allowed_planning_time, float64 max_velocity_scaling_factor,"
        " float64 max_acceleration_scaling_factor, string cartesian_speed_limited_link, float64 max_cartesian_speed"
    ),
    "moveit_msgs/MotionPlanResponse": (
        "RobotState trajectory_start, string group_name, RobotTrajectory trajectory, float64 planning_time,"
        " MoveItErrorCodes error_code"
    ),
    "moveit_msgs/MoveItErrorCodes": "int32 val, string message, string source",
    "moveit_msgs/ObjectColor": "string id, std_msgs/ColorRGBA color",
    "moveit_msgs/OrientationConstraint": (
        "std_msgs/Header header, geometry_msgs/Quaternion orientation, string link_name,"
        " float64 absolute_x_axis_tolerance, float64 absolute_y_axis_tolerance, float64 absolute_z_axis_tolerance,"
        " uint8 parameterization, float64 weight"
    ),
    "moveit_msgs/PlanningScene": (
        "string name, RobotState robot_state, string robot_model_name,"
        " geometry_msgs/TransformStamped[] fixed_frame_transforms, AllowedCollisionMatrix allowed_collision_matrix,"
        " LinkPadding[] link_padding, LinkScale[] link_scale, ObjectColor[] object_colors, PlanningSceneWorld world,"
        " bool is_diff"
    ),
    "moveit_msgs/PlanningSceneComponents": "uint32 components",
    "moveit_msgs/PlanningSceneWorld": ("CollisionObject[] collision_objects, octomap_msgs/OctomapWithPose octomap"),
    "moveit_msgs/PositionConstraint": (
        "std_msgs/Header header, string link_name, geometry_msgs/Vector3 target_point_offset,"
        " BoundingVolume constraint_region, float64 weight"
    ),
    "moveit_msgs/PositionIKRequest": (
        "string group_name, RobotState robot_state, Constraints constraints, bool avoid_collisions,"
        " string ik_link_name, geometry_msgs/PoseStamped pose_stamped, string[] ik_link_names,"
        " geometry_msgs/PoseStamped[] pose_stamped_vector, builtin_interfaces/Duration timeout"
    ),
    "moveit_msgs/RobotState": (
        "sensor_msgs/JointState joint_state, sensor_msgs/MultiDOFJointState multi_dof_joint_state,"
        " AttachedCollisionObject[] attached_collision_objects, bool is_diff"
    ),
    "moveit_msgs/RobotTrajectory": (
        "trajectory_msgs/JointTrajectory joint_trajectory,"
        " trajectory_msgs/MultiDOFJointTrajectory multi_dof_joint_trajectory"
    ),
    "moveit_msgs/TrajectoryConstraints": "Constraints[] constraints",
    "moveit_msgs/VisibilityConstraint": (
        "float64 target_radius, geometry_msgs/PoseStamped target_pose, int32 cone_sides,"
        " geometry_msgs/PoseStamped sensor_pose, float64 max_view_angle, float64 max_range_angle,"
        " uint8 sensor_view_direction, float64 weight"
    ),
    "moveit_msgs/WorkspaceParameters": (
        "std_msgs/Header header, geometry_msgs/Vector3 min_corner, geometry_msgs/Vector3 max_corner"
    ),
}
"""Fields of each message, in order."""

SERVICES: dict[str, tuple[str, str]] = {
    "moveit_msgs/GetMotionPlan": (
        "MotionPlanRequest motion_plan_request",
        "MotionPlanResponse motion_plan_response",
    ),
    "moveit_msgs/GetPositionIK": (
        "PositionIKRequest ik_request",
        "RobotState solution, MoveItErrorCodes error_code",
    ),
    "moveit_msgs/GetPositionFK": (
        "std_msgs/Header header, string[] fk_link_names, RobotState robot_state",
        "geometry_msgs/PoseStamped[] pose_stamped, string[] fk_link_names, MoveItErrorCodes error_code",
    ),
    "moveit_msgs/GetStateValidity": (
        "RobotState robot_state, string group_name, Constraints constraints",
        "bool valid, ContactInformation[] contacts, CostSource[] cost_sources,"
        " ConstraintEvalResult[] constraint_result",
    ),
    "moveit_msgs/ApplyPlanningScene": ("PlanningScene scene", "bool success"),
    "moveit_msgs/GetPlanningScene": ("PlanningSceneComponents components", "PlanningScene scene"),
}
"""Fields of each service's request and response, in order."""


@functools.cache
def types_of(distribution: Distribution) -> Types:
    """The types of a distribution; each has a table, and at present all tables are the same."""
    return Types(*_TABLES[distribution])


_TABLES = {
    Distribution.JAZZY: (MESSAGES, SERVICES),
    Distribution.KILTED: (MESSAGES, SERVICES),
    Distribution.ROLLING: (MESSAGES, SERVICES),
}


_log = logging.getLogger(__name__)


def ros_node(settings: RosSettings, session: zenoh.Session, model: RobotModel, ask: Ask) -> RosNode:
    """A node on a session, that isn't offered yet.

    Args:
        settings: How it is offered.
        session: An open session.
        model: The robot that is offered.
        ask: Has requests of ours answered.

    Raises:
        RobotInvalid: if the robot can't be offered over ROS.
    """
    robot = KnownRobot(settings.robot, model)
    known = KnownScene(Snapshot(robot))
    return RosNode(
        session, settings.domain, types_of(settings.distribution), known, EngineDoor(ask), _description(model)
    )


@contextlib.contextmanager
def session_for(settings: RosSettings, own: zenoh.Session) -> Iterator[zenoh.Session]:
    """The session in which nodes are met: the service's own, or one that is a router's client.

    Raises:
        zenoh.ZError: if the router can't be reached.
    """
    if settings.connect is None:
        yield own
        return
    config = zenoh.Config()
    for key, value in UNLESS_TOLD.items():
        config.insert_json5(key, value)
    config.insert_json5(*LATCHING)
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([settings.connect]))
    with zenoh.open(config) as session:
        yield session


def _description(model: RobotModel) -> str | None:
    """The robot's URDF as its file has it; of one that a client stored the text names files of this machine."""
    if model.source.urdf_path is None:
        _log.warning("robot %s was stored by a client: /robot_description isn't published", model.name)
        return None
    return read_xml(model.source.urdf_path)
