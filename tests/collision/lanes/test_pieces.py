"""Bodies that aren't convex among rods and plates, against Coal, with no inner balls: pieces and triangles decide."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from guidefield.collision.clearance import clearance_at
from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.collision.world import World
from guidefield.kernels.collide.layout import BAND
from guidefield.kernels.kinematics.poses import POSE
from guidefield.kernels.simd.packing import pack
from guidefield.messages import scene as messages
from guidefield.scene.scene import build
from tests.kernels.collide.lane_callers import placements_of_configurations
from tests.robots import group


def obstacle(kind: str, centre: np.ndarray, rng: np.random.Generator) -> messages.Box | messages.Cylinder:
    """A thin one through a point."""
    placed = {
        "name": "thin",
        "position": tuple(centre),
        "quaternion_xyzw": tuple(pin.Quaternion(rng.normal(size=4)).normalized().coeffs()),
    }
    if kind == "cylinder":
        return messages.Cylinder(radius=0.004, length=0.3, **placed)
    if kind == "capsule":
        return messages.Capsule(radius=0.003, length=0.2, **placed)
    return messages.Box(size=(0.005, 0.01, 0.25) if kind == "rod" else (0.1, 0.15, 0.004), **placed)


def without_inner_balls(lanes: BatchCollision) -> BatchCollision:
    """The same robot, but not kept from itself, and nothing known of its inside."""
    bodies = lanes.tables.bodies
    tables = lanes.tables._replace(bodies=bodies._replace(inners=np.zeros_like(bodies.inners), n_meetings=0))
    return dataclasses.replace(lanes, words=pack(tables))


@pytest.mark.parametrize("kind", ["rod", "plate", "cylinder", "capsule"])
def test_thin_obstacles_near_the_middles_of_pieces(kind: str) -> None:
    planned, rng = group("ur5"), np.random.default_rng(5)
    lanes = BatchCollision.build(World.build(planned, build(messages.Scene(name="empty", obstacles=[]))))
    bodies, joints = lanes.tables.bodies, lanes.tables.joints
    verdicts = []
    for _ in range(60):
        z = planned.chart(planned.random(rng))
        poses = np.zeros(joints.size * POSE, np.float32)
        placements_of_configurations(joints, np.repeat(z.astype(np.float32), 16), poses)
        body = int(rng.integers(2, bodies.size))
        piece = int(rng.integers(bodies.pieces[body], bodies.pieces[body + 1]))
        pose = poses.reshape(-1, 3, 4, 16)[bodies.joints[body], :, :, 0]
        middle = pose[:, :3] @ bodies.piece_bounds[4 * piece : 4 * piece + 3] + pose[:, 3]
        centre = middle + rng.choice([0.0, 0.03, 0.06]) * rng.normal(size=3)
        world = World.build(planned, build(messages.Scene(name="thin", obstacles=[obstacle(kind, centre, rng)])))
        distance = clearance_at(world, planned.expand_from_chart(z)).obstacle_distance
        if not 0.0 < distance <= BAND:  # where bodies touch, it is 0 however deep
            verdicts.append(distance <= 0.0)
            kept = without_inner_balls(BatchCollision.build(world))
            assert bool(kept.touching(z[None])[0]) == (distance <= 0.0)
    assert 10 < sum(verdicts) < len(verdicts) - 5
