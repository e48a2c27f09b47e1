"""A robot that is loaded: what the service knows of it, and what the judge does."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from doubting.curve import Values
from doubting.formula import Formula
from doubting.judge import Judge, Setting, Subject
from doubting.robots import Robot
from guidefield.engine import Engine
from guidefield.messages.requests import RobotReference, UrdfFile, UrdfText
from guidefield.messages.values import Placement
from guidefield.robot.catalog import Catalog
from guidefield.robot.model.configuration import configuration_to_wire
from guidefield.robot.model.joints import Joint
from guidefield.robot.model.model import RobotModel

Wire = dict[str, Any]
"""Values of joints as the wire has them."""


@dataclass(frozen=True, eq=False)
class Loaded:
    """A robot and what is known of it.

    Attributes:
        robot: How to make it anew.
        reference: What requests name.
        model: As the service loads it.
        subject: As the judge knows it.
        text: Its URDF.
        engine: Who answers.
    """

    robot: Robot
    reference: RobotReference
    model: RobotModel
    subject: Subject
    text: str
    engine: Engine

    @classmethod
    def of(cls, robot: Robot, folder: Path, engine: Engine) -> Loaded:
        """Load a robot; its files are written into a folder.

        Raises:
            RobotInvalid: if the service refuses it.
        """
        reference = robot.reference(folder)
        model = Catalog().load(reference)
        text = model.source.urdf_text
        if isinstance(reference, UrdfText):
            text = reference.text
        if isinstance(reference, UrdfFile):
            text = Path(reference.path).read_text()
        return cls(robot, reference, model, subject_of(model, text), text, engine)

    @property
    def movable(self) -> list[Joint]:
        """Joints that follow none."""
        return [joint for joint in self.model.joints if joint.mimic is None]

    @cached_property
    def alone(self) -> Judge:
        """The judge of the robot's own pairs."""
        return self.judge(frozenset(joint.name for joint in self.movable))

    def judge(self, planned: frozenset[str], **more: Any) -> Judge:
        """A judge of the robot in a setting; what isn't said is nothing."""
        nothing: dict[str, Any] = {
            "placement": Placement(),
            "obstacles": [],
            "attached": [],
            "allowed": frozenset(),
            "min_clearance": 0.0,
        }
        return Judge(self.subject, Setting(planned=planned, **{**nothing, **more}))


def subject_of(model: RobotModel, text: str, *, exact: bool = False) -> Subject:
    """A robot as the judge reads it from its URDF; exactly, meshes are judged where the service judges their hulls."""
    hulls = () if exact else (one.name for one in model.geometry_choices if one.judged_as == "convex hull")
    return Subject(
        Formula.of(text, model.source.root_joint),
        frozenset(frozenset(pair.links) for pair in model.pairs_left_out),
        frozenset(hulls),
        as_values(configuration_to_wire(model.joints, model.rest)),
        model.tip,
        max(1.0, model.size),
        model.size,
    )


def as_values(wire: Wire) -> Values:
    """Values on the wire as rows of one."""
    return {name: np.array([value], float) for name, value in wire.items()}
