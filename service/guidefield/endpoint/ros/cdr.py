"""Messages to bytes and back (CDR), and the hashes of their types (RIHS01), by the library rosbags.

A message is an object with the fields of its type: numbers, texts, other messages, lists of them, and NumPy arrays
where a field has many numbers. Types are named as ROS does: ``std_msgs/msg/String``,
``moveit_msgs/srv/GetMotionPlan_Request``.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from guidefield.endpoint.ros.options import Distribution

MOST_BYTES = 8 * 2**20
"""Largest payload that is looked at: as objects it takes tens of times as much."""
MOST_ENTRIES = 2_000_000
"""Most entries of one sequence that are looked at."""

_NUMBERS = {
    "bool": np.bool_, "byte": np.uint8, "int8": np.int8, "uint8": np.uint8, "int16": np.int16, "uint16": np.uint16,
    "int32": np.int32, "uint32": np.uint32, "int64": np.int64, "uint64": np.uint64, "float32": np.float32,
    "float64": np.float64,
}  # fmt: skip
PACKAGES = ("builtin_interfaces", "std_msgs", "geometry_msgs", "sensor_msgs", "trajectory_msgs", "shape_msgs")
"""Packages whose messages are as rosbags has them."""
_UNLIKE_ZERO = {("geometry_msgs/msg/Quaternion", "w"): 1.0}
"""Fields whose value is not zero where nobody gives one."""


class Unreadable(ValueError):
    """A payload is no message of its type; says why."""


class Types:
    """The types of a distribution, with what reads and writes them.

    Args:
        known: Those that rosbags has of it; `PACKAGES` of them are taken.
        messages: Fields of each other message, by its package and name.
        services: Fields of each service's request and response.
    """

    def __init__(self, known: Stores, messages: Mapping[str, str], services: Mapping[str, tuple[str, str]]) -> None:
        self._store = get_typestore(Stores.EMPTY)
        self._store.max_sequence_length = MOST_ENTRIES
        theirs = get_typestore(known).fielddefs
        definitions = {name: fields for name, fields in theirs.items() if name.partition("/")[0] in PACKAGES}
        for name, fields in messages.items():
            definitions |= _parsed(name.replace("/", "/msg/"), fields)
        for name, (request, response) in services.items():
            definitions |= _service(name.replace("/", "/srv/"), request, response)
        self._store.register(definitions)
        self._made: dict[str, dict[str, _Field]] = {}

    @property
    def names(self) -> list[str]:
        """Every type, those of which a service is made too."""
        return list(self._store.fielddefs)

    def fields(self, name: str) -> list[tuple[str, Any]]:
        """The fields of a type in order, each with rosbags' description of what it holds."""
        return list(self._store.fielddefs[name][1])

    def type_hash(self, name: str) -> str:
        """The hash by which nodes tell versions of a type, ``RIHS01_`` and 64 digits."""
        return self._store.hash_rihs01(name)

    def new(self, name: str, /, **given: Any) -> Any:
        """A message with some of its fields; all others are zero, empty or false, and a quaternion the identity.

        A message within it may be given as a dict of its fields.
        """
        fields = self._fields_of(name)
        if unknown := given.keys() - fields.keys():
            raise TypeError(f"{name} has no field {', '.join(sorted(unknown))}")
        values = [one.fitting(given[field]) if field in given else one.blank() for field, one in fields.items()]
        return self._store.types[name](*values)

    def read(self, payload: bytes, name: str) -> Any:
        """The message that a payload holds.

        Raises Unreadable if it holds none of that type, or is longer than `MOST_BYTES`.
        """
        if len(payload) > MOST_BYTES:
            raise Unreadable(f"the payload has {len(payload)} bytes, at most {MOST_BYTES} are read")
        try:
            return self._store.deserialize_cdr(payload, name)
        except Exception as error:  # whatever a library raises at bytes that anybody may send
            raise Unreadable(f"the payload is no {name}: {error}") from None

    def write(self, message: Any, name: str) -> bytes:
        """The bytes of a message, with their header, little-endian."""
        return bytes(self._store.serialize_cdr(message, name, little_endian=True))

    def _fields_of(self, name: str) -> dict[str, _Field]:
        """The fields of a type by name, in their order, found once."""
        if name not in self._made:
            self._made[name] = {field: self._field(name, field, kind) for field, kind in self.fields(name)}
        return self._made[name]

    def _field(self, name: str, field: str, kind: Any) -> _Field:
        node, inner = kind
        if node == Nodetype.NAME:
            return _Field(functools.partial(self.new, inner), functools.partial(self._made_of, inner))
        if node == Nodetype.BASE:
            zero = "" if inner[0] == "string" else _NUMBERS[inner[0]]().item()
            value = _UNLIKE_ZERO.get((name, field), zero)
            return _Field(lambda: value, _as_it_is)
        element, count = inner
        if element[0] == Nodetype.BASE and element[1][0] != "string":
            numbers = _NUMBERS[element[1][0]]
            most = count if node == Nodetype.ARRAY else 0
            return _Field(lambda: np.zeros(most, numbers), lambda value: np.asarray(value, numbers))
        if element[0] == Nodetype.NAME:
            return _Field(list, lambda values: [self._made_of(element[1], value) for value in values])
        return _Field(list, _as_it_is)

    def _made_of(self, name: str, value: Any) -> Any:
        return self.new(name, **value) if isinstance(value, dict) else value


@dataclass(frozen=True)
class _Field:
    """What a field of a message has where nobody gives a value, and a value as it holds it."""

    blank: Callable[[], Any]
    fitting: Callable[[Any], Any]


def _as_it_is(value: Any) -> Any:
    return value


def _parsed(name: str, fields: str) -> dict[str, Any]:
    package, _, own = name.split("/")
    lines = "\n".join(field.strip() for field in fields.split(","))
    (definition,) = get_types_from_msg(lines, f"{package}/msg/{own}").values()
    return {name: definition}


def _service(name: str, request: str, response: str) -> dict[str, Any]:
    """A service as a type hash sees it: its request, its response, and the event that tells of either."""

    def one(of: str) -> tuple[Nodetype, str]:
        return Nodetype.NAME, of

    def at_most_one(of: str) -> tuple[Nodetype, Any]:
        return Nodetype.SEQUENCE, (one(of), 1)

    asked, answered, event = f"{name}_Request", f"{name}_Response", f"{name}_Event"
    return {
        **_parsed(asked, request),
        **_parsed(answered, response),
        event: (
            [],
            [
                ("info", one("service_msgs/msg/ServiceEventInfo")),
                ("request", at_most_one(asked)),
                ("response", at_most_one(answered)),
            ],
        ),
        name: (
            [],
            [("request_message", one(asked)), ("response_message", one(answered)), ("event_message", one(event))],
        ),
    }


MESSAGES: dict[str, str] = {
    "service_msgs/ServiceEventInfo": (
        "uint8 event_type, builtin_interfaces/Time stamp, uint8[16] client_gid, int64 sequence_number"
    ),
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
"""Fields in order of each message that rosbags doesn't have, or has otherwise."""
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
    """The types of a distribution."""
    return Types(STORES[distribution], MESSAGES, SERVICES)


STORES = {
    Distribution.JAZZY: Stores.ROS2_JAZZY,
    Distribution.KILTED: Stores.ROS2_KILTED,
    Distribution.ROLLING: Stores.ROS2_LYRICAL,
}
"""Tables of each distribution that rosbags has; Rolling is between two of them."""
