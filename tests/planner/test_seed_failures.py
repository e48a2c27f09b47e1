"""The seed's scenes made impossible: every way to fail has its own status, and says where."""

from __future__ import annotations

import time

import msgspec
import pytest

from guidefield.handlers.plan import answer_plan
from guidefield.messages import codec
from guidefield.messages.replies import PlanReply
from guidefield.scene.scene import build
from guidefield.stores import scenes
from tests.examples import example
from tests.robots import robot


def ask(title: str, minimizer: str, planes: list | None = None, obstacles: tuple = ()) -> PlanReply:
    request = msgspec.json.decode(example(title)) | {"minimizer": minimizer}
    scene = msgspec.to_builtins(scenes.read_packaged(request["scene"]))
    scene["obstacles"] += obstacles
    request["scene"] = scene
    if planes is not None:
        request["guide_planes"] = planes
    message = codec.decode_request(request)
    return answer_plan(message, robot(message.robot), build(message.scene), run_id="r", received=time.monotonic())


def square(x: float, half: float, y: float = 0.0, z: float = 0.0) -> dict:
    corners = [[x, y + a * half, z + b * half] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return {"name": "GP", "vertices": corners}


@pytest.mark.parametrize("minimizer", ["projected", "univariate"])
class TestSeed:
    def test_a_plane_out_of_reach(self, minimizer: str) -> None:
        reply = ask("seed_b_tapered", minimizer, [square(2.4, 0.1)])
        assert reply.status.name == "GUIDE_PLANE_UNREACHABLE"
        assert "the arm reaches" in reply.status.message
        assert reply.status.details["guide_plane"] == "GP"
        assert len(reply.path) == 1

    def test_a_plane_narrower_than_the_robot(self, minimizer: str) -> None:
        reply = ask("seed_e_L_3", minimizer, [square(0.9, 0.02)])
        assert reply.status.name == "GUIDE_PLANE_UNREACHABLE"
        assert "inscribed radius" in reply.status.message

    def test_a_passage_narrower_than_the_robot(self, minimizer: str) -> None:
        """A plug leaves a slit of 30 mm at the bottom of the tube; the links are 50 mm thick."""
        plug = {"type": "box", "name": "plug", "size": [0.02, 0.3, 0.27], "position": [0.85, 0.0, 0.015]}
        reply = ask("seed_e_L_3", minimizer, obstacles=(plug,))
        assert reply.status.name == "STUCK_IN_MINIMUM"
        assert "plug" in reply.status.message
        assert reply.status.details["plane"] == 0
        assert set(reply.status.details["pair"]) == {"link1", "plug"}
        x, y, z = reply.status.details["tip"]
        assert 0.7 < x < 0.85
        assert max(abs(y), abs(z)) < 0.15
        assert reply.certificate.collision_free

    def test_a_start_in_a_pocket(self, minimizer: str) -> None:
        """The tube is closed before and behind the robot."""
        lids = tuple(
            {"type": "box", "name": f"lid{i}", "size": [0.02, 0.3, 0.3], "position": [x, 0.0, 0.0]}
            for i, x in enumerate((0.62, -0.3))
        )
        reply = ask("seed_e_L_3", minimizer, obstacles=lids)
        assert reply.status.name == "STUCK_IN_MINIMUM"
        assert "lid0" in reply.status.message
        assert reply.status.details["tip"][0] < 0.62


def test_a_plane_behind_the_base_is_reached() -> None:
    reply = ask("seed_b_tapered", "projected", [square(-0.6, 0.15)])
    assert reply.status.name == "SUCCESS"
