"""Make states, trajectories and error codes as messages of ROS; read joint states from bags.

Trajectories have no accelerations, and must have none: with them a controller would draw another curve than the
certified one.
"""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag1 import ReaderError as Bag1Error
from rosbags.rosbag2 import ReaderError as Bag2Error

from guidefield.endpoint.ros.collision_objects import message_of
from guidefield.endpoint.ros.refusals import SOURCE
from guidefield.endpoint.ros.snapshot import Snapshot
from guidefield.errors import MalformedRequest, UnknownObject
from guidefield.messages.certify_reply import JointStates
from guidefield.messages.plan_reply import Trajectory

NANO = 1_000_000_000


def header(frame: str) -> dict[str, Any]:
    """Return a header of now."""
    seconds, nanoseconds = divmod(time.time_ns(), NANO)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame}


def error_code(code: int, message: str) -> dict[str, Any]:
    """Return an error code with its sentence."""
    return {"val": int(code), "message": message, "source": SOURCE}


def robot_state(snapshot: Snapshot, changed: Mapping[str, float] | None = None, *, held: bool = True) -> dict[str, Any]:
    """Return the state with every joint's value, mimic joints' too, and the held objects; some joints changed."""
    values = {**snapshot.whole, **(changed or {})}
    for name, one in snapshot.robot.mimics.items():
        assert one.mimic is not None, "it follows another joint"
        values[name] = one.mimic.multiplier * values[one.mimic.source] + one.mimic.offset
    joints = {"header": header(snapshot.robot.root), "name": list(values), "position": list(values.values())}
    attached = [
        {"link_name": one.link, "object": message_of(name, one.thing, one.link), "touch_links": list(one.touch_links)}
        for name, one in snapshot.held.items()
    ]
    return {"joint_state": joints, "attached_collision_objects": attached if held else []}


def robot_trajectory(snapshot: Snapshot, names: list[str], curve: Trajectory) -> dict[str, Any]:
    """Return the certified curve at its knots: positions and velocities.

    No accelerations: a controller that has positions and velocities alone draws the cubic Hermite curve between them,
    which is the one that was certified.
    """
    points = [
        {"positions": row, "velocities": rates, "time_from_start": duration(at)}
        for at, row, rates in zip(curve.times, curve.positions, curve.velocities, strict=True)
    ]
    motion = {"header": {"frame_id": snapshot.robot.root}, "joint_names": names, "points": points}
    return {"joint_trajectory": motion}


def duration(seconds: float) -> dict[str, int]:
    """Return a duration [s] to the nanosecond."""
    whole = math.floor(seconds)
    carry, nanoseconds = divmod(round((seconds - whole) * NANO), NANO)
    return {"sec": whole + carry, "nanosec": nanoseconds}


JOINT_STATES = "sensor_msgs/msg/JointState"


def read_bag(path: Path, topic: str, joints: Sequence[str]) -> JointStates:
    """Read joints' positions from a bag of ROS 1 or 2: of each message that has all of them, at its header's time.

    Raises:
        UnknownObject: if there is no such bag.
        MalformedRequest: if it is none, or has no joint states on the topic, or none of a joint.
    """
    if not path.exists():
        raise UnknownObject(f"there is no bag {str(path)!r}", path=str(path))
    times, positions, seen = list[float](), list[list[float]](), dict[str, None]()
    try:
        with AnyReader([path]) as reader:
            found = [one for one in reader.connections if one.topic == topic and one.msgtype == JOINT_STATES]
            if not found:
                topics = sorted({one.topic for one in reader.connections if one.msgtype == JOINT_STATES})
                raise MalformedRequest(
                    f"bag {path.name!r} has no joint states on {topic!r}; on: {', '.join(topics) or 'no topic'}",
                    available=topics,
                )
            for connection, stamp, data in reader.messages(found):
                message: Any = reader.deserialize(data, connection.msgtype)
                seen |= dict.fromkeys(message.name)
                named = dict(zip(message.name, message.position.tolist(), strict=False))  # without positions: none
                if not all(joint in named for joint in joints):
                    continue
                at = message.header.stamp.sec * NANO + message.header.stamp.nanosec
                times.append((at or stamp) / NANO)  # a header without a time: when the bag recorded it
                positions.append([named[joint] for joint in joints])
    except (AnyReaderError, Bag1Error, Bag2Error, OSError, ValueError, OverflowError, struct.error) as error:
        raise MalformedRequest(f"{path.name!r} is no bag that can be read: {error}", path=str(path)) from None
    if not times:
        lacking = next((joint for joint in joints if joint not in seen), None)
        why = f"there is no joint {lacking!r} in them" if lacking else "no message has all joints of the plan"
        raise MalformedRequest(
            f"bag {path.name!r}: {why}; the joint states have {', '.join(seen) or 'no joint'}", available=[*seen]
        )
    return JointStates(joints, times, positions)
