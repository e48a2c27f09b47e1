"""The solids of a closed mesh: its connected pieces, each with the hollows within it."""

from __future__ import annotations

import numpy as np

from guidefield.geometry.charged import field_tables
from guidefield.geometry.closed import connected_pieces, volumes
from guidefield.kernels.field.field import field_at_points


def solids_of(vertices: np.ndarray, triangles: np.ndarray) -> list[np.ndarray]:
    """Triangles of each solid: a connected piece that encloses a volume, with the hollows that lie within it.

    Args:
        vertices: Shape (v, 3) [m].
        triangles: Of a closed mesh, counter-clockwise from outside, shape (t, 3).
    """
    labels = connected_pieces(len(vertices), triangles)[triangles[:, 0]]
    if (labels == labels[0]).all():
        return [triangles]
    order = np.argsort(labels, kind="stable")
    parts = np.split(triangles[order], np.flatnonzero(np.diff(labels[order])) + 1)
    enclosed = volumes(vertices, parts)
    solids = [parts[index] for index in np.argsort(enclosed, kind="stable").tolist() if enclosed[index] > 0.0]
    hollows = [part for part, within in zip(parts, enclosed, strict=True) if within <= 0.0]
    found: list[list[np.ndarray]] = [[solid] for solid in solids]
    for hollow in hollows:
        inside = vertices[hollow[0]].mean(axis=0)[None]
        around = (k for k, solid in enumerate(solids) if _winding(vertices[solid], inside) > 0.5)
        # a hollow in nothing is the surface of everything else: it belongs to the largest
        found[next(around, len(solids) - 1)].append(hollow)
    return [np.concatenate(group) for group in found]


def _winding(corners: np.ndarray, point: np.ndarray) -> float:
    return float(field_at_points(field_tables(triangles=corners), point).winding[0])
