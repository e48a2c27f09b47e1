"""Messages that tests send, and where they are known."""

from collections.abc import Sequence
from typing import Any

from guidefield.endpoint.ros.snapshot import KnownRobot, Snapshot
from tests.endpoint.ros.peer import new
from tests.robots import robot

ARM = [f"panda_joint{number}" for number in range(1, 8)]
BENT = dict(zip(ARM, (0.1, -0.6, 0.2, -2.2, 0.1, 1.7, 0.8), strict=True))


def snapshot() -> Snapshot:
    """A Panda whose joints were heard, with nothing around it."""
    return Snapshot(KnownRobot("panda", robot("panda")), {**BENT, "panda_finger_joint1": 0.02})


def header(frame: str = "") -> Any:
    return new("std_msgs/msg/Header", frame_id=frame)


def offset(x: float, y: float, z: float) -> Any:
    return new("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def point(x: float, y: float, z: float) -> Any:
    return new("geometry_msgs/msg/Point", x=x, y=y, z=z)


def pose(x: float, y: float, z: float, quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)) -> Any:
    return new("geometry_msgs/msg/Pose", position=point(x, y, z), orientation=turned(*quaternion))


def turned(x: float, y: float, z: float, w: float) -> Any:
    return new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def primitive(kind: int, *sizes: float) -> Any:
    return new("shape_msgs/msg/SolidPrimitive", type=kind, dimensions=sizes)


def joint(name: str, position: float, above: float = 1e-3, below: float = 1e-3) -> Any:
    return new(
        "moveit_msgs/msg/JointConstraint",
        joint_name=name,
        position=position,
        tolerance_above=above,
        tolerance_below=below,
        weight=1.0,
    )


def position(link: str, shape: Any, at: Any, frame: str = "", **others: Any) -> Any:
    return within(link, [shape], [at], frame, **others)


def within(link: str, shapes: list[Any], poses: list[Any], frame: str = "", **others: Any) -> Any:
    """Within any one of several regions."""
    region = new("moveit_msgs/msg/BoundingVolume", primitives=shapes, primitive_poses=poses)
    return new(
        "moveit_msgs/msg/PositionConstraint", header=header(frame), link_name=link, constraint_region=region, **others
    )


def orientation(
    link: str, wanted: Any, tolerances: tuple[float, float, float], kind: int = 0, frame: str = "", **others: Any
) -> Any:
    x, y, z = tolerances
    return new(
        "moveit_msgs/msg/OrientationConstraint",
        header=header(frame),
        link_name=link,
        orientation=wanted,
        absolute_x_axis_tolerance=x,
        absolute_y_axis_tolerance=y,
        absolute_z_axis_tolerance=z,
        parameterization=kind,
        **others,
    )


def constraints(joints: Any = (), positions: Any = (), orientations: Any = (), views: Any = ()) -> Any:
    return new(
        "moveit_msgs/msg/Constraints",
        joint_constraints=list(joints),
        position_constraints=list(positions),
        orientation_constraints=list(orientations),
        visibility_constraints=list(views),
    )


def plan_request(**fields: Any) -> Any:
    given = {"group_name": "arm", "goal_constraints": [constraints([joint("panda_joint1", 0.3)])], **fields}
    request = new("moveit_msgs/msg/MotionPlanRequest", **given)
    return new("moveit_msgs/srv/GetMotionPlan_Request", motion_plan_request=request)


def thing(name: str, shapes: Any = (), poses: Any = (), operation: int = 0, frame: str = "", **others: Any) -> Any:
    return new(
        "moveit_msgs/msg/CollisionObject",
        header=header(frame),
        id=name,
        primitives=list(shapes),
        primitive_poses=list(poses),
        operation=operation,
        **others,
    )


def held(link: str, what: Any, *touched: str) -> Any:
    return new("moveit_msgs/msg/AttachedCollisionObject", link_name=link, object=what, touch_links=list(touched))


def scene(*things: Any, diff: bool = True, **fields: Any) -> Any:
    world = new("moveit_msgs/msg/PlanningSceneWorld", collision_objects=list(things))
    return new("moveit_msgs/msg/PlanningScene", world=world, is_diff=diff, **fields)


def state(
    positions: dict[str, float] | None = None,
    *,
    attached: Any = (),
    diff: bool = True,
    velocities: Sequence[float] = (),
) -> Any:
    given = positions or {}
    values, rates = list(given.values()), list(velocities)
    joints = new("sensor_msgs/msg/JointState", name=list(given), position=values, velocity=rates)
    return new(
        "moveit_msgs/msg/RobotState", joint_state=joints, attached_collision_objects=list(attached), is_diff=diff
    )
