"""Distance of two bodies made of convex parts: trees of balls, the nearer children first."""

from __future__ import annotations

import math

from numba import types

from guidefield.kernels.collide.balls import ball_radius
from guidefield.kernels.collide.gjk import PLACED
from guidefield.kernels.collide.gjk_scratch import (
    LEAF_A,
    LEAF_B,
    POSE_A,
    POSE_B,
    STACK,
    origins_apart,
    place_ball,
    place_part_of,
)
from guidefield.kernels.collide.parts import LEFT, RIGHT, Parts, child_of, is_leaf, part_of
from guidefield.kernels.jit.signatures import DOUBLE_POINTER, Floats, lane_step
from guidefield.kernels.prove.dividing import divides_first
from guidefield.kernels.prove.gjk_distance import FEW_ROUNDS, ROUNDS, parts_distance

SLACK = 5e-6
"""What is nearer than the nearest leaves that are known by no more isn't looked for: flat sides have many alike [m]."""

NODE_A, NODE_B, LEAST, ENTRY = range(4)
"""Numbers of an entry of the stack: a node of each body, and how far apart what they hold is at least [m]; then how
many there are."""


@lane_step(types.float64(*PLACED, *PLACED, types.float64, DOUBLE_POINTER))
def _apart_at_least(
    a: Parts, node_a: int, pose_a: Floats, b: Parts, node_b: int, pose_b: Floats, most: float, work: Floats
) -> float:
    """A bound of the distance of all that two nodes hold [m]; the distance itself of two leaves, up to `most`."""
    part_a, part_b = part_of(a, node_a), part_of(b, node_b)
    radius_a, radius_b = ball_radius(a.balls, node_a), ball_radius(b.balls, node_b)
    place_ball(a, node_a, pose_a, work, POSE_A)
    place_ball(b, node_b, pose_b, work, POSE_B)
    apart = -math.inf
    if radius_b < math.inf:
        apart = math.sqrt(origins_apart(work)) - float(radius_a + radius_b)
        if apart >= most or (part_a < 0 and part_b < 0):
            return apart
    radii = place_part_of(a, node_a, pose_a, work, POSE_A) + place_part_of(b, node_b, pose_b, work, POSE_B)
    rounds = ROUNDS if is_leaf(a, node_a) and is_leaf(b, node_b) else FEW_ROUNDS
    return max(apart, parts_distance(a, part_a, b, part_b, radii, -math.inf, most, rounds, work))


@lane_step(types.float64(*PLACED, *PLACED, types.float64, DOUBLE_POINTER))
def bodies_distance(
    a: Parts, root_a: int, pose_a: Floats, b: Parts, root_b: int, pose_b: Floats, most: float, work: Floats
) -> float:
    """Distance of two bodies [m].

    Args:
        a: Tables that the first body is in.
        root_a: Root of its tree of balls.
        pose_a: Its placement, rotation and translation row by row, shape (12,) [m].
        b: Tables that the second is in; only it may be a half-space.
        root_b: Its root.
        pose_b: Its placement, (12,).
        most: If they are farther apart than this, some bound of their distance that is no less than it is enough [m].
        work: Scratch, shape (WORK,); the search begins with the axis and the nearest leaves in it, and leaves its last
            ones.

    Returns:
        The distance, at most `SLACK` and GJK's `ACCURACY` too large, or that bound; not above 0 where they touch.
    """
    best, top = most, STACK + ENTRY
    work[STACK + NODE_A], work[STACK + NODE_B], work[STACK + LEAST] = root_a, root_b, -math.inf
    if work[LEAF_A] > 0.0:
        node_a, node_b = int(work[LEAF_A]) - 1, int(work[LEAF_B]) - 1
        best = min(best, _apart_at_least(a, node_a, pose_a, b, node_b, pose_b, best, work))
        if best <= 0.0 or (node_a == root_a and node_b == root_b):
            return best
    first = True
    while top > STACK:
        top -= ENTRY
        node_a, node_b = int(work[top + NODE_A]), int(work[top + NODE_B])
        if work[top + LEAST] >= best - SLACK:
            continue
        leaves = is_leaf(a, node_a) and is_leaf(b, node_b)
        if first or leaves:
            first = False
            apart = _apart_at_least(a, node_a, pose_a, b, node_b, pose_b, best, work)
            if apart >= best - (0.0 if leaves else SLACK):
                continue
            if leaves:
                best = apart
                work[LEAF_A], work[LEAF_B] = node_a + 1, node_b + 1
                if best <= 0.0:
                    return best
                continue
        split_a, left, right = divides_first(a, node_a, b, node_b), top, top + ENTRY
        for side in (LEFT, RIGHT):
            child_a = child_of(a, node_a, side) if split_a else node_a
            child_b = node_b if split_a else child_of(b, node_b, side)
            at, least = left if side == LEFT else right, -math.inf
            # what two leaves keep is found when it is their turn: the other child may have come closer by then
            if not (is_leaf(a, child_a) and is_leaf(b, child_b)):
                least = _apart_at_least(a, child_a, pose_a, b, child_b, pose_b, best, work)
            work[at + NODE_A], work[at + NODE_B], work[at + LEAST] = child_a, child_b, least
        if work[left + LEAST] < work[right + LEAST]:  # the nearer child on top
            for k in range(ENTRY):
                work[left + k], work[right + k] = work[right + k], work[left + k]
        top = right + ENTRY
    return best
