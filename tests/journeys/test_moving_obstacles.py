"""Plans among moving obstacles over the wire: certified among them, and longer than without them."""

from __future__ import annotations

import msgspec
import pytest

from tests.examples import example
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
