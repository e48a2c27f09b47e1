"""Coal shapes as they are to meet each other."""

from __future__ import annotations

from typing import Any

import coal


def as_met(first: Any, second: Any) -> tuple[Any, Any]:
    """Two Coal shapes as they are to meet: a ball meets a mesh as a capsule without length.

    Coal (3.0.3) finds balls in contact with triangles without area at one place in ten, however far they are.
    """
    if isinstance(first, coal.Sphere) and isinstance(second, coal.BVHModelBase):
        return _capsule(first), second
    if isinstance(second, coal.Sphere) and isinstance(first, coal.BVHModelBase):
        return first, _capsule(second)
    return first, second


def all_as_met(geometry: Any) -> Any:
    """A pinocchio.GeometryModel with the same pairs, whose balls are such capsules if there is a mesh among its shapes.

    Where there is none, it is the model itself.
    """
    shapes = [shape.geometry for shape in geometry.geometryObjects]
    if not any(isinstance(shape, coal.BVHModelBase) for shape in shapes):
        return geometry
    made = geometry.copy()
    for shape in made.geometryObjects:
        if isinstance(shape.geometry, coal.Sphere):
            shape.geometry = _capsule(shape.geometry)
    return made


def _capsule(ball: Any) -> Any:
    return coal.Capsule(ball.radius, 0.0)
