"""A planar joint moves in the plane normal to its axis and turns about it, wherever it is asked about."""

import math

import numpy as np
import pinocchio as pin
import pytest

from guidefield.engine import answer
from guidefield.messages.requests import UrdfText
from guidefield.robot.model.model import plane_rotation
from tests.robots import load

BOX = '<collision><origin xyz="0.1 0 0"/><geometry><box size="0.2 0.1 0.05"/></geometry></collision>'
SLID = {"pl": [1.0, 2.0, 0.5]}


def sled(axis: str | None, rpy: str = "0 0 0", limit: str = "") -> UrdfText:
    direction = "" if axis is None else f'<axis xyz="{axis}"/>'
    return UrdfText(
        text=f'<robot name="p"><link name="w"/><link name="sled">{BOX}</link><link name="tool">{BOX}</link>'
        f'<joint name="pl" type="planar"><origin xyz="0.3 0 0.1" rpy="{rpy}"/><parent link="w"/><child link="sled"/>'
        f'{direction}{limit}</joint><joint name="turn" type="revolute"><origin xyz="0 0.4 0" rpy="0.3 0 0"/>'
        '<parent link="sled"/><child link="tool"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )


def placed(robot: UrdfText, frame: str, turn: float = 0.0) -> pin.SE3:
    reply = answer(
        {
            "type": "forward_kinematics",
            "robot": {"type": "urdf", "text": robot.text},
            "configurations": [{**SLID, "turn": turn}],
            "frames": [frame],
        }
    )
    placement = reply.placements[0][0]
    return pin.XYZQUATToSE3(np.array([*placement.position, *placement.quaternion_xyzw]))


def by_hand(axis: np.ndarray, first: np.ndarray, rpy: tuple[float, float, float]) -> pin.SE3:
    """The sled's placement: along the plane's axes, then about the normal, in the joint's frame."""
    normal = axis / np.linalg.norm(axis)
    x, y, angle = SLID["pl"]
    origin = pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array([0.3, 0.0, 0.1]))
    return origin * pin.SE3(pin.AngleAxis(angle, normal).matrix(), x * first + y * np.cross(normal, first))


@pytest.mark.parametrize(
    ("axis", "first"),
    [
        ("0 0 1", [1, 0, 0]),
        ("0 0 2", [1, 0, 0]),
        ("0 0 -1", [1, 0, 0]),
        ("0 1 0", [1, 0, 0]),
        ("0 -3 0", [1, 0, 0]),
        ("1 0 0", [0, 1, 0]),
        ("-1 0 0", [0, 1, 0]),
        ("1 0 1", [1, 0, -1]),
        ("0 1e200 0", [1, 0, 0]),
        ("1 2 -0.5", [4.25, -2, 0.5]),
        (None, [0, 1, 0]),
    ],
)
@pytest.mark.parametrize("rpy", [(0.0, 0.0, 0.0), (math.pi / 2, 0.0, 0.4)])
def test_links_are_where_the_axis_says(axis: str | None, first: list[float], rpy: tuple[float, float, float]) -> None:
    normal = np.array((axis or "1 0 0").split(), float)
    robot = sled(axis, " ".join(map(repr, rpy)))
    sled_there = by_hand(normal / np.abs(normal).max(), np.array(first) / np.linalg.norm(first), rpy)
    assert placed(robot, "sled").isApprox(sled_there, 1e-12)
    assert placed(robot, "pl").isApprox(sled_there, 1e-12), "the joint's frame is its child link's"
    mounted = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0, 0), np.array([0, 0.4, 0]))
    tool = sled_there * mounted * pin.SE3(pin.rpy.rpyToMatrix(0, 0.7, 0), np.zeros(3))
    assert placed(robot, "tool", 0.7).isApprox(tool, 1e-12)
    shape = load(robot).geometry.geometryObjects[0]
    data, model = load(robot).model.createData(), load(robot).model
    q = np.array([1.0, 2.0, math.cos(0.5), math.sin(0.5), 0.0])
    pin.forwardKinematics(model, data, q)
    body = sled_there * pin.SE3(np.eye(3), np.array([0.1, 0, 0]))
    assert (data.oMi[shape.parentJoint] * shape.placement).isApprox(body, 1e-12)


def test_the_planes_axes_are_right_handed() -> None:
    rng = np.random.default_rng(0)
    for axis in [*np.vstack([np.eye(3), -np.eye(3)]), *rng.normal(size=(200, 3))]:
        turn = plane_rotation(1e-3 * axis)
        np.testing.assert_allclose(turn.T @ turn, np.eye(3), atol=1e-15)
        assert np.linalg.det(turn) > 0.0
        np.testing.assert_allclose(turn[:, 2], axis / np.linalg.norm(axis), atol=1e-15)


def test_its_velocity_binds_every_freedom_and_its_range_is_told() -> None:
    limited = load(sled("0 1 0", limit='<limit lower="-1" upper="1" effort="1" velocity="0.3"/>'))
    assert limited.joints[0].velocity.tolist() == [0.3, 0.3, 0.3]
    assert "joint 'pl': a planar joint has no range: 'lower' and 'upper' are left out" in limited.warnings[0]
    assert "a planar joint without <axis> moves in the plane normal to x" in load(sled(None)).warnings[0]


def test_a_motion_in_the_plane_is_planned_certified_and_refereed(tmp_path: object) -> None:
    """A wall across the plane of the URDF's axis stops the sled; one in Pinocchio's own plane doesn't."""
    across = {"type": "box", "name": "wall", "size": [0.1, 3, 3], "position": [1.0, 0, 0.1]}
    beside = {"type": "box", "name": "wall", "size": [3, 0.1, 3], "position": [0.3, 1.0, 0.1]}
    ask = {"type": "certify", "robot": {"type": "urdf", "text": sled("0 1 0").text}, "group": ["pl"]}
    path = {"path": [[0, 0, 0], [2, 1.5, 0]], "position_names": ["pl.x", "pl.y", "pl.theta"]}
    verdicts = [
        answer({**ask, **path, "scene": {"name": "s", "obstacles": [wall]}}).status.name for wall in (across, beside)
    ]
    assert verdicts == ["INVALID_MOTION_PLAN", "SUCCESS"]
