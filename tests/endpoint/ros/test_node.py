"""A node on a real link without an engine; joint states of bags that rosbags wrote."""

import json
import logging
from pathlib import Path

import numpy as np
import pytest
import zenoh
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from typer.testing import CliRunner

import guidefield
from guidefield.cli import app
from guidefield.cli.serving import free_port
from guidefield.endpoint.link import LATCHING, RosSettings
from guidefield.endpoint.ros.node import ros_node
from guidefield.endpoint.ros.rmw_zenoh import Entity, Kind, Node
from guidefield.endpoint.ros.robot_messages import read_bag
from guidefield.errors import MalformedRequest, UnknownObject
from tests.endpoint.ros.peer import peer_at
from tests.handlers.test_certify import NAMES
from tests.handlers.test_executed import REQUEST, states
from tests.journeys.service import await_that
from tests.robots import robot


def never(*_asked: object) -> None:
    raise AssertionError("nobody asks the engine here")


def test_a_client_of_another_version_is_named_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    asking = Entity(Kind.CLIENT, "plan_kinematic_path", "moveit_msgs/srv/GetMotionPlan", "RIHS01_of_another_one")
    config = zenoh.Config()
    config.insert_json5(*LATCHING)
    config.insert_json5("scouting/multicast/enabled", "false")
    with free_port() as port:
        config.insert_json5("listen/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
        with zenoh.open(config) as session, peer_at(f"tcp/127.0.0.1:{port}") as peer:
            node = ros_node(RosSettings("panda"), session, robot("panda"), never)
            present = peer.session.liveliness().declare_token(Node(0, "1a", "early").token_of(1, asking))
            node.offer()
            late = peer.session.liveliness().declare_token(Node(0, "1a", "late").token_of(2, asking))
            await_that(lambda: {"early", "late"} <= {word for word in caplog.text.split("'") if len(word) < 6})
            present.undeclare()
            late.undeclare()
            node.withdraw()
            node.finish()
    assert caplog.text.count("of RIHS01_of_anothe…") == 2


STATE = "sensor_msgs/msg/JointState"
BEGIN = 1_700_000_000.0
STORE = get_typestore(Stores.ROS2_JAZZY)


def write_bag(
    path: Path, joints: list[str], topic: str = "/joint_states", stamped: bool = True, bare: bool = False
) -> Path:
    told = states(begin=BEGIN)
    columns = [told.joints.index(joint) for joint in joints]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection(topic, STATE, typestore=STORE)
        for time, row in zip(told.times, told.positions, strict=True):
            sec, nanosec = divmod(round(time * 1e9), 10**9) if stamped else (0, 0)
            stamp = STORE.types["builtin_interfaces/msg/Time"](sec, nanosec)
            empty = np.empty(0)
            places = empty if bare else np.array(row)[columns]
            message = STORE.types[STATE](STORE.types["std_msgs/msg/Header"](stamp, ""), joints, places, empty, empty)
            bag.write(connection, round(time * 1e9), STORE.serialize_cdr(message, STATE))
    return path


@pytest.mark.parametrize("stamped", [True, False])
def test_a_bag_has_the_states_of_the_joints_asked_for(tmp_path: Path, stamped: bool) -> None:
    bag, told = write_bag(tmp_path / "bag", ["finger", *NAMES], stamped=stamped), states()
    found = read_bag(bag, "/joint_states", NAMES)
    np.testing.assert_allclose(np.array(found.times) - BEGIN, told.times, atol=1e-6)
    np.testing.assert_array_equal(found.positions, np.array(told.positions)[:, :0:-1])


def test_what_a_bag_lacks_is_said_by_name(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", NAMES[1:])
    with pytest.raises(MalformedRequest, match="there is no joint 'panda_joint1' in them; the joint states have panda"):
        read_bag(bag, "/joint_states", NAMES)
    with pytest.raises(MalformedRequest, match="no joint states on '/arm'; on: /joint_states"):
        read_bag(bag, "/arm", NAMES)
    with pytest.raises(UnknownObject, match="there is no bag"):
        read_bag(tmp_path / "none.mcap", "/joint_states", NAMES)
    (tmp_path / "text.mcap").write_text("no bag")
    with pytest.raises(MalformedRequest, match="is no bag that can be read"):
        read_bag(tmp_path / "text.mcap", "/joint_states", NAMES)
    told = states()
    bare = write_bag(tmp_path / "bare", told.joints, bare=True)
    with pytest.raises(MalformedRequest, match="no message has all joints of the plan"):
        read_bag(bare, "/joint_states", NAMES)


def test_the_command_line_judges_a_bag_against_a_plan(tmp_path: Path) -> None:
    plan = tmp_path / "plan.rrd"
    assert guidefield.answer(REQUEST, record_to=plan).status.name == "SUCCESS"
    bag, out = write_bag(tmp_path / "bag", NAMES), tmp_path / "reply.json"
    done = CliRunner().invoke(app, ["certify", str(bag), "--against", str(plan), "--output", str(out)])
    assert done.exit_code in (0, 1), done.output
    assert "off the plan" in done.output
    assert '"deviation"' in out.read_text()
    done = CliRunner().invoke(app, ["certify", str(bag), "--against", str(plan), "--rate", "3"])
    assert "--rate" in str(done.exception)
    done = CliRunner().invoke(app, ["certify", str(bag), "--against", str(plan), "--robot", "ur5"])
    assert "--robot is the run's with --against" in str(done.exception)
