"""The polygons of a scene, judged and triangulated together: one by one, NumPy's calls take a hundred times as long."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from guidefield.geometry.charged import convex_quads
from guidefield.geometry.surfaces import ears
from guidefield.scene.charges import Charges
from guidefield.scene.flat import FlatPolygons, are_bulging, crossing_edges, flat_polygons, flatness_faults


@dataclass(frozen=True, eq=False)
class Sheet:
    """A flat, simple polygon.

    Attributes:
        vertices: Its corners, shape (k, 3) [m, world].
        triangles: Shape (t, 3); they turn as the corners do.
        box: Lower and upper corner of the box about it, shape (2, 3) [m, world].
        charges: Its share of the field, for a charge of 1 per area.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    box: np.ndarray
    charges: Charges


def build_sheets(outlines: Sequence[Sequence[Sequence[float]]]) -> list[Sheet | str]:
    """Build sheets from the corners of polygons, or tell the fault of what is none."""
    by_count: dict[int, list[int]] = defaultdict(list)
    for index, outline in enumerate(outlines):
        by_count[len(outline)].append(index)
    built: list[Sheet | str] = [""] * len(outlines)
    for indices in by_count.values():
        polygons = flat_polygons(np.array([outlines[index] for index in indices], float))
        for index, sheet in zip(indices, _build(polygons), strict=True):
            built[index] = sheet
    return built


def _build(polygons: FlatPolygons) -> list[Sheet | str]:
    faults = flatness_faults(polygons)
    flat = np.delete(np.arange(len(polygons.areas)), list(faults))
    for row, (one, other) in crossing_edges(FlatPolygons(*(array[flat] for array in polygons))).items():
        faults[int(flat[row])] = f"its edges {one} and {other} meet: it isn't simple"
    bulging, (quads, rests) = are_bulging(polygons.corners), convex_quads(polygons.vertices)
    boxes = np.stack([polygons.vertices.min(axis=1), polygons.vertices.max(axis=1)], axis=1)
    for array in (quads, rests, boxes):
        array.setflags(write=False)
    of_convex = None  # ears are clipped in the same order from all convex polygons
    built: list[Sheet | str] = []
    for index, vertices in enumerate(polygons.vertices):
        if index in faults:
            built.append(faults[index])
            continue
        triangles = of_convex if bulging[index] else None
        if triangles is None:
            try:
                triangles = ears(polygons.corners[index], float(polygons.areas[index]))
            except ValueError as error:
                built.append(str(error))
                continue
            triangles.setflags(write=False)
        if bulging[index]:
            of_convex = triangles if len(triangles) == len(vertices) - 2 else None  # else a corner was left out
            charges = Charges(triangles=rests[index], quads=quads[index])
        else:
            charges = Charges(triangles=vertices[triangles])
        built.append(Sheet(vertices, triangles, boxes[index], charges))
    return built
