"""The guide planes of a plan request: its own, the scene's, or derived."""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass

import numpy as np

from guidefield.deadline import Deadline
from guidefield.messages.requests import GuidePlaneGoal, PlanRequest
from guidefield.planner.guide.auto_planes import derive
from guidefield.planner.plan import Plan
from guidefield.planner.task.problem import ConfigurationGoal, Problem, TipGoal
from guidefield.planner.task.trace import StageLeft
from guidefield.scene import guide_plane
from guidefield.scene.guide_plane import GuidePlane
from guidefield.scene.scene import Scene


def given_planes(request: PlanRequest, scene: Scene, deadline: Deadline) -> tuple[GuidePlane, ...]:
    """The request's planes, else the scene's; none where the bare connection is asked for.

    Where planes are to be derived, the last of the scene's is left if it is the goal.

    Raises:
        SceneInvalid: if a plane of the request isn't flat, isn't convex or has no area.
        DeadlineExpired: if time was up before planes of many corners were built.
    """
    if request.planner == "tree":
        return ()
    if isinstance(request.guide_planes, list):
        return guide_plane.build_all(request.guide_planes, deadline)
    if request.guide_planes == "auto":
        return scene.guide_planes[-1:] if isinstance(request.goal, GuidePlaneGoal) else ()
    return scene.guide_planes


@dataclass(frozen=True)
class Derivation:
    """The outcome of deriving guide planes, the first stage of a plan; None if none were asked for."""

    left: StageLeft | None = None
    warning: str | None = None

    def told_in(self, made: Plan) -> Plan:
        """The plan with this stage in it."""
        if self.left is None:
            return made
        seconds = {**made.seconds, "guide": made.seconds.get("guide", 0.0) + self.left.seconds}
        warnings = made.warnings if self.warning is None else (*made.warnings, self.warning)
        return dataclasses.replace(made, stages=(self.left, *made.stages), seconds=seconds, warnings=warnings)


def with_derived_planes(problem: Problem, request: PlanRequest) -> tuple[Problem, Derivation]:
    """The problem with guide planes derived, if the request asks for that: among obstacles as they come to rest."""
    if request.guide_planes != "auto" or request.planner == "tree":
        return problem, Derivation()
    begin = time.perf_counter()
    planes = derive(problem.at(problem.scene.end), _goal_place(problem))
    seconds = time.perf_counter() - begin
    if planes is None:
        warning = "no guide planes could be derived: the tip alone finds no way to the goal"
        return problem, Derivation(StageLeft("guide", "no guide planes derived", seconds), warning)
    left = StageLeft("guide", f"derived {len(planes)} guide planes", seconds)
    together = dataclasses.replace(problem, guide_planes=(*planes, *problem.guide_planes), derived_planes=len(planes))
    return together, Derivation(left)


def _goal_place(problem: Problem) -> np.ndarray | GuidePlane:
    """Return the goal of the tip: a point, shape (3,) [m], or a plane."""
    if isinstance(problem.goal, ConfigurationGoal):
        return problem.kinematics.tip_position(problem.group.expand(problem.goal.configurations[0]))
    if isinstance(problem.goal, TipGoal):
        return np.array(problem.goal.target.placement.translation)
    return problem.guide_planes[-1]
