"""Plans over ROS: what a request becomes, and what a reply does."""

import dataclasses
import math
from typing import Any

import pytest

from guidefield.endpoint.ros.motion_plan import (
    RequestedPlan,
    plan_response,
    read_plan_request,
    request_solutions,
    with_solutions,
)
from guidefield.endpoint.ros.refusals import Refused, moveit_code
from guidefield.endpoint.ros.robot_messages import duration
from guidefield.endpoint.ros.snapshot import Snapshot, apply_scene
from guidefield.errors import Status
from guidefield.messages import codec
from guidefield.messages.codec import Encoding
from guidefield.messages.kinematics import InverseKinematicsReply
from guidefield.messages.plan_reply import (
    CertificateFigures,
    ClearanceFigures,
    Counters,
    Outcome,
    PlanReply,
    Timing,
    Trajectory,
)
from guidefield.messages.requests import JointsGoal, PlanRequest
from guidefield.messages.values import JointSetGoal
from tests.endpoint.ros.messages import (
    ARM,
    BENT,
    constraints,
    held,
    joint,
    orientation,
    plan_request,
    pose,
    primitive,
    scene,
    snapshot,
    state,
    thing,
    turned,
    within,
)
from tests.endpoint.ros.peer import TYPES, new

START = snapshot()
TIP = "panda_hand_tcp"
BALL = 2


def asked(**fields: Any) -> PlanRequest:
    return read_plan_request(plan_request(**fields), START).request


def reply(code: Status = Status.SUCCESS, **fields: Any) -> PlanReply:
    rows = [[0.1 * i for i in range(7)], [0.2 * i for i in range(7)]]
    given: dict[str, Any] = {
        "run_id": "r1",
        "status": Outcome(code=code, name=code.name, message="so it is"),
        "position_names": ARM,
        "velocity_names": ARM,
        "path": rows,
        "trajectory": Trajectory(times=[0.0, 1.25], positions=rows, velocities=rows, accelerations=rows),
        "guide_planes": [],
        "stages": [],
        "clearance": ClearanceFigures(minimum=0.0312, mean=None, inner=None, ends=None, pair=["a", "b"], time=0.5),
        "self_clearance": None,
        "certificate": CertificateFigures(collision_free=True, method="m", covers="trajectory", evaluations=3),
        "metrics": None,
        "timing": Timing(),
        "counters": Counters(),
        "seed": 0,
        "planner": "auto",
        "recording": None,
    }
    return PlanReply(**{**given, **fields})


class TestChoices:
    """Several goals of which some are poses."""

    def several(self) -> RequestedPlan:
        shapes, poses = [primitive(BALL, 0.01)] * 2, [pose(0.5, 0.0, 0.4), pose(3.0, 0.0, 0.4)]
        goals = [constraints(positions=[within(TIP, shapes, poses)]), constraints([joint("panda_joint1", 0.3)])]
        return read_plan_request(plan_request(goal_constraints=goals, allowed_planning_time=3.0), START)

    def test_configurations_are_looked_for_at_each_pose(self):
        asked = self.several()
        (looked_for,) = request_solutions(asked)
        assert [one.position for one in looked_for.poses] == [(0.5, 0.0, 0.4), (3.0, 0.0, 0.4)]
        assert looked_for.poses[0].orientation_tolerance == (None, None, None)
        assert (looked_for.tip, looked_for.group, looked_for.allowed_time) == (TIP, ARM, 3.0)
        assert looked_for.collision_free
        assert looked_for.start_configurations == [asked.request.start]

    def test_they_are_the_goal_and_so_are_the_joints_that_were_asked_for(self):
        found = InverseKinematicsReply(configurations=[[{"panda_joint1": 1.0}], []], reasons=["", "out of reach"])
        given = with_solutions(self.several(), [found])
        assert given.request.goal == JointSetGoal([{"panda_joint1": 0.3}, {"panda_joint1": 1.0}])
        assert given.request.tip is None
        assert given.notes[-1] == "of 3 goals 2 configurations were looked at"

    def test_where_there_is_none_the_reasons_are_told(self):
        asked = self.several()
        poses_alone = dataclasses.replace(asked, choices=asked.choices[:2])
        nothing = InverseKinematicsReply(configurations=[[], []], reasons=["out of reach", "out of reach"])
        with pytest.raises(Refused, match=r"none of the poses is reached: out of reach$") as refused:
            with_solutions(poses_alone, [nothing])
        assert refused.value.code == Status.NO_IK_SOLUTION


