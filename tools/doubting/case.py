"""Cases as small files: written, made smaller, read and repeated."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from doubting.compare import Disagreement, Kind
from doubting.doubted import doubt_answer
from doubting.loaded import Loaded
from doubting.refereed import ask_hpp, ask_referee
from doubting.robots import Robot
from guidefield.engine import Engine
from guidefield.messages.replies import CertifyReply
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


MOST = 150
"""So often a smaller case is tried."""
replaced = msgspec.structs.replace


def shrink(loaded: Loaded, request: Request, kind: Kind) -> Request:
    """The smallest request that was found whose answer is contradicted in the same way."""
    tries, smaller = 0, True
    while smaller and tries < MOST:
        smaller = False
        for candidate in _smaller(request):
            tries += 1
            if tries > MOST:
                break
            if any(one.kind is kind for one in find_contradictions(loaded, candidate)):
                request, smaller = candidate, True
                break
    return request


def find_contradictions(loaded: Loaded, request: Request) -> tuple[Disagreement, ...]:
    """Find what contradicts the answer to a request: samples, and the referee or HPP where these say nothing."""
    came = doubt_answer(loaded, request)
    if came.found or not isinstance(came.reply, CertifyReply) or not isinstance(request, CertifyRequest):
        return came.found
    return tuple(ask_referee(request, came.reply)[1] or ask_hpp(loaded, request, came.reply)[1])


def _smaller(request: Request) -> Iterator[Request]:
    """Requests with something less, what saves most first."""
    scene = request.scene
    obstacles = list(scene.obstacles)
    for part in _parts(len(obstacles)):
        yield replaced(request, scene=replaced(scene, obstacles=[obstacles[k] for k in part]))
    for field, nothing in (
        ("attached_objects", []),
        ("allowed_collisions", []),
        ("path_constraints", []),
        ("limits", {}),
        ("leave_start_contact", False),
    ):
        if getattr(request, field):
            yield replaced(request, **{field: nothing})
    if isinstance(request, CertifyRequest):
        yield from _shorter(request)


def _shorter(request: CertifyRequest) -> Iterator[CertifyRequest]:
    """Motions with fewer rows."""
    given = request.trajectory
    if given is None:
        for part in _parts(len(request.path)):
            if part:
                yield replaced(request, path=[request.path[k] for k in part])
        return
    if given.times is None or given.velocities is None:
        return
    for part in _parts(len(given.times)):
        if part:
            fields: dict[str, Any] = {
                name: [getattr(given, name)[k] for k in part] for name in ("positions", "times", "velocities")
            }
            yield replaced(request, trajectory=replaced(given, accelerations=None, **fields))


def _parts(count: int) -> Iterator[list[int]]:
    """Indices of so many things with less and less left out, from either end and then one by one."""
    size = count // 2
    while size >= 1:
        yield list(range(size, count))
        yield list(range(count - size))
        size //= 2
    yield from ([k for k in range(count) if k != out] for out in range(count)) if count > 2 else ()


def repeat(file: Path) -> int:
    """Repeat a case, and tell of it: 0, or 1 if its answer is contradicted."""
    with tempfile.TemporaryDirectory() as folder:
        case = Case.read(file, Path(folder))
        print(f"{file}: {case.origin}")
        for said in case.said:
            print(f"  said then: {said}")
        loaded = Loaded.of(case.robot, Path(folder), Engine())
        came, found = doubt_answer(loaded, case.request), find_contradictions(loaded, case.request)
    if came.reply is not None:
        print(f"  {came.reply.status.name}: {came.reply.status.message}")
    if came.sampled is not None:
        print(f"  sampled: {came.sampled.obstacle}, own {came.sampled.own}")
    for one in found:
        print(f"  said now: {one.kind}: {one.said}")
    return int(bool(found))
