"""Ways of a stream: what they keep from what rests, and a way out of where that is not kept."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from guidefield.messages.scene import HalfSpace, Scene
from guidefield.messages.streams import StreamOpen
from guidefield.robot.model.spaces import ChartPoint
from guidefield.scene.scene import build
from guidefield.stream.settings import STREAM
from guidefield.stream.stream import CertifiedStream
from tests.robots import robot

UP = {"shoulder_lift_joint": -1.5, "elbow_joint": 0.5}
NOTHING = np.empty((0, 16))


def top(stream: CertifiedStream, z: ChartPoint) -> float:
    """How high a robot is with some coordinates (nv,), by Pinocchio and Coal [m]."""
    geometry = stream.group.geometry
    placed, data = geometry.createData(), stream.group.model.createData()
    pin.updateGeometryPlacements(stream.group.model, data, geometry, placed, stream.group.expand_from_chart(z))
    ceiling = coal.Halfspace(np.array([0.0, 0.0, -1.0]), -10.0)
    gaps = [
        coal.distance(
            shape.geometry, coal.Transform3s(here.rotation, here.translation), ceiling, coal.Transform3s(),
            coal.DistanceRequest(), coal.DistanceResult(),
        )
        for shape, here in zip(geometry.geometryObjects, placed.oMg, strict=True)
    ]  # fmt: skip
    return 10.0 - min(gaps)


def test_a_way_begins_where_the_robot_is_closer_than_ways_keep() -> None:
    with CertifiedStream(StreamOpen("ur5", "empty", start=UP), robot("ur5"), build(Scene("empty"))) as stream:
        height = top(stream, stream.executing.ends)
    for gap, kept in ((0.003, 0.5), (0.0015, 0.25), (0.0004, 0.0), (0.01, 1.0)):
        ceiling = HalfSpace(name="ceiling", normal=(0.0, 0.0, -1.0), offset=-(height + gap))
        scene = build(Scene("room", obstacles=[ceiling]))
        with CertifiedStream(StreamOpen("ur5", "room", start=UP), robot("ur5"), scene) as stream:
            room, z0 = stream._room, stream.executing.ends
            z1 = z0.copy()
            z1[1] -= 1.0
            assert room.resting_free(np.array([z0, z1])).tolist() == [kept == 1.0, True]
            assert room.clearance(STREAM.resting, [z0, z1]) == kept * STREAM.resting
            samples = np.random.default_rng(0).uniform(-2.0, 2.0, (50, len(z0)))
            way = room.way(NOTHING, np.empty(0), z0, z1, samples, np.empty((0, 4)))
        assert way is not None
        assert np.array_equal(way[[0, -1]], [z0, z1])
