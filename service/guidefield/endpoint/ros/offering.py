"""The service on ROS, from the robot's name to a node that is there."""

from __future__ import annotations

import contextlib
import json
import logging
from collections.abc import Iterator

import zenoh

from guidefield.endpoint.link import UNLESS_TOLD
from guidefield.endpoint.ros.distributions import types_of
from guidefield.endpoint.ros.engine_door import Ask, EngineDoor
from guidefield.endpoint.ros.known_robot import KnownRobot
from guidefield.endpoint.ros.known_scene import KnownScene
from guidefield.endpoint.ros.node import RosNode
from guidefield.endpoint.ros.options import LATCHING, RosSettings
from guidefield.endpoint.ros.snapshot import Snapshot
from guidefield.robot.model.model import RobotModel
from guidefield.robot.urdf.encoding import read_xml

_log = logging.getLogger(__name__)


def ros_node(settings: RosSettings, session: zenoh.Session, model: RobotModel, ask: Ask) -> RosNode:
    """A node on a session, that isn't offered yet.

    Args:
        settings: How it is offered.
        session: An open session.
        model: The robot that is offered.
        ask: Has requests of ours answered.

    Raises:
        RobotInvalid: if the robot can't be offered over ROS.
    """
    robot = KnownRobot(settings.robot, model)
    known = KnownScene(Snapshot(robot))
    return RosNode(
        session, settings.domain, types_of(settings.distribution), known, EngineDoor(ask), _description(model)
    )


@contextlib.contextmanager
def session_for(settings: RosSettings, own: zenoh.Session) -> Iterator[zenoh.Session]:
    """The session in which nodes are met: the service's own, or one that is a router's client.

    Raises:
        zenoh.ZError: if the router can't be reached.
    """
    if settings.connect is None:
        yield own
        return
    config = zenoh.Config()
    for key, value in UNLESS_TOLD.items():
        config.insert_json5(key, value)
    config.insert_json5(*LATCHING)
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([settings.connect]))
    with zenoh.open(config) as session:
        yield session


def _description(model: RobotModel) -> str | None:
    """The robot's URDF as its file has it; of one that a client stored the text names files of this machine."""
    if model.source.urdf_path is None:
        _log.warning("robot %s was stored by a client: /robot_description isn't published", model.name)
        return None
    return read_xml(model.source.urdf_path)
