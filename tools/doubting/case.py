"""A case as a small file: a robot, a request, and what was said about it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import msgspec

from doubting.robots import Robot
from guidefield.messages.requests import CertifyRequest, PlanRequest, UrdfText

Request = PlanRequest | CertifyRequest
SCHEMA = 1


@dataclass(frozen=True)
class Case:
    """Something to repeat.

    Attributes:
        robot: The robot.
        request: What is asked; its robot is the one above.
        said: What contradicted its answer, as sentences.
        origin: Where it came from: a unit's seed and so on.
    """

    robot: Robot
    request: Request
    said: tuple[str, ...] = ()
    origin: str = ""

    def write(self, file: Path) -> None:
        """As JSON."""
        plain = {
            "schema": SCHEMA,
            "said": list(self.said),
            "origin": self.origin,
            "robot": self.robot.plain(),
            "kind": type(self.request).__name__,
            "request": msgspec.to_builtins(msgspec.structs.replace(self.request, robot=UrdfText(text=""))),
        }
        file.write_text(json.dumps(plain, indent=1))

    @classmethod
    def read(cls, file: Path, folder: Path) -> Case:
        """From a file; the robot's meshes are written into a folder."""
        plain = json.loads(file.read_text())
        robot = Robot.of(plain["robot"])
        kind = {"PlanRequest": PlanRequest, "CertifyRequest": CertifyRequest}[plain["kind"]]
        request = msgspec.convert(plain["request"], kind)
        request = msgspec.structs.replace(request, robot=robot.reference(folder))
        return cls(robot, request, tuple(plain["said"]), plain["origin"])
