"""Robots of every size, as people have them: a hand of 8 cm, a crane over a building."""

import math
from pathlib import Path
from typing import Any

from guidefield import (
    Box,
    Capsule,
    Cylinder,
    InverseKinematics,
    JointsGoal,
    PlanReply,
    PlanRequest,
    Scene,
    UrdfText,
    answer,
)
from guidefield.messages.conditions import TargetPose
from tests.recorder.runs import Recording


def certified(
    robot: UrdfText, scene: Scene, goal: dict[str, float], record_to: Path | None = None, **more: Any
) -> PlanReply:
    """A certified plan that is as it was optimised."""
    more = {"guide_planes": [], "allowed_planning_time": 60.0, **more}
    reply = answer(PlanRequest(robot, scene, JointsGoal(goal), **more), record_to=record_to)
    assert reply.status.name == "SUCCESS", reply.status.message
    assert reply.certificate.collision_free
    assert not [one for one in reply.warnings if "as it was found" in one or "metres" in one]
    return reply


def finger(name: str, x: float) -> str:
    """Three links of a finger at x on a palm [m], each of which bends."""
    parts, parent = [], "palm"
    for k, length in enumerate((0.035, 0.025, 0.02)):
        at = f"{x} 0 0.05" if k == 0 else f"0 0 {(0.0, 0.035, 0.025)[k]}"
        link = f"{name}{k}"
        parts.append(
            f'<link name="{link}"><collision><origin xyz="0 0 {length / 2}"/><geometry>'
            f'<capsule radius="0.006" length="{length - 0.014}"/></geometry></collision></link>'
            f'<joint name="{link}" type="revolute"><origin xyz="{at}"/><parent link="{parent}"/>'
            f'<child link="{link}"/><axis xyz="1 0 0"/>'
            '<limit lower="-0.3" upper="1.6" velocity="2" effort="1"/></joint>'
        )
        parent = link
    return "".join(parts)


HAND = f"""<robot name="hand" version="1.1"><link name="base"/><link name="sled"/><link name="palm"><collision>
<geometry><box size="0.08 0.02 0.09"/></geometry></collision></link>
<joint name="along" type="prismatic"><parent link="base"/><child link="sled"/><axis xyz="0 1 0"/>
<limit lower="-0.1" upper="0.1" velocity="0.2" effort="1"/></joint>
<joint name="across" type="prismatic"><parent link="sled"/><child link="palm"/><axis xyz="1 0 0"/>
<limit lower="-0.1" upper="0.1" velocity="0.2" effort="1"/></joint>
{finger("index", -0.025)}{finger("middle", 0.0)}{finger("ring", 0.025)}</robot>"""


def test_a_hand_of_eight_centimetres_goes_between_two_pegs(tmp_path: Path) -> None:
    sides = {"left": -0.046, "right": 0.046}
    pegs = [Cylinder(name=n, radius=0.004, length=0.3, position=(x, 0.0, 0.05)) for n, x in sides.items()]
    bar: list[Any] = [Capsule(name="bar", radius=0.003, length=0.06, position=(0.0, 0.0, 0.12))]
    reply = certified(
        UrdfText(HAND),
        Scene("pegs", obstacles=[*pegs, *bar]),
        {"along": 0.08, "across": 0.0},
        group=["along", "across", "middle0", "middle1", "middle2"],
        start={"along": -0.08, "across": 0.03},
        record_to=tmp_path / "pegs.rrd",
    )
    assert reply.clearance.minimum > 2e-4
    (radius,) = Recording(tmp_path / "pegs.rrd").one("/path/tip", "LineStrips3D:radii")
    assert 0.0 < radius < 0.001, "a line as fine as the hand is small"


CRANE = """<robot name="crane"><link name="base"><collision><origin xyz="0 0 6"/><geometry><box size="1.5 1.5 12"/>
</geometry></collision></link><link name="cab"/>
<link name="boom"><collision><origin xyz="10 0 0"/><geometry><box size="19 0.8 0.8"/></geometry></collision></link>
<link name="hoist"><collision><origin xyz="0 0 -3"/><geometry><cylinder radius="0.15" length="6"/></geometry>
</collision><collision><origin xyz="0 0 -6.5"/><geometry><box size="2 2 1"/></geometry></collision></link>
<joint name="slew" type="revolute"><origin xyz="0 0 13"/><parent link="base"/><child link="cab"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" velocity="0.3" effort="1"/></joint>
<joint name="luff" type="revolute"><parent link="cab"/><child link="boom"/><axis xyz="0 -1 0"/>
<limit lower="-0.2" upper="1.3" velocity="0.1" effort="1"/></joint>
<joint name="level" type="revolute"><origin xyz="20 0 0"/><parent link="boom"/><child link="hoist"/><axis xyz="0 1 0"/>
<limit lower="-1.5" upper="1.5" velocity="0.3" effort="1"/></joint></robot>"""


def test_a_crane_of_twenty_metres_lifts_over_a_building() -> None:
    site = Scene(
        "site",
        obstacles=[
            Box(name="ground", size=(80.0, 80.0, 0.5), position=(0.0, 0.0, -0.3)),
            Box(name="building", size=(12.0, 12.0, 11.0), position=(18.0, 0.0, 5.5)),
        ],
    )
    start, goal = {"slew": -1.0, "luff": 0.0, "level": 0.0}, {"slew": 1.0, "luff": 0.0, "level": 0.0}
    reply = certified(UrdfText(CRANE), site, goal, start=start)
    assert reply.clearance.inner > 0.3
    out, up = 20.0 * math.cos(0.3), 13.0 + 20.0 * math.sin(0.3)
    at = (out * math.cos(0.9), out * math.sin(0.9), up)
    pose = TargetPose(at, (0.0, 0.0, 0.0, 1.0), orientation_tolerance=(None, None, None))
    found = answer(InverseKinematics(UrdfText(CRANE), [pose], scene=site, collision_free=True))
    assert found.configurations[0], found.reasons
