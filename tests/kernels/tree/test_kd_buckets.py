"""The nearest node among many is the one that brute force finds, however the nodes lie and whatever wraps."""

import numpy as np
import pytest

from guidefield.kernels.simd.packing import pack
from guidefield.kernels.tree import nodes as lane_nodes
from guidefield.kernels.tree.informed_samples import Sampling
from guidefield.kernels.tree.kd_buckets import BUCKET, KNOWN, STATE
from guidefield.planner.tree_search import _TreeMemory, held_by
from tests.kernels.collide.lane_callers import nearest_nodes, nearest_nodes_of_samples

WRAPS = np.array([0.0, 2.0 * np.pi, 0.0, 0.0, 2.0 * np.pi], np.float32)


def sampling_of(wraps: np.ndarray) -> Sampling:
    nv = len(wraps)
    frequency = np.array([0.0 if period == 0.0 else 1.0 / period for period in wraps], np.float32)
    return Sampling(
        np.zeros(nv), np.zeros(nv), np.ones(nv), wraps, frequency, np.ones(nv, np.float32), 0, np.zeros(0, np.int64)
    )


def apart(a: np.ndarray, b: np.ndarray, wraps: np.ndarray) -> np.ndarray:
    """Distances, angles the short way round, in double precision."""
    way = a - b
    turns = wraps > 0.0
    way[..., turns] = (way[..., turns] + np.pi) % (2.0 * np.pi) - np.pi
    return np.linalg.norm(way, axis=-1)


def spread(kind: str, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points that lie evenly, in heaps, on a line, in one place, or many turns away."""
    points = rng.uniform(-3.0, 3.0, (count, 5))
    match kind:
        case "heaps":
            points = points[rng.integers(0, 7, count)] + rng.normal(0.0, 0.02, (count, 5))
        case "line":
            points[:, 1:] = 0.5
        case "one place":
            points[:] = points[0]
        case "turns":
            points[:, 1] += 2.0 * np.pi * rng.integers(-3, 4, count)
    return points


@pytest.mark.parametrize("kind", ["even", "one place", "turns"])
@pytest.mark.parametrize("wraps", [WRAPS, 0.0 * WRAPS], ids=["wraps", "straight"])
def test_the_nearest_node_is_brute_forces(kind: str, wraps: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    roots = [spread(kind, count, rng).astype(np.float32) for count in (700, 5000)]
    room, sampling = _TreeMemory.build(5, 8192), sampling_of(wraps)
    for tree, points in enumerate(roots):
        held_by(room.search)[0][tree, :, : len(points)] = points.T
    room.search.counters[lane_nodes.SIZE] = len(roots[0])
    targets = np.concatenate([spread("even", 204, rng), roots[1][:100]]).astype(np.float32)
    nodes = np.zeros(len(targets), np.int64)
    state, search, words = room.search.buckets.state, room.words, pack(sampling)
    for size in (1500, 1600, 5000):  # some in buckets, some not; then more
        room.search.counters[lane_nodes.SIZE + 1] = size
        for tree, points in ((0, roots[0]), (1, roots[1][:size])):
            least = apart(points[None], targets[:, None], wraps).min(axis=1)
            for asked in (nearest_nodes, nearest_nodes_of_samples):
                nodes[:] = -1
                asked(search, words, tree, targets, nodes)
                np.testing.assert_allclose(apart(points[nodes], targets, wraps), least, atol=1e-5)
        assert state[KNOWN] == 0
        assert size - state[STATE + KNOWN] < lane_nodes.LATE
    buckets = room.search.buckets
    filled, members = buckets.filled[buckets.n :], buckets.members[buckets.n * BUCKET :].reshape(-1, BUCKET)
    held = [members[i, : filled[i]] for i in range(state[STATE + 1])]
    np.testing.assert_array_equal(np.sort(np.concatenate(held)), np.arange(state[STATE + KNOWN]))


def test_memory_for_as_many_nodes_as_are_examined_one_by_one_has_buckets() -> None:
    """512 goals under path constraints make such a tree, and it may be full."""
    rng, size = np.random.default_rng(0), lane_nodes.LATE
    room, points = _TreeMemory.build(5, size), spread("even", size, rng).astype(np.float32)
    held_by(room.search)[0][0, :, :size] = points.T
    room.search.counters[lane_nodes.SIZE] = size
    targets, nodes = spread("even", 50, rng).astype(np.float32), np.zeros(50, np.int64)
    assert len(room.search.buckets.filled) > 0
    sampling = sampling_of(0.0 * WRAPS)
    nearest_nodes(room.words, pack(sampling), 0, targets, nodes)
    np.testing.assert_array_equal(nodes, apart(points[None], targets[:, None], 0.0 * WRAPS).argmin(axis=1))
