"""A plan around a point cloud, judged by Pinocchio and Coal: no link comes to a ball of the cloud."""

import coal
import numpy as np
import pinocchio as pin

import guidefield
from guidefield.geometry import surfaces
from guidefield.robot.link_charges import surface_points
from tests.robots import robot

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
    panda = robot("panda")
    data, geometry = panda.model.createData(), pin.GeometryData(panda.geometry)
    columns = [panda.model.joints[panda.model.getJointId(name)].idx_q for name in reply.position_names]
    ball, nearest = coal.Sphere(RADIUS), np.inf
    for positions in reply.trajectory.positions[::4]:
        q = np.array(panda.rest)
        q[columns] = positions
        pin.updateGeometryPlacements(panda.model, data, panda.geometry, geometry, q)
        for shape, placement in zip(panda.geometry.geometryObjects, geometry.oMg, strict=True):
            here = coal.Transform3s(placement.rotation, placement.translation)
            for point in SCAN[::3]:
                there = coal.Transform3s(np.eye(3), point)
                request, result = coal.DistanceRequest(), coal.DistanceResult()
                nearest = min(nearest, coal.distance(shape.geometry, here, ball, there, request, result))
    assert nearest > 0.0
    assert nearest > reply.clearance.minimum - 1e-3