class TestRequests:
    def test_the_start_is_what_was_heard_changed_by_the_request(self):
        found = asked(start_state=state({"panda_joint3": 0.5}))
        assert found.start == {**START.whole, "panda_joint3": 0.5}
        assert found.goal == JointsGoal({"panda_joint1": 0.3})
        assert (found.group, found.guide_planes, found.robot) == (ARM, [], "panda")

    def test_joints_that_nobody_told_are_named(self):
        found = read_plan_request(plan_request(), Snapshot(START.robot, BENT))
        assert found.notes[0] == "neither /joint_states nor `start_state` tells panda_finger_joint1: taken at rest"

    def test_scene_held_things_and_who_may_touch_go_with_it(self):
        matrix = new(
            "moveit_msgs/msg/AllowedCollisionMatrix",
            entry_names=["crate", "rod"],
            entry_values=[new("moveit_msgs/msg/AllowedCollisionEntry", enabled=row) for row in ([0, 1], [1, 0])],
        )
        rod = held("panda_hand", thing("rod", [primitive(2, 0.02)], frame="panda_hand"))
        now = apply_scene(START, scene(thing("crate", [primitive(2, 0.1)]), allowed_collision_matrix=matrix))
        found = read_plan_request(plan_request(start_state=state(attached=[rod])), now).request
        assert [one.name for one in found.scene.obstacles] == ["crate"]
        assert [one.obstacle.name for one in found.attached_objects] == ["rod"]
        assert found.allowed_collisions == [("crate", "rod")]

    def test_it_travels(self):
        found = asked(
            path_constraints=constraints(orientations=[orientation("panda_hand", turned(0, 0, 0, 1), (1, 1, 4))])
        )
        again = codec.decode(codec.encode(found, Encoding.MSGPACK), PlanRequest, Encoding.MSGPACK)
        for field in ("start", "goal", "path_constraints", "group", "tip", "allowed_planning_time"):
            assert getattr(again, field) == getattr(found, field)
        assert again.scene.obstacles == found.scene.obstacles

    def test_factors_that_are_unset_mean_1_and_the_message_says_so(self):
        found = read_plan_request(plan_request(max_velocity_scaling_factor=0.25), START)
        assert (found.request.max_velocity_scaling_factor, found.request.max_acceleration_scaling_factor) == (0.25, 1.0)
        assert "`max_acceleration_scaling_factor` is unset and means 1" in found.notes

    def test_a_time_that_is_unset_means_a_second(self):
        assert asked().allowed_planning_time == 1.0
        assert asked(allowed_planning_time=2.5).allowed_planning_time == 2.5

    def test_the_speed_of_a_link_is_limited_or_of_the_tip(self):
        (limit,) = asked(max_cartesian_speed=0.2, cartesian_speed_limited_link="panda_link5").cartesian_limits
        assert (limit.frame, limit.speed) == ("panda_link5", 0.2)
        (limit,) = asked(max_cartesian_speed=0.2).cartesian_limits
        assert limit.frame == (asked().tip or "panda_hand_tcp")
        assert not asked(max_cartesian_speed=0.0, cartesian_speed_limited_link="nose").cartesian_limits

    def test_the_motion_begins_as_the_joints_move(self):
        moving = state(
            {"panda_joint1": 0.1, "panda_joint2": 0.2, "panda_finger_joint1": 0.0}, velocities=(0.3, 1e-4, 0)
        )
        assert asked(start_state=moving).start_velocities == {"panda_joint1": 0.3}
        assert asked(start_state=state({"panda_joint1": 0.1})).start_velocities == {}

    def test_what_is_not_used_is_told(self):
        found = read_plan_request(plan_request(pipeline_id="ompl", planner_id="RRT", num_planning_attempts=10), START)
        assert "`pipeline_id`, `planner_id`, `num_planning_attempts` not used" in found.notes

    @pytest.mark.parametrize(
        ("fields", "code", "field"),
        [
            ({"group_name": "nobody"}, Status.INVALID_GROUP_NAME, "`group_name`"),
            ({"group_name": ""}, Status.INVALID_GROUP_NAME, "`group_name`"),
            ({"goal_constraints": []}, Status.INVALID_GOAL_CONSTRAINTS, "`goal_constraints`"),
            ({"max_velocity_scaling_factor": -0.1}, Status.FAILURE, "`max_velocity_scaling_factor`"),
            ({"max_velocity_scaling_factor": 1.5}, Status.FAILURE, "`max_velocity_scaling_factor`"),
            ({"max_acceleration_scaling_factor": math.nan}, Status.FAILURE, "`max_acceleration_scaling_factor`"),
            ({"allowed_planning_time": math.nan}, Status.FAILURE, "`allowed_planning_time`"),
            ({"allowed_planning_time": 1e5}, Status.FAILURE, "`allowed_planning_time`"),
            ({"max_cartesian_speed": math.nan}, Status.FAILURE, "`max_cartesian_speed`"),
            (
                {"max_cartesian_speed": 0.1, "cartesian_speed_limited_link": "nose"},
                Status.INVALID_LINK_NAME,
                "`cartesian_speed_limited_link` 'nose' is no link of panda",
            ),
            (
                {"start_state": state({"panda_joint1": 0.1}, velocities=(0.1, 0.2))},
                Status.INVALID_ROBOT_STATE,
                "velocity` must have a value for each name, 1, or none, got 2",
            ),
            (
                {"start_state": state({"panda_joint1": 0.1}, velocities=(math.inf,))},
                Status.INVALID_ROBOT_STATE,
                "velocity of panda_joint1",
            ),
            (
                {"start_state": state({"panda_finger_joint1": 0.01}, velocities=(0.1,))},
                Status.INVALID_ROBOT_STATE,
                "panda_finger_joint1 moves at 0.1, and is no joint of the group",
            ),
            (
                {"trajectory_constraints": new("moveit_msgs/msg/TrajectoryConstraints", constraints=[constraints()])},
                Status.INVALID_GOAL_CONSTRAINTS,
                "`trajectory_constraints`",
            ),
        ],
    )
    def test_what_is_not_served_is_refused_by_name(self, fields: dict[str, Any], code: int, field: str):
        with pytest.raises(Refused, match=field) as refused:
            asked(**fields)
        assert refused.value.code == code

    def test_several_coordinates_are_refused(self):
        root = state()
        root.multi_dof_joint_state.joint_names = ["root_joint"]
        with pytest.raises(Refused, match=r"start_state\.multi_dof_joint_state"):
            asked(start_state=root)


