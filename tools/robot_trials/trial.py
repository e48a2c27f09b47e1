"""The trial of one robot in this process: ``python -m robot_trials.trial ROBOT catalog|file SEED ALLOWED OUTPUT``.

The output is written after each step, so that a process that is ended leaves what it had.
"""

from __future__ import annotations

import time

STARTED = time.time() - time.process_time()
"""About when this process began; what it computed so far counts into the first answer."""

import contextlib  # noqa: E402 - the time comes first
import json  # noqa: E402
import sys  # noqa: E402
import traceback  # noqa: E402
import zlib  # noqa: E402
from collections.abc import Iterator  # noqa: E402
from pathlib import Path  # noqa: E402
from typing import Any  # noqa: E402

from guidefield.engine import Engine  # noqa: E402
from guidefield.errors import GuidefieldError, InternalFailure  # noqa: E402
from guidefield.messages.requests import JointsGoal, PlanRequest, RobotReference, UrdfFile  # noqa: E402
from guidefield.messages.scene import Scene  # noqa: E402
from guidefield.robot.urdf.xml import is_xacro  # noqa: E402

PLANS = 2
DRAWS = 60
"""Goals that are tried."""
NO_LINK = "at least one <link>"
"""In the message about a URDF without links."""
OBSTACLES = 3
"""Number of obstacles for the second plan."""

Line = dict[str, Any]


class Trial:
    """One robot, and what has been found of it.

    Args:
        robot: Its file, or its name in the catalog.
        is_file: Which of both.
        seed: Of the goals.
        allowed: Planning time of each plan [s].
        output: Where the line is written.
    """

    def __init__(self, robot: str, is_file: bool, seed: int, allowed: float, output: Path) -> None:
        self.reference: RobotReference = UrdfFile(robot) if is_file else robot
        self.seed, self.output = [seed, zlib.crc32(Path(robot).name.encode())], output
        self.allowed = allowed
        self.line: Line = {"plans": []}
        self.engine = Engine()

    def run(self) -> None:
        """Load it, plan for it, judge the plans."""
        try:
            self._load()
        except GuidefieldError as error:
            if isinstance(self.reference, UrdfFile) and is_xacro(Path(self.reference.path)) and NO_LINK in str(error):
                self._tell(kind="no robot", message="a xacro file that defines no link, to be included by others")
                return
            self._tell(kind=_kind_of(error), status=error.code.name, message=str(error))
        except Exception as error:
            self._tell(kind="traceback", message=_said(error))

    def _load(self) -> None:
        robot = self.engine._loaded.catalog.load(self.reference)
        self.line.update(
            load_cpu=time.process_time(),
            load_wall=time.time() - STARTED,
            dof=sum(joint.nv for joint in robot.joints if joint.mimic is None),
            tip=robot.tip,
            warnings=list(robot.warnings),
        )
        self._write()
        from robot_trials.goals import Goals

        goals = Goals.of(robot, self.reference, self.engine)
        for number in range(PLANS):
            self._plan(goals, number)

    def _plan(self, goals: Any, number: int) -> None:
        drawn = goals.draw([*self.seed, number], DRAWS, OBSTACLES if number else 0)
        if drawn is None:
            self._tell(kind="no free goal", message=f"none of {DRAWS} random configurations is free of itself")
            return
        wire, obstacles = drawn
        scene = Scene(name="trial", obstacles=obstacles)
        goal = JointsGoal(positions=wire)
        request = PlanRequest(
            robot=self.reference, scene=scene, goal=goal, allowed_planning_time=self.allowed, recording="off"
        )
        row: Line = {}
        try:
            with _timed(row):
                reply = self.engine.answer(request)
        except GuidefieldError as error:
            self._tell(**row, kind=_kind_of(error), status=error.code.name, message=str(error))
            return
        except Exception as error:
            self._tell(**row, kind="traceback", message=_said(error))
            return
        row["status"] = reply.status.name
        found = goals.doubt(request, reply)
        row["found"] = [f"{one.kind}: {one.said}" for one in found]
        if any(one.kind.name == "FALSE_CERTIFICATE" for one in found):
            self._tell(**row, kind="false certificate", message=row["found"][0])
        elif found:
            self._tell(**row, kind="contradiction", message=row["found"][0])
        elif reply.status.name == "SUCCESS":
            self._tell(**row, kind="planned", message="")
        else:
            self._tell(**row, kind="not planned", message=f"{reply.status.name}: {reply.status.message}")

    def _tell(self, **row: Any) -> None:
        self.line["plans"].append(row)
        self._write()

    def _write(self) -> None:
        draft = self.output.with_suffix(".draft")
        draft.write_text(json.dumps(self.line))
        draft.replace(self.output)


@contextlib.contextmanager
def _timed(row: Line) -> Iterator[None]:
    """Put the CPU and wall time of what is done within into a row [s]."""
    wall, cpu = time.monotonic(), time.process_time()
    try:
        yield
    finally:
        row["wall"], row["cpu"] = time.monotonic() - wall, time.process_time() - cpu


def _kind_of(error: GuidefieldError) -> str:
    return "traceback" if isinstance(error, InternalFailure) else "refused"


def _said(error: Exception) -> str:
    place = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"


if __name__ == "__main__":
    Trial(sys.argv[1], sys.argv[2] == "file", int(sys.argv[3]), float(sys.argv[4]), Path(sys.argv[5])).run()
