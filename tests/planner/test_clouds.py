"""A plan around a point cloud, judged by Pinocchio and Coal: no link comes to a ball of the cloud."""

import coal
import numpy as np
import pinocchio as pin

import guidefield
from guidefield.geometry import surfaces
from guidefield.robot.link_charges import surface_points
from tests.handlers.motions import Bare, distance

RADIUS = 0.02
SOLID = surfaces.box((0.3, 0.4, 0.5))
SCAN = surface_points(SOLID.vertices, SOLID.triangles, 0.06).points + np.array([0.5, 0.0, 0.25])


def test_a_robot_goes_around_a_cloud() -> None:
    cloud = {"type": "point_cloud", "name": "scan", "points": SCAN.tolist(), "radius": RADIUS}
    reply = guidefield.answer(
        {
            "robot": "panda",
            "scene": {"name": "scanned", "obstacles": [cloud]},
            "start": {"panda_joint1": 1.2},
            "goal": {"type": "joints", "positions": {"panda_joint1": -1.2}},
            "guide_planes": [],
            "allowed_planning_time": 60.0,
            "recording": "off",
        }
    )
    assert reply.status.name == "SUCCESS", reply.status
    bare, ball, nearest = Bare(reply.position_names), coal.Sphere(RADIUS), np.inf
    places = [pin.SE3(np.eye(3), point) for point in SCAN[::3]]
    for row in reply.trajectory.positions[::4]:
        bare.stand(np.array(row))
        for _, shape, here in bare.bodies():
            nearest = min(nearest, *(distance(shape, here, ball, there) for there in places))
    assert nearest > 0.0
    assert nearest > reply.clearance.minimum - 1e-3
