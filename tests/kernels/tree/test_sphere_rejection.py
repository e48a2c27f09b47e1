"""What the sieve calls hit touches an obstacle, by Coal and by the lanes; and it finds many contacts."""

import numpy as np
import pytest

from guidefield.collision.clearance import clearance_at
from guidefield.kernels.simd.vector import LANES
from guidefield.kernels.tree.rrt_connect import SIEVE
from tests.collision.lanes.test_lanes import draw, world_of
from tests.kernels.collide.lane_callers import hits_of_configurations


@pytest.mark.parametrize("robot", ["panda", "ur5"])
@pytest.mark.parametrize("clearance", [0.0, 0.02])
def test_what_is_hit_touches(robot: str, clearance: float) -> None:
    world, lanes = world_of(robot, "zoo")
    hits, seen, missed = np.full(3 * SIEVE, -1, np.int64), 0, 0
    zs = draw(world.group, 640, 3)
    touching = lanes.touching(zs, clearance)
    for block, touches in zip(zs.reshape(-1, LANES, zs.shape[1]), touching.reshape(-1, LANES), strict=True):
        mask = hits_of_configurations(lanes.words, clearance, block.T.astype(np.float32).ravel(), hits)
        hit = np.array([mask >> k & 1 for k in range(LANES)], bool)
        assert not (hit & ~touches).any()
        for z in block[hit][:2]:
            assert clearance_at(world, world.group.expand_from_chart(z)).obstacle_distance < clearance + 1e-5
        seen += hit.sum()
        missed += (touches & ~hit).sum()
    assert seen > 100
    assert (hits.reshape(-1, 3)[0] >= 0).all()
    assert seen > missed
