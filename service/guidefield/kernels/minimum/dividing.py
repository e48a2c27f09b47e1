"""Which of two nodes is divided where both together don't tell."""

from __future__ import annotations

from guidefield.kernels.collide.parts import Parts, is_leaf, part_of, splits_first
from guidefield.kernels.jit.signatures import lane_part


@lane_part
def divides_first(a: Parts, node_a: int, b: Parts, node_b: int) -> bool:
    """Whether of two nodes, not both leaves, the first is the one to divide: one that is but a ball before a part.

    A ball tells little, as parts are much thinner: with the larger one first, as `splits_first` has it, the nodes of a
    UR5's own pairs are more than twice as many.
    """
    if is_leaf(a, node_a) or is_leaf(b, node_b) or (part_of(a, node_a) < 0) == (part_of(b, node_b) < 0):
        return splits_first(a, node_a, b, node_b)
    return part_of(a, node_a) < 0
