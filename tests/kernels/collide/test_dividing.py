"""Which of two nodes is divided: of a tree over triangles, whose large nodes are but balls."""

from __future__ import annotations

import itertools

import numpy as np
from numba import boolean, types

from guidefield.collision.convex_parts import PartsTable
from guidefield.geometry.mesh_tree import mesh_tree
from guidefield.kernels.collide.gjk import divides_first
from guidefield.kernels.collide.parts import LEFT, LINK, OWN, PARTS, Parts
from guidefield.kernels.jit.compilers import kernel
from guidefield.kernels.simd.packing import pointers


@kernel(boolean(PARTS, types.int64, PARTS, types.int64))
def first_of(a: Parts, node_a: int, b: Parts, node_b: int) -> bool:
    """`divides_first` of two nodes."""
    return divides_first(pointers(a), node_a, pointers(b), node_b)


def many_triangles(seed: int) -> Parts:
    rng, table = np.random.default_rng(seed), PartsTable()
    table.add_tree(mesh_tree(rng.normal(size=(200, 1, 3)) + 0.1 * rng.normal(size=(200, 3, 3))))
    return table.tables()


def test_a_leaf_is_never_divided_and_a_ball_before_a_hull() -> None:
    a, b = many_triangles(1), many_triangles(2)
    links, others = a.links.reshape(-1, LINK), b.links.reshape(-1, LINK)
    inner = [np.flatnonzero(table[:, LEFT] >= 0) for table in (links, others)]
    balls = [nodes[table[nodes, OWN] < 0] for nodes, table in zip(inner, (links, others), strict=True)]
    hulls = [nodes[table[nodes, OWN] >= 0] for nodes, table in zip(inner, (links, others), strict=True)]
    leaves = [np.flatnonzero(table[:, LEFT] < 0)[:20] for table in (links, others)]
    assert all(len(nodes) > 2 for nodes in (*balls, *hulls)), "there are nodes of both kinds"
    for one, other in itertools.product(inner[0].tolist(), leaves[1].tolist()):
        assert first_of(a, one, b, other)
    for one, other in itertools.product(leaves[0].tolist(), inner[1].tolist()):
        assert not first_of(a, one, b, other)
    for one, other in itertools.product(balls[0].tolist(), hulls[1].tolist()):
        assert first_of(a, one, b, other)
    for one, other in itertools.product(hulls[0].tolist(), balls[1].tolist()):
        assert not first_of(a, one, b, other)
