"""`guidefield demo`: start a service, have it plan and stream, and store recordings for the viewer.

Tests, `tools/attacks` and `tools/pictures` use `REQUESTS`, too.
"""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from guidefield.cli.found_run import fetch_files
from guidefield.cli.serving import service_in_child
from guidefield.cli.tables import motion_table
from guidefield.client import Client
from guidefield.errors import Status
from guidefield.messages.requests import GuidePlaneGoal, PlanRequest, PoseGoal
from guidefield.messages.values import Positions

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
    from guidefield.demo_stream import serve
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
