"""A certify request as a motion in a plain file: what the referee judges in the certificate's place."""

from __future__ import annotations

import time

from guidefield.case_file import Motion
from guidefield.deadline import Deadline
from guidefield.handlers.certify_problem import certify_problem
from guidefield.messages.requests import CertifyRequest
from guidefield.planner.given_leaving import judge_leaving
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import Scene


def motion_of(request: CertifyRequest, robot: RobotModel, scene: Scene) -> Motion:
    """The motion that a request is about, and what it is judged by.

    Where a contact at the start may be left, how it is left is found out first.

    Args:
        request: What is asked.
        robot: The robot that it names.
        scene: The scene that it names.

    Raises:
        GuidefieldError: as `certify_problem` does, where the question is ill-posed.
    """
    problem, _ = certify_problem(request, robot, scene, Deadline(time.monotonic() + request.allowed_time))
    given = problem.motion
    leaving = judge_leaving(problem, given.pieces) if request.leave_start_contact else None
    if leaving is not None and not leaving.leaves:
        leaving = None
    return Motion(
        world=problem.world,
        placement=request.robot_placement,
        held=request.attached_objects,
        times=given.times,
        positions=given.positions,
        velocities=given.velocities,
        jerk_limits=problem.jerk_limits,
        min_clearance=problem.min_clearance,
        path_constraints=request.path_constraints,
        touching=() if leaving is None else [one.pair for one in leaving.contacts],
        left_at=(0, 0.0) if leaving is None else (leaving.piece, leaving.share),
    )
