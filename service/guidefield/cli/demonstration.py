"""`guidefield demo`: start a service, have it plan and stream, and store recordings for the viewer.

Tests, `tools/attacks` and `tools/pictures` use `REQUESTS`, too; pictures also know when the stream reaches places. In
it a Panda moves between two places of a table among drifting boxes: `box_at` must stay slower than `FASTEST`, which it
declares, or pieces are proven against false motions.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from guidefield.cli.found_run import fetch_files
from guidefield.cli.serving import service_in_child
from guidefield.cli.tables import motion_table
from guidefield.client import Client
from guidefield.errors import Status
from guidefield.messages.requests import GuidePlaneGoal, PlanRequest, PoseGoal
from guidefield.messages.scene import Box
from guidefield.messages.streams import Observation, Piece, StreamObstacle, StreamOpen, StreamUpdate
from guidefield.messages.values import JointsGoal, Placement, Positions

IN_FRONT: Positions = {
    "panda_joint1": 0.0,
    "panda_joint2": -0.785398,
    "panda_joint3": 0.0,
    "panda_joint4": -2.356194,
    "panda_joint5": 0.0,
    "panda_joint6": 1.570796,
    "panda_joint7": 0.785398,
}
"""Start of the arm: in front of the shelf, its hand down [rad]."""

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
"""Title and request by name of the recording: a Panda reaches between two boards, with guide planes and without."""


def run(folder: Path, out: Console) -> int:
    """Have a service plan the demonstration's requests, and store recordings in a folder; return 0 if all succeeded."""
    folder.mkdir(parents=True, exist_ok=True)
    codes = []
    with (
        service_in_child(lambda line: out.print(line, style="dim", highlight=False)) as service,
        Client.connect(service.endpoint) as client,
    ):
        for name, (title, request) in REQUESTS.items():
            out.print(f"\nplanning: {title} …", style="dim", highlight=False)
            reply = fetch_files(client, client.plan(request), folder / f"{name}.rrd")
            out.print(motion_table(reply, title))
            codes.append(reply.status.code)
    return 0 if all(code == Status.SUCCESS for code in codes) else 1


def run_stream(folder: Path, out: Console) -> int:
    """Have a Panda serve among drifting boxes, in this process, and store its journal and recording in a folder.

    Returns 0 if a place was reached and the same pieces come again, else 1.
    """
    from guidefield.first_start import compile_kernels

    def say(line: str) -> None:
        out.print(line, style="dim", highlight=False)

    compile_kernels(say)
    folder.mkdir(parents=True, exist_ok=True)
    served = serve(folder, say)
    without = ", ".join(f"{reason} {count}" for reason, count in served.reasons.items())
    out.print(
        f"{served.pieces} pieces, each with a proven stop; updates without one: {without or 'none'}\n"
        f"done again: {'the same' if served.same else 'not the same'}, to the last bit\n"
        f"recording: {served.recording}",
        highlight=False,
    )
    return 0 if served.places and served.same else 1


BENT: Positions = {  # the arm's joints but the first one, at both places [rad]
    "panda_joint2": 0.15,
    "panda_joint3": 0.0,
    "panda_joint4": -2.0,
    "panda_joint5": 0.0,
    "panda_joint6": 2.15,
    "panda_joint7": 0.785398,
}
PLACES = (0.9, -0.9)  # positions of the first joint at the two places [rad]
SCENE = "table"
SIDE = 0.1  # side of the boxes [m]
FASTEST = 0.25  # their declared largest speed [m/s]
LASTS = 16.0  # duration of the demonstration [s]
PERIOD = 0.02  # time between two updates [s], by the demonstration's own clock; as `StreamOpen.period`


@dataclass(frozen=True)
class DemoOutcome:
    """The outcome of the demonstration."""

    places: int  # number of reached places
    pieces: int  # number of pieces
    reasons: dict[str, int]  # number of updates without a piece, by reason
    same: bool  # whether a replay gives the same pieces
    recording: Path  # the recording


def box_at(number: int, now: float) -> tuple[float, float, float]:
    """Return the placement of a box that slides to and fro across the table, slower than it declares."""
    phase = 1.3 * number
    x = 0.42 + 0.16 * number + 0.05 * math.sin(0.9 * now + phase)
    return x, 0.75 * math.sin(0.25 * now + phase), 0.72 - 0.08 * number


def serve(folder: Path, say: Callable[[str], None]) -> DemoOutcome:
    """Run the demonstration on a counted clock, and store its journal and recording.

    Args:
        folder: Folder of both.
        say: Prints a line.
    """
    from guidefield.engine import Engine
    from guidefield.stream.journal import Journal, files_of, replay
    from guidefield.stream.shown import record

    names = [f"box{number}" for number in range(3)]
    request = StreamOpen(
        "panda",
        SCENE,
        start={**BENT, "panda_joint1": 0.0},
        obstacles=[StreamObstacle(Box(name=name, size=(SIDE, SIDE, SIDE)), FASTEST) for name in names],
    )
    engine, kept = Engine(), folder / "demo-stream"
    for old in files_of(kept):
        old.unlink()
    journal = Journal(kept, request, "plain", {})
    places = pieces = 0
    reasons: dict[str, int] = {}
    with engine.stream(request, None, journal) as stream:
        stream.aim_for(_place(places))
        for cycle in range(round(LASTS / PERIOD)):
            now = cycle * PERIOD
            seen = [Observation(name, now, Placement(box_at(index, now))) for index, name in enumerate(names)]
            answer = stream.update(StreamUpdate(now, seen))
            if isinstance(answer, Piece):
                pieces += 1
                continue
            reasons[answer.reason] = reasons.get(answer.reason, 0) + 1
            if answer.reason == "at_goal" and now >= answer.stops:
                places += 1
                say(f"{now:5.2f} s: place {places} is reached")
                stream.aim_for(_place(places))
    journal.close()
    (file,) = files_of(kept)
    recording = folder / "demo-stream.rrd"
    record([file], engine.stream, recording)
    return DemoOutcome(places, pieces, reasons, replay(file, engine.stream).same, recording)


def _place(count: int) -> JointsGoal:
    return JointsGoal({**BENT, "panda_joint1": PLACES[count % 2]})
