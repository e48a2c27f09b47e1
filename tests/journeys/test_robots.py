"""Robots over the wire: a client's own with its meshes."""

import base64
import json

import msgspec
import pytest

from guidefield import Client, RobotInvalid
from tests.journeys.service import PlainClient

CUBE = "\n".join(
    [
        *(f"v {x} {y} {z}" for x in (-0.02, 0.02) for y in (-0.02, 0.02) for z in (0, 0.25)),
        *("f 1 2 4 3", "f 5 7 8 6", "f 1 5 6 2", "f 3 4 8 7", "f 1 3 7 5", "f 2 6 8 4"),
    ]
).encode()
LINK = (
    '<link name="l{i}"><collision><geometry><mesh filename="package://mine/bar.obj"/></geometry></collision>'
    '<visual><geometry><mesh filename="package://mine/bar.obj"/></geometry></visual></link>'
)
JOINT = (
    '<joint name="j{i}" type="revolute"><origin xyz="0 0 0.3"/><parent link="l{p}"/><child link="l{i}"/>'
    '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>'
)
URDF = (
    '<robot name="mine">'
    + "".join(LINK.format(i=i) for i in range(3))
    + "".join(JOINT.format(i=i, p=i - 1) for i in (1, 2))
    + "</robot>"
)
BALL = {"name": "ball", "obstacles": [{"type": "sphere", "name": "s", "radius": 0.05, "position": [0.45, 0.0, 0.55]}]}


def test_a_robot_with_its_mesh_is_stored_read_planned_for_and_deleted(wire: PlainClient) -> None:
    files = {"urdf": URDF, "meshes": {"package://mine/bar.obj": base64.b64encode(CUBE).decode()}}
    assert "stored" in wire.ask("guidefield/local/robots/mine", files)["done"]
    described = wire.ask("guidefield/local/robots/mine")
    assert [joint["name"] for joint in described["joints"]] == ["j1", "j2"]
    assert {shape["judged_as"] for shape in described["geometry"]} == {"convex hull"}
    listed = {robot["name"]: robot for robot in wire.ask("guidefield/local/robots")["robots"]}
    assert listed["mine"]["source"] == "stored"
    assert listed["mine"]["dof"] == 2
    request = {
        **{"robot": "mine", "scene": BALL, "guide_planes": [], "allowed_planning_time": 60.0, "recording": "off"},
        "goal": {"type": "joints", "positions": {"j1": 1.5}},
    }
    reply = wire.ask("guidefield/local/plan", {**request, "start": {"j1": -1.0}})
    assert reply["status"]["name"] == "SUCCESS", reply["status"]
    assert reply["certificate"]["collision_free"]
    wire.ask("guidefield/local/robots/mine?delete")
    assert wire.refusal("guidefield/local/robots/mine")["name"] == "ROBOT_INVALID"
    assert "mine" not in {robot["name"] for robot in wire.ask("guidefield/local/robots")["robots"]}


def test_the_python_client_stores_a_robot(client: Client) -> None:
    client.store_robot("bars", URDF, meshes={"package://mine/bar.obj": CUBE}, root_joint="planar")
    assert [joint.kind for joint in client.robot("bars").joints] == ["planar", "revolute", "revolute"]
    with pytest.raises(RobotInvalid, match="comes with the package"):
        client.store_robot("panda", URDF, meshes={"package://mine/bar.obj": CUBE})
    client.delete_robot("bars")
    with pytest.raises(RobotInvalid, match="no robot 'bars' is stored"):
        client.delete_robot("bars")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"meshes": {}}, "was not found (allowed: meshes sent with the robot, package://example-robot-data/"),
        ({"meshes": {"package://mine/bar.obj": b"mtllib /etc/passwd\n" + CUBE}}, "names '/etc/passwd', which was not"),
        ({"meshes": {"package://mine/bar.obj": b"v 1 2 3"}}, "package://mine/bar.obj"),
        ({"meshes": {"package://mine/bar.obj": CUBE, "../../x.sh": b""}}, "is of no kind that can be sent"),
        ({"urdf": URDF.replace("package://mine/bar.obj", "/etc/hostname.stl")}, "lies outside what is allowed"),
        ({"urdf": '<!DOCTYPE a [<!ENTITY x SYSTEM "/etc/passwd">]><robot name="&x;"/>'}, "must not have a <!DOCTYPE>"),
        ({"srdf": "<!DOCTYPE a [<!ENTITY x 'y'>]><robot name='&x;'/>"}, "DOCTYPE"),
    ],
)
def test_what_is_wrong_with_a_robot_is_told_and_no_folder_of_the_service(change, words, wire, service):
    files = {"urdf": URDF, "meshes": {"package://mine/bar.obj": CUBE}, **change}
    answer = wire.answer("guidefield/local/robots/mine", msgspec.msgpack.encode(files), "application/msgpack")
    assert not answer.is_reply
    error = msgspec.msgpack.decode(answer.payload)
    assert error["name"] == "ROBOT_INVALID"
    assert words in error["message"]
    assert str(service.data) not in json.dumps(error)
    assert "site-packages" not in json.dumps(error)
    assert not list((service.data / "robots" / "contents").iterdir())


def test_names_and_fields_are_checked(wire: PlainClient) -> None:
    files = json.dumps({"urdf": URDF, "mesh": {}}).encode()
    assert wire.refusal("guidefield/local/robots/mine", files)["name"] == "MALFORMED_REQUEST"
    files = json.dumps({"urdf": URDF, "meshes": {"package://mine/bar.obj": "no base64!"}}).encode()
    assert wire.refusal("guidefield/local/robots/mine", files)["name"] == "MALFORMED_REQUEST"
    files = json.dumps({"urdf": "<robot/>"}).encode()
    assert wire.refusal("guidefield/local/robots/.mine", files)["name"] == "MALFORMED_REQUEST"
