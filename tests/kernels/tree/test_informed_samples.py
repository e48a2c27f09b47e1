"""What trees draw and find: samples, the nearest node by brute force, and the sieve of spheres against Coal."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numba import int64, types, void

from guidefield.collision.clearance import clearance_at
from guidefield.kernels.jit.arrays import FLOATS, INDICES, VECTOR_OUT, Floats, Floats32
from guidefield.kernels.jit.decorators import make_kernel as kernel
from guidefield.kernels.simd.packing import Words, pack, pointers
from guidefield.kernels.simd.vector import LANES
from guidefield.kernels.tree import nodes as tree_nodes
from guidefield.kernels.tree.informed_samples import (
    NEAR,
    Sampling,
    StraightPath,
    next_samples,
    pass_samples,
    sampling_of,
)
from guidefield.kernels.tree.kd_buckets import BUCKET, KNOWN, STATE
from guidefield.kernels.tree.rrt_connect import SIEVE
from guidefield.planner.tree_search import _TreeMemory, held_by
from tests.collision.batch.test_batch_collision import draw, world_of
from tests.kernels.collide.batch_callers import hits_of_configurations, nearest_nodes, nearest_nodes_of_samples


@kernel(void(INDICES, VECTOR_OUT, FLOATS, types.float64, int64, types.Array(types.float32, 2, "C")))
def drawn(words: Words, places: Floats, ends: Floats32, reach: float, used: int, samples_out: Floats32) -> None:
    sampling, nv = sampling_of(pointers(words)), len(ends) // 2
    path = StraightPath(pointers(ends), 0, nv, 1, reach)
    for batch in range(len(samples_out)):
        next_samples(sampling, nv, pointers(places), path, pointers(samples_out[batch]))
        pass_samples(sampling, nv, pointers(places), used)


def steps_of(count: int) -> np.ndarray:
    """Powers of the number whose multiples fill a box of so many sides evenly."""
    g = np.roots([1.0, *[0.0] * (count - 1), -1.0, -1.0])
    return g[np.abs(g.imag) < 1e-9].real.max() ** -np.arange(1.0, count + 1.0)


def sequence(
    lower: np.ndarray, width: np.ndarray, period: np.ndarray, ends: np.ndarray, reach: float, batches: int
) -> tuple[np.ndarray, np.ndarray]:
    """Samples (n, nv) near the way between two points (2, nv), and the places (n, nv + 1) they come from."""
    nv = len(lower)
    frequency = np.where(period > 0.0, 1.0 / np.where(period > 0.0, period, 1.0), 0.0).astype(np.float32)
    begin, samples = np.linspace(0.3, 0.7, nv + 1), np.empty((batches, nv * LANES), np.float32)
    sampling = Sampling(
        steps_of(nv + 1),
        lower,
        width,
        period.astype(np.float32),
        frequency,
        np.ones(nv, np.float32),
        0,
        np.zeros(0, np.int64),
    )
    drawn(pack(sampling), begin.copy(), ends.astype(np.float32).ravel(), reach, LANES, samples)
    places = (begin + np.arange(1.0, batches * LANES + 1.0)[:, None] * steps_of(nv + 1)) % 1.0
    return samples.reshape(-1, nv, LANES).transpose(0, 2, 1).reshape(-1, nv).astype(float), places


TURN = 2.0 * np.pi


@settings(max_examples=12)
@given(seed=st.integers(0, 2**32 - 1), reach=st.floats(0.05, 20.0))
def test_a_sample_is_within_reach_of_its_point_of_the_path_and_within_the_limits(seed: int, reach: float) -> None:
    """As NumPy has it in double precision: limits, a narrow part of a turn, and two whole turns, one's ends far out."""
    rng = np.random.default_rng(seed)
    lower = np.array([-3.0, 1.0, -0.4, -np.pi, -np.pi])
    width = np.array([6.0, 0.2, 1.5, TURN, TURN])
    period = np.array([0.0, 0.0, TURN, TURN, TURN])
    ends = lower + rng.random((2, 5)) * width
    ends[1, 3:] = ends[0, 3:] + rng.uniform(-3.0, 3.0, 2)
    far = ends + np.array([[0.0, 0.0, 0.0, 0.0, 4.0], [0.0, 0.0, 0.0, -1.0, 3.0]]) * TURN
    samples, places = sequence(lower, width, period, far, reach, 6)
    near = places[:, 5] < NEAR
    middles = ends[0] + (places[:, 5] / NEAR)[:, None] * (ends[1] - ends[0])
    reaches = np.where(near, reach, np.inf)[:, None]
    least, most = np.maximum(middles - reaches, lower), np.minimum(middles + reaches, lower + width)
    half = np.minimum(reaches, np.pi)
    least[:, 3:], most[:, 3:] = (middles - half)[:, 3:], (middles + half)[:, 3:]
    off = samples - least - places[:, :5] * (most - least)
    off[:, 2:] -= TURN * np.rint(off[:, 2:] / TURN)
    clear = (np.abs(places[:, 5] - NEAR) > 1e-4) & ((places > 1e-4) & (places < 1.0 - 1e-4)).all(axis=1)
    assert np.abs(off[clear]).max() < 2e-4
    assert (samples[:, :3] >= lower[:3] - 1e-5).all()
    assert (samples[:, :3] <= (lower + width)[:3] + 1e-5).all()


