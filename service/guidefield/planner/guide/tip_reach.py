"""The tip's size, the arm's reach, planes that are out of reach, and the inset at which the tip crosses planes.

A plane that `explain_unreachable` names is refused without a search, so its bounds must hold: the reach may be larger,
never too small. With fewer `DIVISIONS` the way to a blocked plane is searched for in vain. The insets are a choice:
farther from a polygon's edges, or through more of it. A plane is refused as blocked if it is within `INSET`, which
service/docs/algorithm.md repeats.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import coal
import numpy as np

from guidefield.geometry.convex import balls_as_capsules
from guidefield.kernels.distance.distance import DistanceTables, distance_at_points
from guidefield.kernels.field.field_tables import frozen
from guidefield.planner.task.problem import Problem
from guidefield.robot.bodies.charges import robot_charges
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.kinematics import chain_to_tip
from guidefield.scene.distance_tables import distance_tables
from guidefield.scene.guide_plane import GuidePlane
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene

DIVISIONS = 6  # how often a plane's triangles are divided to see that none of its places is free
_ROUNDING = 1e-9  # added to a reach, for rounding [m]


def find_touched_obstacle(scene: Scene, centre: np.ndarray, radius: float) -> str | None:
    """Name of an obstacle that a ball about a centre (3,) [m, world] touches, or None."""
    ball = coal.Sphere(max(radius, 1e-9))
    at = coal.Transform3s(np.eye(3), np.asarray(centre, float))
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    for obstacle in scene.obstacles:
        result.clear()
        request.security_margin = obstacle.rounding
        there = coal.Transform3s(obstacle.placement.rotation, obstacle.placement.translation)
        for shape in _near(obstacle, np.asarray(centre, float), radius + obstacle.rounding):
            first, second = balls_as_capsules(shape, ball)
            if coal.collide(first, there, second, at, request, result):
                return obstacle.name
    return None


def _near(obstacle: Obstacle, centre: np.ndarray, reach: float) -> Iterator[Any]:
    """Coal shapes that are all of an obstacle that comes within reach of a place [m]."""
    patches = None if obstacle.facets is None else obstacle.facets.patches
    if patches is None:
        yield obstacle.shape
        return
    local = obstacle.placement.actInv(centre)
    for apart, patch in patches.nearest_first(local, local):
        if apart > reach + _ROUNDING:
            return
        yield patches.shape(patch)


INSET = 1.6  # the tip heads for the polygon inset by this many radii of its own
INSET_KEPT = 0.5  # share of that inset that it keeps while the motion is optimised (optimize/passages.py)


def inset_of(problem: Problem, plane: GuidePlane) -> float:
    """Distance that the tip keeps from a plane's edges [m]."""
    return min(INSET * tip_radius(problem), 0.8 * plane.inradius)


def inset_at(problem: Problem, plane: GuidePlane, tip: np.ndarray) -> float:
    """Distance that the tip keeps from a plane's edges [m], given its place (3,) there by the motion that was found."""
    return min(INSET_KEPT * inset_of(problem, plane), max(plane.depth(tip), 0.0))


def tip_radius(problem: Problem) -> float:
    """Radius of the body nearest to the tip, of those that move with it [m]: how far the tip stays inside an edge."""
    return _tip_radius(problem.group)


@memoized_for_alike
def _tip_radius(group: PlanningGroup) -> float:
    charges = robot_charges(group.robot)
    tip = group.model.frames[group.tip_id]
    nearest, radius = np.inf, 0.0
    for charged, shape in zip(charges.shapes, group.geometry.geometryObjects, strict=True):
        if shape.parentJoint == tip.parentJoint:
            distance = float(charged.capsule.distance(shape.placement.actInv(tip.placement).translation[None])[0])
            if distance < nearest:
                nearest, radius = distance, charged.capsule.radius
    return radius


def explain_unreachable(problem: Problem, plane: GuidePlane) -> tuple[str, dict[str, Any]] | None:
    """The reason why the tip can't cross a plane, if that is known without a search; else None."""
    radius = tip_radius(problem)
    if plane.inradius < radius:
        return (
            f"its inscribed radius is {1000 * plane.inradius:.1f} mm, the tip's body needs {1000 * radius:.1f} mm",
            {"inradius": plane.inradius, "tip_radius": radius},
        )
    base, reach = arm_reach(problem)
    nearest = float(np.linalg.norm(plane.closest_point(base) - base))
    if nearest > reach:
        return (
            f"its nearest point is {nearest:.3f} m from the robot's first joint, the arm reaches {reach:.3f} m",
            {"distance": nearest - reach, "reach": reach},
        )
    corners = plane.inset_vertices(inset_of(problem, plane))
    fan = np.stack([np.broadcast_to(plane.centroid, corners.shape), corners, np.roll(corners, -1, axis=0)], axis=1)
    blocking = find_touched_obstacle(problem.scene, plane.centroid, radius)
    if blocking is None or not _are_all_blocked(distance_tables(problem.world.scene), fan, radius):
        return None
    return "every place on it that the tip heads for is inside an obstacle", {"obstacle": blocking}


def _are_all_blocked(tables: DistanceTables, triangles: np.ndarray, radius: float) -> bool:
    """Return whether obstacles are within a radius of all places in triangles (n, 3, 3) [m]; False where undecided.

    A triangle is blocked if the distance at its middle leaves no place in it free; others are divided into four.
    """
    for _ in range(DIVISIONS):
        middles = triangles.mean(axis=1)
        apart = distance_at_points(tables, middles, 2.0 * radius)[0]
        if apart.max() > radius:
            return False
        spreads = np.linalg.norm(triangles - middles[:, None], axis=2).max(axis=1)
        a, b, c = np.moveaxis(triangles[apart + spreads > radius - _ROUNDING], 1, 0)
        if not len(a):
            return True
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        triangles = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return False


def arm_reach(problem: Problem) -> tuple[np.ndarray, float]:
    """Origin of the first planned joint, shape (3,) [m, world], and the sum of lengths to the tip [m]."""
    return _arm_reach(problem.group)


@memoized_for_alike
def _arm_reach(group: PlanningGroup) -> tuple[np.ndarray, float]:
    chain = chain_to_tip(group)
    return frozen(chain.table.first[3::4].copy()), chain.reach
