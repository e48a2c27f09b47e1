"""A plain Zenoh queryable with Pinocchio: the thirty lines that a user would write in place of a service.

Usage: plain.py <endpoint> <urdf> <srdf> <folder of packages> <scene of boxes and cylinders>
"""

import json
import sys
import threading
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import zenoh

endpoint, urdf, srdf, packages, scene = sys.argv[1:]
model = pin.buildModelFromUrdf(urdf)
data = model.createData()
geometry = pin.buildGeomFromUrdf(model, urdf, pin.GeometryType.COLLISION, None, [packages])
geometry.addAllCollisionPairs()
pin.removeCollisionPairs(model, geometry, srdf)
moving = [index for index, shape in enumerate(geometry.geometryObjects) if shape.parentJoint > 0]
for one in json.loads(Path(scene).read_text())["obstacles"]:
    shape = coal.Box(*one["size"]) if one["type"] == "box" else coal.Cylinder(one["radius"], one["length"])
    placement = pin.XYZQUATToSE3(np.array([*one["position"], *one["quaternion_xyzw"]], float))
    added = geometry.addGeometryObject(pin.GeometryObject(one["name"], 0, 0, placement, shape))
    for index in moving:
        geometry.addCollisionPair(pin.CollisionPair(index, added))
geometry_data = geometry.createData()


def answer(query: zenoh.Query) -> None:
    """Reply with the poses of frames, or with the smallest distance between links, at each configuration."""
    request, replies = json.loads(query.payload.to_bytes()), []
    for positions in request["configurations"]:
        q = pin.neutral(model)
        for name, value in positions.items():
            q[model.joints[model.getJointId(name)].idx_q] = value
        if request["type"] == "clearance":
            pin.computeDistances(model, data, geometry, geometry_data, q)
            replies.append(min(result.min_distance for result in geometry_data.distanceResults))
        else:
            pin.framesForwardKinematics(model, data, q)
            poses = [pin.SE3ToXYZQUAT(data.oMf[model.getFrameId(frame)]) for frame in request["frames"]]
            replies.append(np.array(poses).tolist())
    query.reply(query.key_expr, json.dumps(replies))


config = zenoh.Config()
for key, value in (("listen/endpoints", json.dumps([endpoint])), ("scouting/multicast/enabled", "false")):
    config.insert_json5(key, value)
with zenoh.open(config) as session, session.declare_queryable("plain", answer):
    print("ready", flush=True)
    threading.Event().wait()
