"""A body wholly inside another's closed mesh is in contact with it: every clearance that is told is 0."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import guidefield
from tests.robot.odd_meshes import stl
from tests.scene.solids import l_prism

BALL = '<collision><origin xyz="{}"/><geometry><sphere radius="0.02"/></geometry></collision>'
SLIDER = (
    '<robot name="b"><link name="w">{}</link><link name="ball">{}</link><joint name="x" type="prismatic">'
    '<parent link="w"/><child link="ball"/><axis xyz="1 0 0"/>'
    '<limit lower="-9" upper="9" velocity="1" effort="1"/></joint></robot>'
)
VERTICES, TRIANGLES = l_prism()


def prism(at: float = 0.0) -> dict[str, Any]:
    """The prism, so that what stands at the origin is inside by a good deal."""
    corners = (VERTICES - inner()) * 0.5 + [at, 0.0, 0.0]
    return {"type": "mesh", "name": "L", "vertices": corners.tolist(), "triangles": TRIANGLES.tolist()}


def inner() -> np.ndarray:
    """The point of the prism's corner cell that is far from its surface."""
    low, high = VERTICES.min(axis=0), VERTICES.max(axis=0)
    return low + 0.25 * (high - low) * [1.0, 1.0, 2.0]


def slider(post: str = "") -> dict[str, Any]:
    return {"type": "urdf", "text": SLIDER.format(post, BALL.format("0 0 0"))}


def mesh_robot(folder: Path, name: str = "L.stl") -> dict[str, Any]:
    """The moving link is the prism."""
    corners = (VERTICES - inner()) * 0.5
    (folder / name).write_bytes(stl(corners[TRIANGLES]))
    link = f'<collision><geometry><mesh filename="{name}"/></geometry></collision>'
    (folder / "robot.urdf").write_text(SLIDER.format("", link))
    return {"type": "urdf_file", "path": str(folder / "robot.urdf")}


def ask(kind: str, robot: Any, *obstacles: dict[str, Any], **more: Any) -> Any:
    scene = {"name": "s", "obstacles": list(obstacles)}
    return guidefield.answer({"type": kind, "robot": robot, "scene": scene, **more})


def test_a_ball_inside_a_mesh_has_no_clearance() -> None:
    reply = ask("clearance", slider(), prism(), configurations=[{"x": 0.0}, {"x": 3.0}], contacts=True)
    assert reply.minimum[0] == 0.0
    assert reply.pair[0] == ["ball", "L"]
    assert reply.contacts[0] == [["ball", "L"]]
    assert reply.minimum[1] > 1.0


@pytest.mark.parametrize("kind", ["sphere", "box", "point_cloud"])
def test_what_is_inside_a_links_mesh_has_no_clearance(kind: str, tmp_path: Path) -> None:
    one = {
        "sphere": {"type": "sphere", "radius": 0.02},
        "box": {"type": "box", "size": [0.03, 0.02, 0.02]},
        "point_cloud": {"type": "point_cloud", "points": [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]], "radius": 0.005},
    }[kind]
    obstacle = {**one, "name": "o"}
    robot = mesh_robot(tmp_path)
    reply = ask("clearance", robot, obstacle, configurations=[{"x": 0.0}, {"x": 3.0}])
    assert reply.minimum[0] == 0.0
    assert reply.minimum[1] > 1.0
    judged = ask("certify", robot, obstacle, path=[[0.0], [0.01]], position_names=["x"])
    assert judged.status.name == "INVALID_MOTION_PLAN"
    assert judged.clearance.minimum == judged.clearance.mean == judged.clearance.ends == 0.0


def test_a_link_inside_a_links_mesh_has_no_clearance(tmp_path: Path) -> None:
    mesh_robot(tmp_path)
    post = BALL.format("0 0 0")
    link = '<collision><geometry><mesh filename="L.stl"/></geometry></collision>'
    text = SLIDER.format(post, link).replace('<link name="ball">', '<link name="m"/><link name="ball">')
    text = text.replace('<child link="ball"/>', '<child link="m"/>').replace(
        "</robot>",
        '<joint name="y" type="prismatic"><parent link="m"/><child link="ball"/><axis xyz="0 1 0"/>'
        '<limit lower="-9" upper="9" velocity="1" effort="1"/></joint></robot>',
    )
    (tmp_path / "robot.urdf").write_text(text)
    robot = {"type": "urdf_file", "path": str(tmp_path / "robot.urdf")}
    reply = ask("clearance", robot, configurations=[{"x": 0.0, "y": 0.0}, {"x": 3.0, "y": 0.0}])
    assert reply.self_minimum[0] == 0.0
    assert reply.self_minimum[1] > 1.0
    judged = ask("certify", robot, path=[[0.0], [0.01]], position_names=["x"])
    assert judged.status.name == "INVALID_MOTION_PLAN"
    assert judged.self_clearance.minimum == 0.0


@pytest.mark.parametrize("moves", [False, True])
def test_a_motion_that_begins_inside_has_no_clearance(moves: bool) -> None:
    one: dict[str, Any] = prism()
    times: dict[str, Any] = {"path": [[0.0], [0.01]]}
    if moves:
        flight = [{"position": [0.0, 0.0, 0.0]}, {"position": [0.0, 0.0, 0.001]}]
        one["trajectory"] = {"times": [0, 1], "placements": flight}
        times = {"trajectory": {"times": [0, 1], "positions": [[0.0], [0.01]]}}
    reply = ask("certify", slider(), one, position_names=["x"], **times)
    assert reply.status.name == "INVALID_MOTION_PLAN"
    assert reply.clearance.minimum == 0.0
    assert reply.clearance.pair == ["ball", "L"]
    assert reply.clearance.mean == reply.clearance.ends == 0.0
