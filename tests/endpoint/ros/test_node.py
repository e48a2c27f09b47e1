"""A node on a real link, without an engine behind it."""

import json
import logging

import pytest
import zenoh

from guidefield.cli.serving import free_port
from guidefield.endpoint.link import LATCHING, RosSettings
from guidefield.endpoint.ros.node import ros_node
from guidefield.endpoint.ros.rmw_zenoh import Entity, Kind, Node
from tests.endpoint.ros.peer import peer_at
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
