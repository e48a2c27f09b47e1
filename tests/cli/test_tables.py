from __future__ import annotations

import msgspec
from rich.console import Console

from guidefield.cli.tables import motion_table
from guidefield.messages.replies import (
    CertificateFigures,
    ClearanceFigures,
    Metrics,
    SelfClearance,
    Stage,
    Timing,
)
from guidefield.messages.scene import GuidePlane
from tests.replies import plan_reply


def _text(table: object) -> str:
    console = Console(width=160, color_system=None)
    with console.capture() as captured:
        console.print(table)
    return captured.get()


def test_a_plan_says_what_a_person_wants_to_know() -> None:
    reply = msgspec.structs.replace(
        plan_reply("r1"),
        guide_planes=[GuidePlane("GP1", [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])],
        stages=[Stage(name="guide", outcome="reached", seconds=0.0081, plane=0)],
        clearance=ClearanceFigures(
            minimum=0.0312, mean=0.09, inner=0.052, ends=0.031, pair=["panda_hand", "board1"], time=1.7
        ),
        self_clearance=SelfClearance(minimum=0.021, pair=["panda_link5", "panda_link7"]),
        certificate=CertificateFigures(collision_free=True, method="Coal", covers="trajectory", evaluations=412),
        metrics=Metrics(joint_path_length=3.2, tip_path_length=0.9, duration=2.4, peak_jerk=40.0, smoothness=0.2),
        timing=Timing(guide=0.0081, certify=0.002, total=1.25),
        recording="runs/r1.rrd",
        warnings=["start panda_joint4 was clamped"],
    )
    text = _text(motion_table(reply, "the shelf"))
    for said in (
        "the shelf",
        "SUCCESS",
        "2 waypoints",
        "2.40 s long",
        "31.2 mm between panda_hand and board1, at 1.70 s",
        "21.0 mm between panda_link5 and panda_link7",
        "free: the trajectory, 412 evaluations",
        "guide GP1: reached, 8.1 ms",
        "1.25 s in all (guide 8.1 ms, certify 2.0 ms)",
        "start panda_joint4 was clamped",
        "show runs/r1.rrd",
    ):
        assert said in text, said
