"""A robot with an angle whose turns count: a lift, an arm that turns on and on, and a slide that follows its angle."""

from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.messages.requests import UrdfText
from guidefield.messages.scene import Sphere
from tests.robot.by_formula import ByFormula

PITCH, OFFSET = 0.2, 0.3  # how far the slide moves for one radian of the arm [m], and where it is at none [m]

_LINK = '<link name="{}"><collision><origin xyz="{}"/><geometry><sphere radius="{}"/></geometry></collision></link>'
_JOINT = '<joint name="{}" type="{}"><parent link="{}"/><child link="{}"/><axis xyz="{}"/>{}</joint>'
_LIMIT = '<limit lower="{}" upper="{}" effort="1" velocity="2"/>'


def winding(multiplier: float = PITCH) -> UrdfText:
    """The robot; its `hand` is on a forearm of the arm, its `tool` on the slide below.

    Args:
        multiplier: How far the slide moves for a radian of the arm [m].
    """
    law = _LIMIT.format(-5, 5) + f'<mimic joint="turn" multiplier="{multiplier}" offset="{OFFSET}"/>'
    return UrdfText(
        text='<robot name="winding">'
        + _LINK.format("floor", "0 0 -1", 0.05)
        + _LINK.format("mast", "0 0 -0.5", 0.05)
        + _LINK.format("arm", "0.1 0 0.0", 0.03)
        + _LINK.format("tool", "0 0 0", 0.04)
        + _JOINT.format("lift", "prismatic", "floor", "mast", "0 0 1", _LIMIT.format(-0.6, 0.6))
        + _JOINT.format("turn", "continuous", "mast", "arm", "0 0 1", "")
        + _JOINT.format("slide", "prismatic", "arm", "tool", "1 0 0", law)
        + '<link name="forearm"/><link name="hand"/>'
        + '<joint name="elbow" type="revolute"><parent link="arm"/><child link="forearm"/><origin xyz="0.4 0 0.3"/>'
        + f'<axis xyz="0 0 1"/>{_LIMIT.format(-2.5, 2.5)}</joint>'
        + '<joint name="held" type="fixed"><parent link="forearm"/><child link="hand"/><origin xyz="0.4 0 0"/></joint>'
        + "</robot>"
    )


def place(turn: float, lift: float = 0.0) -> np.ndarray:
    """Where the tool is, shape (3,) [m, world], by the formula."""
    radius = PITCH * turn + OFFSET
    return np.array([radius * np.cos(turn), radius * np.sin(turn), lift])


def nearest(urdf: UrdfText, spheres: list[Sphere], rows: list[dict[str, Any]]) -> float:
    """Least distance of the robot's moving shapes to spheres at values of its joints, by Coal on the URDF alone [m]."""
    robot, geometry = ByFormula(urdf.text), pin.GeometryModel()
    pin.buildGeomFromUrdfString(robot.model, urdf.text, pin.GeometryType.COLLISION, geometry, [])
    moving = [body for body in geometry.geometryObjects if body.parentJoint]
    least, request = np.inf, coal.DistanceRequest()
    for row in rows:
        robot.placements(row)
        for body in moving:
            T = robot.data.oMi[body.parentJoint] * body.placement
            for sphere in spheres:
                placed = coal.Transform3s(np.eye(3), np.array(sphere.position))
                shape = coal.Transform3s(T.rotation, T.translation)
                result = coal.DistanceResult()
                distance = coal.distance(body.geometry, shape, coal.Sphere(sphere.radius), placed, request, result)
                least = min(least, distance)
    return float(least)
