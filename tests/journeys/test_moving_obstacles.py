"""Plans among moving obstacles over the wire: certified among them, and longer than without them."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from guidefield.messages.replies import PlanReply
from guidefield.messages.scene import Scene
from guidefield.scene.scene import build
from tests.examples import example
from tests.handlers.test_sequence import READY, Bare, distance, states
from tests.journeys.service import PlainClient


@pytest.mark.parametrize("title", ["door", "conveyor"])
def test_a_scene_that_moves_is_planned_over_the_wire(wire: PlainClient, title: str) -> None:
    request = msgspec.json.decode(example(title)) | {"recording": "off"}
    reply = wire.ask("guidefield/local/plan", {**request, "run_id": title})
    assert reply["status"]["name"] == "SUCCESS", reply["status"]
    assert reply["certificate"]["collision_free"] is True
    scene = wire.ask(f"guidefield/local/scenes/{request['scene']}")["scene"]
    standing = [obstacle for obstacle in scene["obstacles"] if not obstacle.get("trajectory")]
    assert len(standing) < len(scene["obstacles"]), "something moves"
    alone = {**request, "scene": {**scene, "obstacles": standing}, "run_id": f"{title}-alone"}
    unhindered = wire.ask("guidefield/local/plan", alone)
    assert unhindered["status"]["name"] == "SUCCESS"
    ends = [answer["trajectory"]["times"][-1] for answer in (reply, unhindered)]
    assert ends[0] > ends[1], "what moves costs time"


GATE = {
    "type": "box",
    "name": "gate",
    "size": [0.4, 0.02, 1.2],
    "trajectory": {"times": [1.0, 2.0], "placements": [{"position": [0.4, 0.0, 0.5]}, {"position": [0.4, 0.0, 1.8]}]},
}
"""Between left and right of a Panda until it rises."""
BEHIND = {"name": "behind", "vertices": [[0.2, 0.2, 0.4], [0.4, 0.2, 0.4], [0.4, 0.2, 0.7], [0.2, 0.2, 0.7]]}
UPRIGHT = {"type": "orientation_cone", "frame": "panda_hand", "axis": [0, 0, 1], "target_axis": [0, 0, -1]}


def turned(angle: float) -> dict[str, Any]:
    return {"goal": {"type": "joints", "positions": {"panda_joint1": angle}}}


@pytest.mark.parametrize(
    "asked",
    [
        {"steps": [turned(-0.4) | {"stop": False, "radius": 0.2}, turned(1.0)]},
        {**turned(1.0), "guide_planes": [BEHIND]},
        {**turned(1.0), "guide_planes": [BEHIND], "path_constraints": [UPRIGHT | {"half_angle": 0.2}]},
        {**turned(1.0), "guide_planes": "auto", "limits": {"panda_joint1": {"jerk": 300.0}}},
    ],
    ids=["passed", "planes", "constraints", "jerk"],
)
def test_what_is_asked_for_among_what_rests_is_served_among_what_moves(
    asked: dict[str, Any], wire: PlainClient, request: pytest.FixtureRequest
) -> None:
    scene = {"name": "gate", "obstacles": [GATE]}
    run_id = f"among-what-moves-{request.node.callspec.id}"
    fields = {"robot": "panda", "scene": scene, "start": {**READY, "panda_joint1": -0.9}, "run_id": run_id}
    told = wire.ask("guidefield/local/plan", {**fields, **asked, "recording": "off", "allowed_planning_time": 60.0})
    assert told["status"]["name"] == "SUCCESS", told["status"]
    reply = msgspec.convert(told, PlanReply)
    assert reply.certificate.collision_free
    bare, (gate,), end = Bare(reply), build(msgspec.convert(scene, Scene)).obstacles, reply.trajectory.times[-1]
    assert end > 1.0, "the gate is in the way until then"
    for now in np.linspace(0.0, max(end, 2.0), 120).tolist():
        bare.stand(states(reply, np.array([min(now, end)]))[0])
        there = gate.placement_at(now)
        assert all(distance(shape, here, gate.shape, there) > 0.0 for _, shape, here in bare.bodies()), now
