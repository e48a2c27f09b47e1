"""Groups of coordinates that a motion's clearance couples: those of different ones can be solved for apart."""

from __future__ import annotations

from guidefield.kernels.jit.no_refcount import uncounted
from guidefield.kernels.jit.signatures import Integers
from guidefield.kernels.linalg.banded_cholesky import TILE
from guidefield.kernels.optimize.clearance_model import ClearanceModel


@uncounted
def coupled_groups(model: ClearanceModel, constrained: bool, groups_out: Integers) -> None:
    """Find coordinates that are coupled anywhere on a motion. Limits couple none, and links far from all else neither.

    Args:
        model: The clearance; its Hessians are symmetric.
        constrained: Whether path constraints are kept: they couple all.
        groups_out: Gets where each group begins, multiples of `TILE` from 0 on, and behind the last nv.
    """
    nv, last = model.points.shape[1], groups_out.shape[0] - 2
    for t in range(last + 1):
        groups_out[t + 1] = last if constrained else t  # the last tile that one is coupled with
    for s in range(model.places):
        for p in range(nv):
            q, t = nv, p // TILE + 1
            past = (groups_out[t] + 1) * TILE
            while q > past and model.hessians[s, p, q - 1] == 0.0:
                q -= 1
            if q > past:
                groups_out[t] = (q - 1) // TILE
    g = past = 0
    for t in range(last + 1):
        past = max(past, groups_out[t + 1])
        if past == t:
            g += 1
            groups_out[g] = min((t + 1) * TILE, nv)
    groups_out[0] = 0
