"""What a caller can do about each outcome that is no success."""

from __future__ import annotations

from guidefield.errors import Status

ADVICE = {
    Status.PLANNING_FAILED: "Give more `allowed_planning_time`, another `seed`, or a goal that is nearer or freer.",
    Status.INVALID_MOTION_PLAN: "Change the motion where it is refused, or lower `min_clearance`, or `plan` one.",
    Status.TIMED_OUT: "Give more `allowed_planning_time` (or `allowed_time`), or ask for less at once.",
    Status.PREEMPTED: "Somebody cancelled it; ask again if it is still wanted.",
    Status.START_STATE_IN_COLLISION: "Ask `clearance` at the start. If the contact is wanted, name the pair in"
    " `allowed_collisions`; if it is slight, set `leave_start_contact`.",
    Status.START_STATE_VIOLATES_PATH_CONSTRAINTS: "Widen the constraint's tolerance, or begin where it holds.",
    Status.GOAL_IN_COLLISION: "Ask `clearance` at the goal and move the goal away from that pair, or name the pair in"
    " `allowed_collisions` if it may touch.",
    Status.GOAL_VIOLATES_PATH_CONSTRAINTS: "Widen the constraint's tolerance, or take a goal where it holds.",
    Status.GOAL_CONSTRAINTS_VIOLATED: "Widen the goal's tolerances.",
    Status.INVALID_GROUP_NAME: "Ask `robot` for its groups and joints.",
    Status.INVALID_GOAL_CONSTRAINTS: "Ask `robot` for its joints, and write the goal for them.",
    Status.INVALID_ROBOT_STATE: "Ask `robot` for the names and kinds of its joints.",
    Status.INVALID_LINK_NAME: "Ask `robot` for its links and frames.",
    Status.INVALID_OBJECT_NAME: "Ask `scene` for the names of its obstacles.",
    Status.COMMUNICATION_FAILURE: "Tell the user: no service answers there. `guidefield serve` starts one.",
    Status.START_STATE_INVALID: "Ask `robot` for the joint's limits, and begin within them.",
    Status.GOAL_STATE_INVALID: "Ask `robot` for the joint's limits, and take a goal within them.",
    Status.CRASH: "Ask again; if it comes again, tell the user, whose service has a log.",
    Status.NO_IK_SOLUTION: "Ask `inverse_kinematics` with other poses or wider tolerances: the pose is out of reach, or"
    " every configuration that reaches it touches something.",
    Status.STUCK_IN_MINIMUM: "Set `guide_planes` to [] or `planner` to `tree`, or move the guide planes.",
    Status.GUIDE_PLANE_UNREACHABLE: "Move the guide plane towards the robot, or set `guide_planes` to [].",
    Status.CLEARANCE_BELOW_MINIMUM: "Lower `min_clearance`, or give more `allowed_planning_time`.",
    Status.SCENE_INVALID: "Ask `scenes` for the names, or send the scene itself.",
    Status.ROBOT_INVALID: "Ask `robots` for the names.",
    Status.SERVER_BUSY: "Wait, and ask again.",
    Status.QUOTA_EXCEEDED: "Wait as long as it says, and ask for less at once.",
    Status.NOT_ALLOWED: "Take something of your own, or tell the user: its owner can share it.",
    Status.STREAM_UNKNOWN: "Tell the user: the stream is closed or was never open; no tool here opens one.",
    Status.MALFORMED_REQUEST: "Correct the field that is named.",
    Status.REQUEST_TOO_LARGE: "Send less: fewer points, triangles or configurations.",
    Status.DISK_REFUSED: "Tell the user: the service's disk is full or can't be written.",
    Status.FAILURE: "Tell the user: this is a bug in guidefield, and the service has a log.",
}
"""By outcome."""


def advised(code: int) -> str:
    """What can be done about an outcome; nothing about a success, or about one of a later version."""
    return {int(status): words for status, words in ADVICE.items()}.get(code, "")