class TestResponses:
    def answer(self, of: PlanReply) -> Any:
        found = plan_response(read_plan_request(plan_request(), START), of, 0.5)
        name = "moveit_msgs/srv/GetMotionPlan_Response"
        return TYPES.read(TYPES.write(TYPES.new(name, **found), name), name).motion_plan_response

    def test_a_plan_is_its_knots_without_accelerations(self):
        found = self.answer(reply())
        assert found.error_code.val == 1
        motion = found.trajectory.joint_trajectory
        assert motion.joint_names == ARM
        assert [one.positions.tolist() for one in motion.points] == reply().trajectory.positions
        assert [one.velocities.tolist() for one in motion.points] == reply().trajectory.velocities
        assert [len(one.accelerations) for one in motion.points] == [0, 0]
        assert (motion.points[1].time_from_start.sec, motion.points[1].time_from_start.nanosec) == (1, 250_000_000)
        told = dict(
            zip(found.trajectory_start.joint_state.name, found.trajectory_start.joint_state.position, strict=True)
        )
        assert told == {**START.whole, "panda_finger_joint2": 0.02}
        assert "clearance 0.0312 m (a and b); run r1" in found.error_code.message

    def test_a_failure_has_no_trajectory_and_our_own_name_in_the_message(self):
        found = self.answer(reply(Status.STUCK_IN_MINIMUM))
        assert (found.error_code.val, found.trajectory.joint_trajectory.points) == (Status.PLANNING_FAILED, [])
        assert found.error_code.message.startswith("STUCK_IN_MINIMUM: so it is")

    def test_every_status_has_a_code_of_moveits(self):
        codes = {status.name: moveit_code(status) for status in Status}
        assert all(codes[status.name] is status for status in Status if status > -20)
        assert codes["SERVER_BUSY"] is codes["SCENE_INVALID"] is Status.FAILURE

    @pytest.mark.parametrize("seconds", [0.0, 0.9999999999, 1.5, 3599.123456789])
    def test_durations_are_whole_nanoseconds(self, seconds: float):
        found = duration(seconds)
        assert found["sec"] + 1e-9 * found["nanosec"] == pytest.approx(seconds, abs=6e-10)
        assert 0 <= found["nanosec"] < 10**9
