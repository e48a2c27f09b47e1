"""Motions as the referee reads them: planned ones, and some made by hand."""

import dataclasses
import json
from typing import Any

import numpy as np

from guidefield import case_file
from guidefield.collision.world import World
from guidefield.deadline import Deadline
from guidefield.handlers.plan import problem_of
from guidefield.messages.requests import PlanRequest
from guidefield.messages.values import Placement
from guidefield.planner.plan import plan
from guidefield.referee.case import Case
from guidefield.referee.loading import case_of
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import build


def planned(request: PlanRequest, robot: RobotModel) -> case_file.Motion:
    """The motion that is planned for a request, which has to succeed."""
    problem, _ = problem_of(request, robot, build(request.scene), Deadline())
    made = plan(problem)
    assert made.trajectory is not None, made
    return case_file.Motion(
        world=problem.world,
        placement=request.robot_placement,
        held=request.attached_objects,
        times=made.trajectory.times,
        positions=made.trajectory.positions,
        velocities=made.trajectory.velocities,
        jerk_limits=problem.jerk_limits,
        min_clearance=problem.min_clearance,
        path_constraints=request.path_constraints,
    )


def straight(world: World, ends: Any, min_clearance: float = 0.0) -> case_file.Motion:
    """A path of straight lines in local coordinates, without times."""
    return case_file.Motion(world, Placement(), (), None, np.array(ends, float), None, min_clearance=min_clearance)


def read(motion: case_file.Motion, limits: bool = True) -> Case:
    """What the referee reads; without the joints' limits it may be asked for what they hide."""
    (told,) = case_file.make_cases(motion)
    case = case_of(json.loads(json.dumps(told)))
    endless = np.full_like(case.lower, np.inf)
    return case if limits else dataclasses.replace(case, lower=-endless, upper=endless)
