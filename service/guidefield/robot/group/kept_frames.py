"""The path constraints of a motion as the kernels want them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from guidefield.kernels.kinematics.tip_chain import TipChain
from guidefield.kernels.tree.path_constraints import CONE, EVEN_TURN, NEAR, VECTORS, KeptFrames
from guidefield.memo import memoized
from guidefield.read_only import read_only
from guidefield.robot.group.path_constraints import Cone, ConstrainedFrames, EvenTurn, Near, PathConstraint
from guidefield.robot.group.tip_chain import chain_to

_KINDS: Mapping[type, int] = MappingProxyType({Cone: CONE, Near: NEAR, EvenTurn: EVEN_TURN})


@memoized
def kept_frames(frames: ConstrainedFrames) -> KeptFrames:
    """The constraints, each with the chain of joints that moves its frame; there may be none."""
    assert not frames.constraints or frames.group.is_euclidean, "path constraints are for joints of one coordinate"
    chains = [chain_to(frames.group, frame) for frame in frames.indices]
    group = frames.group
    made = KeptFrames(
        kinds=np.array([_KINDS[type(one)] for one in frames.constraints], np.int64),
        vectors=np.array([_vectors(one) for one in frames.constraints]).reshape(-1, VECTORS),
        limits=frames.limits.copy(),
        begins=np.cumsum([0, *(len(one.kinds) for one in chains)]),
        firsts=np.array([one.first for one in chains]).reshape(-1, 12),
        sames=np.array([frames.indices.index(frame) for frame in frames.indices], np.int64),
        chain=TipChain(
            kinds=np.concatenate([np.empty(0, np.int64), *(one.kinds for one in chains)]),
            drivers=np.concatenate([np.empty(0, np.int64), *(one.drivers for one in chains)]),
            scales=np.concatenate([np.empty((0, 2)), *(one.scales for one in chains)]),
            placements=np.concatenate([np.empty((0, 12)), *(one.placements for one in chains)]),
            first=np.zeros(12),
            lower=group.lower,
            upper=group.upper,
        ),
    )
    read_only(*made[:6], *made.chain)
    return made


def _vectors(constraint: PathConstraint) -> np.ndarray:
    """The columns of vectors of a constraint, shape (VECTORS,)."""
    row = np.zeros(VECTORS)
    match constraint:
        case Cone(axis=axis, target=target):
            row[:6] = *axis, *target
        case Near(point=point, across=across):
            row[: 3 + across.size] = *point, *across.ravel()
        case EvenTurn(begin=begin, turn=turn):
            row[:] = *begin.translation, *constraint.by_place, *turn, *begin.rotation.ravel()
        case _:
            raise TypeError(f"{type(constraint).__name__} is no path constraint")
    return row
