"""A ROS 2 node that asks guidefield for a plan, as it would ask MoveIt: nothing of guidefield is in it.

    export RMW_IMPLEMENTATION=rmw_zenoh_cpp
    python ros2_client.py

The service runs with `guidefield serve --ros`; ros2_stand_in.py asks the same without ROS. This file needs rclpy and
moveit_msgs of Jazzy, Kilted or Rolling.
"""

import rclpy
from moveit_msgs.msg import Constraints, JointConstraint, MoveItErrorCodes
from moveit_msgs.srv import GetMotionPlan
from rclpy.node import Node

GOAL = {
    "panda_joint1": 0.8, "panda_joint2": 0.2, "panda_joint3": 0.0, "panda_joint4": -1.8, "panda_joint5": 0.0,
    "panda_joint6": 2.0, "panda_joint7": 0.8,
}  # fmt: skip


def main():
    """Ask for a plan, and print it."""
    rclpy.init()
    node = Node("asks_for_a_plan")
    client = node.create_client(GetMotionPlan, "plan_kinematic_path")
    client.wait_for_service()
    request = GetMotionPlan.Request()
    asked = request.motion_plan_request
    asked.group_name = "arm"
    asked.allowed_planning_time = 30.0
    asked.start_state.is_diff = True  # from where /joint_states says that the robot is
    joints = [
        JointConstraint(joint_name=name, position=value, tolerance_above=1e-3, tolerance_below=1e-3, weight=1.0)
        for name, value in GOAL.items()
    ]
    asked.goal_constraints.append(Constraints(joint_constraints=joints))
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future)
    response = future.result().motion_plan_response
    print(f"{response.error_code.val}: {response.error_code.message}")
    if response.error_code.val == MoveItErrorCodes.SUCCESS:
        motion = response.trajectory.joint_trajectory
        end = motion.points[-1]
        print(f"{len(motion.points)} points, {end.time_from_start.sec + 1e-9 * end.time_from_start.nanosec:.2f} s")
        print(f"ends at {dict(zip(motion.joint_names, end.positions, strict=True))}")
    rclpy.shutdown()


if __name__ == "__main__":
    main()
