"""Broad phase: whether any pair touches at all, by the boxes about bodies first."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.robot.model.shapes import triangulation
from guidefield.scene.mesh import bvh

MANY_BODIES = 250
"""From here on a tree of boxes finds close bodies faster than comparing every two boxes does (measured)."""

_THICKNESS = 1e-9
"""What a flat body is thickened by [m]."""


def broad_phase(model: Any, geometry: Any, scratch: Any) -> Any:
    """Pinocchio's manager that answers for the pairs of a geometry model; margins in the scratch space count.

    Naive or one tree: of Pinocchio's others, those with an array of boxes overlook contacts (seen with version 4.1.0).
    """
    if geometry.ngeoms > MANY_BODIES:
        return pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(model, geometry, scratch)
    return pin.BroadPhaseManager_NaiveCollisionManager(model, geometry, scratch)


def thickened(shape: Any) -> Any:
    """The shape; or one a hair thicker, if the box about it has no volume: Pinocchio's managers overlook such shapes.

    A mesh gets a vertex off its plane that no triangle uses, so that its triangles stay as they are.
    """
    shape.computeLocalAABB()
    low, high = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
    if shape.aabb_local.volume() > 0.0:
        return shape
    if isinstance(shape, coal.BVHModelBase):
        vertices, triangles = triangulation(shape)
        return bvh(np.vstack([vertices, np.where(high > low, high, high + _THICKNESS)]), triangles)
    copy = shape.clone()
    copy.setSweptSphereRadius(_THICKNESS)
    copy.computeLocalAABB()
    return copy
