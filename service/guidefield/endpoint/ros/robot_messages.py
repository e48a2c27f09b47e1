"""States, trajectories and error codes as messages of ROS."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

from guidefield.endpoint.ros.cdr import Types
from guidefield.endpoint.ros.collision_objects import message_of
from guidefield.endpoint.ros.refusals import SOURCE, MoveItCode
from guidefield.endpoint.ros.snapshot import Snapshot
from guidefield.messages.plan_reply import Trajectory

NANO = 1_000_000_000


def header(types: Types, frame: str) -> Any:
    """A header of now."""
    seconds, nanoseconds = divmod(time.time_ns(), NANO)
    stamp = types.new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return types.new("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def error_code(types: Types, code: MoveItCode, message: str) -> Any:
    """An error code with its sentence."""
    return types.new("moveit_msgs/msg/MoveItErrorCodes", val=int(code), message=message, source=SOURCE)


def robot_state(
    types: Types, snapshot: Snapshot, changed: Mapping[str, float] | None = None, *, held: bool = True
) -> Any:
    """Every joint's value, followers' too, and what is held; some joints changed."""
    positions = {**snapshot.whole, **(changed or {})}
    followed = {
        name: one.mimic.multiplier * positions[one.mimic.driver] + one.mimic.offset
        for name, one in snapshot.robot.followers.items()
        if one.mimic is not None
    }
    values = {**positions, **followed}
    joints = types.new(
        "sensor_msgs/msg/JointState",
        header=header(types, snapshot.robot.root),
        name=list(values),
        position=list(values.values()),
    )
    return types.new(
        "moveit_msgs/msg/RobotState",
        joint_state=joints,
        attached_collision_objects=_held(types, snapshot) if held else [],
    )


def _held(types: Types, snapshot: Snapshot) -> list[Any]:
    return [
        types.new(
            "moveit_msgs/msg/AttachedCollisionObject",
            link_name=one.link,
            object=message_of(types, name, one.thing, one.link),
            touch_links=list(one.touch_links),
        )
        for name, one in snapshot.held.items()
    ]


def robot_trajectory(types: Types, snapshot: Snapshot, names: list[str], curve: Trajectory) -> Any:
    """The certified curve at its knots: positions and velocities.

    No accelerations: a controller that has positions and velocities alone draws the cubic Hermite curve between them,
    which is the one that was certified.
    """
    points = [
        types.new(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=row,
            velocities=rates,
            time_from_start=duration(types, at),
        )
        for at, row, rates in zip(curve.times, curve.positions, curve.velocities, strict=True)
    ]
    motion = types.new("trajectory_msgs/msg/JointTrajectory", joint_names=names, points=points)
    motion.header.frame_id = snapshot.robot.root
    return types.new("moveit_msgs/msg/RobotTrajectory", joint_trajectory=motion)


def duration(types: Types, seconds: float) -> Any:
    """A duration of so many seconds, to the nanosecond."""
    whole = math.floor(seconds)
    nanoseconds = round((seconds - whole) * NANO)
    carry, nanoseconds = divmod(nanoseconds, NANO)
    return types.new("builtin_interfaces/msg/Duration", sec=whole + carry, nanosec=nanoseconds)
