"""A cache of the solids of meshes: the hull, the cover and the convex parts of a mesh are found from the same one."""

from __future__ import annotations

import hashlib
from collections.abc import Callable

from guidefield.bounded_map import BYTES_PER_SOLID_FACE, SOLIDS, BoundedMap
from guidefield.geometry.coarse import coarse_solid
from guidefield.geometry.nested import filled
from guidefield.geometry.solid import Solid, solid
from guidefield.geometry.surfaces import Floats, Integers

_SOLIDS: BoundedMap[tuple[object, ...], Solid] = BoundedMap(SOLIDS)


def solid_of_mesh(vertices: Floats, triangles: Integers, widest_gap: float) -> Solid:
    """Return `solid` of these arguments, from the cache if it is there."""
    return _find((_digest(vertices, triangles), widest_gap), lambda: _solid(vertices, triangles, widest_gap))


def near_solid_of_mesh(vertices: Floats, triangles: Integers, widest_gap: float) -> Solid:
    """Return the `coarse_solid` of a mesh, from the cache if it is there; `solid_of_mesh` if it has none."""

    def build() -> Solid:
        return coarse_solid(vertices, triangles) or solid_of_mesh(vertices, triangles, widest_gap)

    return _find((_digest(vertices, triangles), widest_gap, "near"), build)


def filled_solid_of_mesh(vertices: Floats, triangles: Integers, widest_gap: float) -> Solid:
    """Return the `filled` near solid of these arguments, from the cache if it is there."""

    def fill() -> Solid:
        return filled(near_solid_of_mesh(vertices, triangles, widest_gap))

    return _find((_digest(vertices, triangles), widest_gap, "filled"), fill)


def clear_solids() -> None:
    """Empty the cache, when all that needs the solids of a robot has been found."""
    _SOLIDS.clear()


def _solid(vertices: Floats, triangles: Integers, widest_gap: float) -> Solid:
    """Build a solid; one that is closed without its gaps is the same with them."""
    if widest_gap > 0.0 and (closed := _SOLIDS.get((_digest(vertices, triangles), 0.0))) is not None and closed.closed:
        return closed
    return solid(vertices, triangles, widest_gap)


def _find(key: tuple[object, ...], build: Callable[[], Solid]) -> Solid:
    return _SOLIDS.find(key, build, lambda one: BYTES_PER_SOLID_FACE * len(one.owners))


def _digest(vertices: Floats, triangles: Integers) -> bytes:
    digest = hashlib.sha256(vertices.tobytes())
    digest.update(triangles.tobytes())
    return digest.digest()
