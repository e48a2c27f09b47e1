"""Steps of vector kernels as kernels that Python can call: production calls them from kernels only."""

import numpy as np
from numba import int64, types, void

from guidefield.kernels.collide.layout import world_of
from guidefield.kernels.jit.arrays import FLOATS, FLOATS_OUT, INDICES, INDICES_OUT, Floats32
from guidefield.kernels.jit.decorators import make_kernel as kernel
from guidefield.kernels.kinematics.batch_forward_kinematics import BATCH_JOINTS, BatchJoints, batch_placements
from guidefield.kernels.simd.packing import Words, pointers
from guidefield.kernels.simd.vector import LANES
from guidefield.kernels.tree.informed_samples import sampling_of
from guidefield.kernels.tree.nodes import nearest, nearest_to_each, search_of
from guidefield.kernels.tree.rrt_connect import certain_hits

TARGETS = types.Array(types.float32, 2, "C")


@kernel(void(BATCH_JOINTS, FLOATS, FLOATS_OUT))
def placements_of_configurations(joints: BatchJoints, coordinates: Floats32, poses_out: Floats32) -> None:
    """`batch_placements`."""
    batch_placements(pointers(joints), pointers(coordinates), pointers(poses_out))


@kernel(void(INDICES, INDICES, int64, TARGETS, INDICES_OUT))
def nearest_nodes(search: Words, sampling: Words, tree: int, targets: np.ndarray, nodes_out: np.ndarray) -> None:
    """`nearest`: of each of some targets, shape (n, nv), the node of a tree, shape (n,)."""
    trees, sources = search_of(pointers(search)), sampling_of(pointers(sampling))
    for i in range(len(targets)):
        nodes_out[i] = nearest(trees, tree, pointers(targets[i]), sources)


@kernel(void(INDICES, INDICES, int64, TARGETS, INDICES_OUT))
def nearest_nodes_of_samples(
    search: Words, sampling: Words, tree: int, targets: np.ndarray, nodes_out: np.ndarray
) -> None:
    """The same by `nearest_to_each`, for sixteen targets at a time: n is a multiple of 16."""
    trees, sources = search_of(pointers(search)), sampling_of(pointers(sampling))
    for i in range(0, len(targets), LANES):
        for k in range(LANES):
            for j in range(trees.nv):
                trees.samples[j * LANES + k] = targets[i + k, j]
        nearest_to_each(trees, tree, sources)
        for k in range(LANES):
            nodes_out[i + k] = int(trees.nearest[k])


@kernel(int64(INDICES, types.float64, FLOATS, INDICES_OUT))
def hits_of_configurations(words: Words, clearance: float, coordinates: Floats32, hits: np.ndarray) -> int:
    """`certain_hits` in a world that is packed."""
    world = world_of(pointers(words))
    return certain_hits(world, clearance, pointers(coordinates), pointers(hits))
