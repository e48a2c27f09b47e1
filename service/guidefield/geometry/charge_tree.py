"""Faces in blocks that share corners, and the trees over them whose nodes stand for all below, far away."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from guidefield.geometry.surfaces import Floats, Integers
from guidefield.kernels.field.field_tables import AREA, CHARGE, CHARGE_PER_AREA, MOMENTS, NODE_COLUMNS

LEAF = 48
"""Most faces of a block in a tree, where expansions stand for those that are far."""

BLOCK = 128
"""Most faces of a block elsewhere: the more, the more share a corner, as long as they fit into the fastest cache."""

LEAST_FACES = 1000
"""Surfaces of fewer faces are only cut in blocks: a tree doesn't pay."""


class Cluster(NamedTuple):
    """A node: the faces below it, and the node after all of them.

    Attributes:
        faces: Indices of faces.
        skip: Index of the next node that is not below this one.
        leaf: Whether its faces are a block.
        expandable: Whether an expansion may stand for it.
    """

    faces: Integers
    skip: int
    leaf: bool
    expandable: bool


def clusters(centroids: Floats, owners: Integers, least_faces: float) -> list[Cluster]:
    """Nodes in depth-first order over all faces, a tree for each owner; halves across the longest extent.

    Args:
        centroids: Of the faces, shape (n, 3) [m].
        owners: Which surface each face belongs to, shape (n,).
        least_faces: Surfaces of fewer have leaves only.
    """
    nodes: list[Cluster] = []
    for owner in np.unique(owners):
        faces = np.flatnonzero(owners == owner)
        _split(nodes, faces, centroids, len(faces) >= least_faces)
    return nodes


def _split(nodes: list[Cluster], faces: Integers, centroids: Floats, expandable: bool) -> None:
    at = len(nodes)
    if len(faces) <= (LEAF if expandable else BLOCK):
        nodes.append(Cluster(faces, at + 1, True, expandable))
        return
    inner = expandable
    if inner:
        nodes.append(Cluster(faces, 0, False, True))
    here = centroids[faces]
    axis = int(np.argmax(np.ptp(here, axis=0)))
    order = np.argsort(here[:, axis], kind="stable")
    middle = len(faces) // 2
    _split(nodes, faces[order[:middle]], centroids, expandable)
    _split(nodes, faces[order[middle:]], centroids, expandable)
    if inner:
        nodes[at] = Cluster(faces, len(nodes), False, True)


def expansion(corners: Floats, charge: float) -> tuple[Floats, float, float]:
    """A node's row: centre of charge, charge, second moments, area vector; its radius [m]; tr Q / (q radius^2).

    Args:
        corners: Of the triangles below, shape (n, 3, 3) [m].
        charge: Per area of all of them.
    """
    across = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(across, axis=1)
    q = float(areas.sum()) * charge
    centre = (areas[:, None] * corners.mean(axis=1)).sum(axis=0) / areas.sum()
    v = corners - centre
    total = v.sum(axis=1)
    moments = np.einsum("n,nki,nkj->ij", areas * (charge / 12.0), v, v)
    moments += np.einsum("n,ni,nj->ij", areas * (charge / 12.0), total, total)
    radius = float(np.linalg.norm(v, axis=2).max())
    row = np.zeros(NODE_COLUMNS)
    row[:CHARGE], row[CHARGE] = centre, q
    row[MOMENTS:AREA] = moments[np.triu_indices(3)]
    row[AREA:CHARGE_PER_AREA] = across.sum(axis=0)
    row[CHARGE_PER_AREA] = charge
    spread = float(np.trace(moments)) / (q * radius**2) if q > 0.0 else 1.0
    return row, radius, spread


Opening = Callable[[Floats, Floats], Floats]
"""From radii and spreads of nodes the distances from which their expansions are used, all of shape (n,) [m]."""


def never(radii: Floats, _spreads: Floats) -> Floats:
    """No expansion at all: every face counts by itself.

    Args:
        radii: Of the nodes, shape (n,) [m].
        _spreads: Of their charge, shape (n,).

    Returns:
        From which distance on a node may stand for what is below it, shape (n,) [m]: infinity.
    """
    return np.full(len(radii), np.inf)


def at_angle(theta: float) -> Opening:
    """Expand nodes of at most `theta` times their distance.

    Largest errors found over meshes of 1000 to 80 000 triangles: 0.1: 3e-5, 0.2: 5e-4, 0.3: 7e-3 of the potential, and
    twice that of the gradient.
    """
    return lambda radii, _: radii / theta


def within(error: float) -> Opening:
    """Expand nodes where the potential can't be off by more than a share of it, whatever the faces.

    From |x - s|^-3 = sum_k C_k(cos) |s|^k / |x|^(k+3), |C_k| <= (k+1)(k+2)/2, with theta = radius/|x|: the relative
    error is at most (1 + theta)^3 spread ((1 - theta)^-3 - 1 - 3 theta - 6 theta^2). As all terms of the potential are
    positive the sum over nodes is as good. What is found is a hundred times less: see `at_angle`.
    """

    def reach(radii: Floats, spreads: Floats) -> Floats:
        low, high = np.zeros(len(radii)), np.full(len(radii), 0.999)
        for _ in range(60):
            theta = 0.5 * (low + high)
            # The bracket, without its cancellation where theta is small.
            rest = theta**3 * (10.0 - 15.0 * theta + 6.0 * theta**2) / (1.0 - theta) ** 3
            fits = (1.0 + theta) ** 3 * spreads * rest <= error
            low, high = np.where(fits, theta, low), np.where(fits, high, theta)
        found: Floats = radii / np.maximum(low, 1e-12)
        return found

    return reach
