"""The demonstration's requests: a Panda reaches between two boards of a bookshelf, with guide planes and without."""

from __future__ import annotations

from guidefield.messages.requests import GuidePlaneGoal, PlanRequest, PoseGoal, Positions

IN_FRONT: Positions = {
    "panda_joint1": 0.0,
    "panda_joint2": -0.785398,
    "panda_joint3": 0.0,
    "panda_joint4": -2.356194,
    "panda_joint5": 0.0,
    "panda_joint6": 1.570796,
    "panda_joint7": 0.785398,
}
"""Where the arm begins: in front of the shelf, its hand down [rad]."""

REQUESTS = {
    "demo-guide-planes": (
        "the Panda reaches between two boards, led by the shelf's guide planes",
        PlanRequest(
            robot="panda", scene="bookshelf", start=IN_FRONT, goal=GuidePlaneGoal(), allowed_planning_time=60.0
        ),
    ),
    "demo-pose": (
        "the same shelf, a pose between the boards, no guide planes",
        PlanRequest(
            robot="panda",
            scene="bookshelf",
            start=IN_FRONT,
            goal=PoseGoal(
                position=(0.58, 0.0, 0.48), quaternion_xyzw=(0.0, 0.7071067811865476, 0.0, 0.7071067811865476)
            ),
            guide_planes=[],
            allowed_planning_time=60.0,
        ),
    ),
}
"""By the name of the recording: what is asked, in a sentence and as a request."""
