"""Random free goals for a robot, and the judgement of its plans, by plain Pinocchio and Coal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from doubting import scenery
from doubting.asked import between, value
from doubting.compare import Disagreement, about_plan, judge_of, names_of
from doubting.judge import Judge
from doubting.loaded import Loaded, Wire, as_values, subject_of
from doubting.robots import Robot
from guidefield.engine import Engine
from guidefield.messages import scene as messages
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest, RobotReference
from guidefield.messages.values import Placement
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.joints import Joint
from guidefield.robot.model.model import RobotModel


@dataclass(frozen=True, eq=False)
class Goals:
    """A robot for which goals are drawn.

    Attributes:
        loaded: The robot, as it was loaded and as the judge reads it.
        planned: Joints that a plan moves unless it is told otherwise.
        judge: The judge of the robot alone.
    """

    loaded: Loaded
    planned: tuple[Joint, ...]
    judge: Judge

    @classmethod
    def of(cls, robot: RobotModel, reference: RobotReference, engine: Engine) -> Goals:
        """Prepare a robot.

        Raises:
            InvalidGroup: if there is nothing to plan for.
        """
        planned = select(robot, None, None, robot.rest, pin.SE3.Identity()).joints
        text = mend(robot.source.urdf_text)
        loaded = Loaded(Robot(), reference, robot, subject_of(robot, text), text, engine)
        return cls(loaded, planned, loaded.judge(frozenset(joint.name for joint in planned)))

    def draw(self, seed: list[int], draws: int, obstacles: int) -> tuple[Wire, list[messages.Obstacle]] | None:
        """Draw a free configuration, and obstacles that it and the rest configuration keep clear of.

        Args:
            seed: Of the random numbers.
            draws: Configurations that are tried, the later half near the rest configuration.
            obstacles: Most obstacles that are put about.

        Returns:
            Values of the planned joints, as the wire has them, and the obstacles; None if no configuration was free.
        """
        rng = np.random.default_rng(seed)
        rest = {name: values.tolist()[0] for name, values in self.loaded.subject.rest.items()}
        for number in range(draws):
            wire = {**rest, **{joint.name: value(rng, joint) for joint in self.planned}}
            if number >= draws // 2:
                wire = {**rest, **_of(self.planned, between(rng, self.loaded, rest, wire, 0.3))}
            if not self.judge.touches_at(as_values(wire)):
                return _of(self.planned, wire), self._strewn(rng, rest, wire, obstacles)
        return None

    def _strewn(self, rng: np.random.Generator, rest: Wire, goal: Wire, count: int) -> list[messages.Obstacle]:
        if not count:
            return []
        middle = as_values(between(rng, self.loaded, rest, goal))
        names = frozenset(joint.name for joint in self.planned)
        setting: dict[str, Any] = {"placement": Placement(), "min_clearance": 0.0, "attached": []}
        ends = [as_values(rest), as_values(goal)]
        strewn = scenery.strew(rng, self.loaded, names, ends, middle, count, **setting)
        judges = [self.loaded.judge(names, obstacles=[one]) for one in strewn]
        return [one for one, judge in zip(strewn, judges, strict=True) if not any(map(judge.touches_at, ends))]

    def doubt(self, request: PlanRequest, reply: PlanReply) -> list[Disagreement]:
        """Return what dense samples say against a plan."""
        judge = judge_of(self.loaded, request, names_of(reply.position_names))
        return about_plan(self.loaded, request, reply, judge)[0]


def _of(joints: tuple[Joint, ...], wire: Wire) -> Wire:
    return {joint.name: wire[joint.name] for joint in joints}


def mend(text: str) -> str:
    """Exchange reversed limits, and give sources of mimic joints their prefix: `robots.md` says how faults are read."""
    root = ElementTree.fromstring(text)  # noqa: S314 - the service has read it
    names = [joint.get("name", "") for joint in root.findall("joint")]
    for joint in root.findall("joint"):
        for limit in joint.findall("limit"):
            lower, upper = limit.get("lower", "0"), limit.get("upper", "0")
            if float(lower) > float(upper):
                limit.attrib.update(lower=upper, upper=lower)
        for mimic in joint.findall("mimic"):
            source, own = mimic.get("joint", ""), joint.get("name", "")
            meant = [name for name in names if name.endswith(source) and own.startswith(name.removesuffix(source))]
            if source not in names:
                (mimic.attrib["joint"],) = [name for name in meant if name != own]
    return ElementTree.tostring(root, encoding="unicode")
