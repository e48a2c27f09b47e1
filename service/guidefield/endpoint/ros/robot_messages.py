"""States, trajectories and error codes as messages of ROS."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

from guidefield.endpoint.ros.collision_objects import message_of
from guidefield.endpoint.ros.refusals import SOURCE, MoveItCode
from guidefield.endpoint.ros.snapshot import Snapshot
from guidefield.messages.plan_reply import Trajectory

NANO = 1_000_000_000


def header(frame: str) -> dict[str, Any]:
    """Return a header of now."""
    seconds, nanoseconds = divmod(time.time_ns(), NANO)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame}


def error_code(code: MoveItCode, message: str) -> dict[str, Any]:
    """Return an error code with its sentence."""
    return {"val": int(code), "message": message, "source": SOURCE}


def robot_state(snapshot: Snapshot, changed: Mapping[str, float] | None = None, *, held: bool = True) -> dict[str, Any]:
    """Return the state with every joint's value, mimic joints' too, and the held objects; some joints changed."""
    values = {**snapshot.whole, **(changed or {})}
    for name, one in snapshot.robot.followers.items():
        assert one.mimic is not None, "it follows another joint"
        values[name] = one.mimic.multiplier * values[one.mimic.driver] + one.mimic.offset
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
