"""The request of ros2_client.py over plain Zenoh, without ROS: a stand-in for a node, for those who have none at hand.

    pip install 'guidefield[ros]'
    guidefield serve --ros
    python ros2_stand_in.py tcp/127.0.0.1:7447

1. A service of ROS is a queryable; its key is made of domain, name, type and type hash. Whether it is there is told by
   its liveliness token, below `@ros2_lv`.
2. A request is CDR. Its attachment is the request's number, the time in ns, and 16 bytes that stand for the client.
3. The response is CDR too, and its attachment has the same number and client.
"""

import json
import struct
import sys
import time
import uuid

import zenoh

from guidefield.endpoint.link import Distribution
from guidefield.endpoint.ros.rmw_zenoh import Entity, Kind, types_of

ENDPOINT = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
GOAL = {
    "panda_joint1": 0.8, "panda_joint2": 0.2, "panda_joint3": 0.0, "panda_joint4": -1.8, "panda_joint5": 0.0,
    "panda_joint6": 2.0, "panda_joint7": 0.8,
}  # fmt: skip
SERVICE, DOMAIN, WAIT = "moveit_msgs/srv/GetMotionPlan", 0, 60.0


def request(types):
    """The request of ros2_client.py, as CDR."""
    joints = [
        types.new(
            "moveit_msgs/msg/JointConstraint",
            joint_name=name,
            position=value,
            tolerance_above=1e-3,
            tolerance_below=1e-3,
            weight=1.0,
        )
        for name, value in GOAL.items()
    ]
    asked = types.new(
        "moveit_msgs/msg/MotionPlanRequest",
        group_name="arm",
        allowed_planning_time=30.0,
        start_state=types.new("moveit_msgs/msg/RobotState", is_diff=True),
        goal_constraints=[types.new("moveit_msgs/msg/Constraints", joint_constraints=joints)],
    )
    return types.write(types.new(f"{SERVICE}_Request", motion_plan_request=asked), f"{SERVICE}_Request")


def main():
    """Ask for a plan, and print it."""
    types = types_of(Distribution.JAZZY)
    key = Entity(Kind.SERVICE, "plan_kinematic_path", SERVICE, types.type_hash(SERVICE)).key(DOMAIN)
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([ENDPOINT]))
    with zenoh.open(config) as session:
        client = uuid.uuid4().bytes
        attachment = struct.pack("<qqB", 1, time.time_ns(), len(client)) + client
        (reply,) = session.get(
            key,
            payload=request(types),
            attachment=attachment,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            timeout=WAIT,
        )
        if reply.ok is None:
            sys.exit(f"an error: {reply.err.payload.to_string()}")
        echoed = reply.ok.attachment.to_bytes()
        assert (echoed[:8], echoed[17:]) == (attachment[:8], client), "the response is to another request"
        response = types.read(reply.ok.payload.to_bytes(), f"{SERVICE}_Response").motion_plan_response
    print(f"{response.error_code.val}: {response.error_code.message}")
    motion = response.trajectory.joint_trajectory
    if motion.points:
        end = motion.points[-1]
        print(f"{len(motion.points)} points, {end.time_from_start.sec + 1e-9 * end.time_from_start.nanosec:.2f} s")
        print(f"ends at {dict(zip(motion.joint_names, end.positions.tolist(), strict=True))}")


if __name__ == "__main__":
    main()