def test_a_fixed_share_of_samples_fills_the_limits_evenly_whatever_the_path() -> None:
    """Of even samples in a box as many are in each of its boxes of a third of each side."""
    lower, width = np.array([-3.0, 0.0, -np.pi]), np.array([6.0, 1.0, TURN])
    ends = np.array([[-2.9, 0.1, 0.3], [-2.8, 0.1, -0.3]])
    samples, places = sequence(lower, width, np.array([0.0, 0.0, TURN]), ends, 0.05, 2500)
    wide = places[:, 3] >= NEAR
    assert abs(wide.mean() - (1.0 - NEAR)) < 1e-3
    cells = np.floor(3.0 * (((samples[wide] - lower) / width) % 1.0)).astype(int)
    counts = np.bincount(cells @ np.array([9, 3, 1]), minlength=27)
    assert np.abs(counts / counts.mean() - 1.0).max() < 0.05
    along = np.histogram(places[~wide, 3] / NEAR, 10, (0.0, 1.0))[0]
    assert np.abs(along / along.mean() - 1.0).max() < 0.01


WRAPS = np.array([0.0, 2.0 * np.pi, 0.0, 0.0, 2.0 * np.pi], np.float32)


def box_about(wraps: np.ndarray) -> Sampling:
    nv = len(wraps)
    frequency = np.array([0.0 if period == 0.0 else 1.0 / period for period in wraps], np.float32)
    return Sampling(
        np.zeros(nv), np.zeros(nv), np.ones(nv), wraps, frequency, np.ones(nv, np.float32), 0, np.zeros(0, np.int64)
    )


def apart(a: np.ndarray, b: np.ndarray, wraps: np.ndarray) -> np.ndarray:
    """Distances, angles the short way round, in double precision."""
    offset = a - b
    turns = wraps > 0.0
    offset[..., turns] = (offset[..., turns] + np.pi) % (2.0 * np.pi) - np.pi
    return np.linalg.norm(offset, axis=-1)


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
    memory, sampling = _TreeMemory.build(5, 8192), box_about(wraps)
    for tree, points in enumerate(roots):
        held_by(memory.search)[0][tree, :, : len(points)] = points.T
    memory.search.counters[tree_nodes.SIZE] = len(roots[0])
    targets = np.concatenate([spread("even", 204, rng), roots[1][:100]]).astype(np.float32)
    nodes = np.zeros(len(targets), np.int64)
    state, search, words = memory.search.buckets.state, memory.words, pack(sampling)
    for size in (1500, 1600, 5000):  # some in buckets, some not; then more
        memory.search.counters[tree_nodes.SIZE + 1] = size
        for tree, points in ((0, roots[0]), (1, roots[1][:size])):
            least = apart(points[None], targets[:, None], wraps).min(axis=1)
            for asked in (nearest_nodes, nearest_nodes_of_samples):
                nodes[:] = -1
                asked(search, words, tree, targets, nodes)
                np.testing.assert_allclose(apart(points[nodes], targets, wraps), least, atol=1e-5)
        assert state[KNOWN] == 0
        assert size - state[STATE + KNOWN] < tree_nodes.LATE
    buckets = memory.search.buckets
    filled, members = buckets.filled[buckets.n :], buckets.members[buckets.n * BUCKET :].reshape(-1, BUCKET)
    held = [members[i, : filled[i]] for i in range(state[STATE + 1])]
    np.testing.assert_array_equal(np.sort(np.concatenate(held)), np.arange(state[STATE + KNOWN]))


def test_memory_for_as_many_nodes_as_are_examined_one_by_one_has_buckets() -> None:
    """512 goals under path constraints make such a tree, and it may be full."""
    rng, size = np.random.default_rng(0), tree_nodes.LATE
    memory, points = _TreeMemory.build(5, size), spread("even", size, rng).astype(np.float32)
    held_by(memory.search)[0][0, :, :size] = points.T
    memory.search.counters[tree_nodes.SIZE] = size
    targets, nodes = spread("even", 50, rng).astype(np.float32), np.zeros(50, np.int64)
    assert len(memory.search.buckets.filled) > 0
    sampling = box_about(0.0 * WRAPS)
    nearest_nodes(memory.words, pack(sampling), 0, targets, nodes)
    np.testing.assert_array_equal(nodes, apart(points[None], targets[:, None], 0.0 * WRAPS).argmin(axis=1))


@pytest.mark.parametrize("robot", ["panda", "ur5"])
@pytest.mark.parametrize("clearance", [0.0, 0.02])
def test_what_is_hit_touches(robot: str, clearance: float) -> None:
    world, batch = world_of(robot, "zoo")
    hits, seen, missed = np.full(3 * SIEVE, -1, np.int64), 0, 0
    zs = draw(world.group, 640, 3)
    touching = batch.touching(zs, clearance)
    for block, touches in zip(zs.reshape(-1, LANES, zs.shape[1]), touching.reshape(-1, LANES), strict=True):
        mask = hits_of_configurations(batch.words, clearance, block.T.astype(np.float32).ravel(), hits)
        hit = np.array([mask >> k & 1 for k in range(LANES)], bool)
        assert not (hit & ~touches).any()
        for z in block[hit][:2]:
            assert clearance_at(world, world.group.expand_from_local(z)).obstacle_distance < clearance + 1e-5
        seen += hit.sum()
        missed += (touches & ~hit).sum()
    assert seen > 100
    assert (hits.reshape(-1, 3)[0] >= 0).all()
    assert seen > missed
