"""The size of a robot: chosen lengths are stated for a usual arm, and grow and shrink with a robot.

A Panda, a UR5, a Fetch and a Baxter reach 1.1 to 1.5 m, and all lengths were chosen with them. So robots of about their
reach have the size 1, to the last bit; others the ratio of their reach to a usual one. What a user gives, and what is
promised in metres, stays as it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from guidefield.geometry.cache import Arrays

USUAL_REACH = 1.15  # reach of a robot of size 1 [m]

LEAST_USUAL, MOST_USUAL = 0.75, 2.5
"""Robots that reach no less and no more than this have that size, too [m]: those that lengths were chosen with."""

USUAL_RADIUS, LEAST_RADIUS, MOST_RADIUS = 0.25, 0.05, 1.0
"""The same of robots of which nothing but the root turns, such as a gantry, a box that slides or one that flies: how
far the corners of their largest body are from its middle [m]. How far they go is no matter of their size."""

POINT = 1e-5  # robots that extend less far are points, as bodies of size zero are, and have the size 1 [m]

MARGIN = 2e-3
"""What bodies keep from each other beyond the distance that is asked for, wherever this house chooses [m], at size 1.

It is 200 times the certificate's floor, and next to nothing of free space. With it the certificate refuses a tenth as
many of a tree's shortened paths as without; they are 0.5 % longer (`tools/bench connect`). For shortcuts end where they
graze something, and samples overlook corners. Steps of the guided planner keep it, motions among moving obstacles, the
lowest floor of the optimiser, and links that the stated rest has in contact.
"""


def find_size(model: Any, geometry: Any, meshes: Mapping[str, np.ndarray]) -> float:
    """Return the size of a robot: 1 where its reach is usual, else the ratio of its reach to `USUAL_REACH`.

    `meshes` are vertices (v, 3) [m] of the shapes that stand for meshes, in their own frames, by name.
    """
    names = [joint.shortname() for joint in model.joints]
    if all(name in FREE or name.startswith("JointModelP") for name in names[1:]):
        corners = [_find_corners(shape, meshes) for shape in geometry.geometryObjects if shape.parentJoint > 0]
        radius = max((0.5 * float(np.linalg.norm(np.ptp(one, axis=0))) for one in corners), default=0.0)
        return 1.0 if radius < POINT or LEAST_RADIUS <= radius <= MOST_RADIUS else radius / USUAL_RADIUS
    reach = _find_reach(model, geometry, meshes)
    return 1.0 if reach < POINT or LEAST_USUAL <= reach <= MOST_USUAL else reach / USUAL_REACH


FREE = ("JointModelPlanar", "JointModelFreeFlyer")  # Pinocchio's names of joints that turn a whole robot


def _find_reach(model: Any, geometry: Any, meshes: Mapping[str, np.ndarray]) -> float:
    """Return how far a robot extends at most from the first joint of a chain that turns [m]."""
    along, turns = np.zeros(model.njoints), np.zeros(model.njoints, bool)
    for joint in range(1, model.njoints):
        parent, name = model.parents[joint], model.joints[joint].shortname()
        turns[joint] = turns[parent] or name in FREE or not name.startswith("JointModelP")
        if turns[parent]:
            along[joint] = along[parent] + np.linalg.norm(model.jointPlacements[joint].translation)
    reach = 0.0
    for frame in model.frames:
        if turns[frame.parentJoint]:
            reach = max(reach, float(along[frame.parentJoint] + np.linalg.norm(frame.placement.translation)))
    for shape in geometry.geometryObjects:
        if turns[shape.parentJoint]:
            placed = _find_corners(shape, meshes) @ shape.placement.rotation.T + shape.placement.translation
            reach = max(reach, float(along[shape.parentJoint] + np.linalg.norm(placed, axis=1).max()))
    return reach


def _find_corners(shape: Any, meshes: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the corners (8, 3) of the box about a shape along the axes of its own frame [m]."""
    if shape.name in meshes:
        low, high = meshes[shape.name].min(axis=0), meshes[shape.name].max(axis=0)
    else:
        shape.geometry.computeLocalAABB()
        low, high = shape.geometry.aabb_local.min_, shape.geometry.aabb_local.max_
    return np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)


def scale(arrays: Arrays, factor: float, *names: str) -> Arrays:
    """Return arrays of which some, by name, are multiplied by a factor; they themselves if that is 1."""
    return arrays if factor == 1.0 else {**arrays, **{name: factor * arrays[name] for name in names}}


def power_of_two(size: float) -> float:
    """Return the power of two next to a size: lengths are divided and multiplied by it without rounding."""
    return float(np.exp2(np.round(np.log2(size))))
