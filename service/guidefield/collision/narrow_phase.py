"""The narrow phase: what Coal says of two bodies where they stand, asked for pair by pair.

Nothing is made of a pair before it is asked for. Answers don't depend on the questions before. A surface of very many
triangles is judged patch by patch, by those whose boxes are near enough.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import coal
import numpy as np

from guidefield.collision.penetration_depth import ClosestPoints, Outline, closest_points, measure_capsules
from guidefield.geometry.convex import as_met
from guidefield.scene.recipe import Patches


class CoalTransforms:
    """Transforms of a world's bodies; those of the robot's follow an array (r, 3, 4) [m] in which others write.

    `still` tells where one of the other bodies stands, by its index, a pinocchio.SE3.
    """

    def __init__(self, robot: np.ndarray, still: Callable[[int], Any]) -> None:
        self._rotations, self._translations, self._still = robot[:, :, :3], robot[:, :, 3], still
        self._made = [coal.Transform3s() for _ in robot]
        self._written, self._now = [-1] * len(robot), 0
        self._known: dict[int, Any] = {}
        self._moved: dict[int, Any] = {}

    def forget(self) -> None:
        """The robot's bodies stand elsewhere; those that were moved stand where they did."""
        self._now += 1
        if self._moved:
            self._moved.clear()

    def move(self, body: int, placement: Any) -> None:
        """Put one of the other bodies elsewhere, at a pinocchio.SE3, until `forget`."""
        self._moved[body] = transform(placement)

    def of(self, body: int) -> Any:
        """Where a body stands, a coal.Transform3s: of the robot's until `forget`, no longer."""
        if body < len(self._made):
            made = self._made[body]
            if self._written[body] != self._now:
                made.setTransform(self._rotations[body], self._translations[body])
                self._written[body] = self._now
            return made
        if body in self._moved:
            return self._moved[body]
        if body not in self._known:
            self._known[body] = transform(self._still(body))
        return self._known[body]


def transform(placement: Any) -> Any:
    """A placement (pinocchio.SE3) as Coal takes it."""
    return coal.Transform3s(np.array(placement.rotation), np.array(placement.translation))


_Meeting = tuple[int, int, int]  # indices of two bodies, and which patch of the second is meant

_ROUNDING = 1e-9  # what boxes about bodies are wider by, for rounding [m]


class NarrowPhase:
    """Coal's judgement of pairs of bodies; like the world that it belongs to it answers one question at a time.

    Unless points of contact are asked for, Coal (3.0.3, without a margin) overlooks boxes that overlap by centimetres
    where an axis of one lies along an axis of the other. So they are. A body's Coal shape, of one that doesn't move
    maybe patches, and its coal.Transform3s now are asked for by its index.
    """

    def __init__(self, shape: Callable[[int], Any], there: Callable[[int], Any]) -> None:
        self._shape, self._there = shape, there
        self._shapes: dict[int, Any] = {}
        self._boxes: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self._met: dict[_Meeting, tuple[Outline, Outline]] = {}
        self._outlines: dict[int, Outline] = {}  # by the identity of their shapes, which they keep alive
        self._collide: dict[_Meeting, Any] = {}
        self._measure: dict[_Meeting, Any] = {}
        self._request, self._result = coal.CollisionRequest(), coal.CollisionResult()
        self._distance_request = coal.DistanceRequest()

    def shape(self, body: int) -> Any:
        """A body's Coal shape."""
        if body not in self._shapes:
            self._shapes[body] = self._shape(body)
        return self._shapes[body]

    def penetration(self, first: int, second: int, margin: float = 0.0) -> float | None:
        """How far two bodies are apart [m] if they don't keep a margin [m], negative in contact; None if they keep it.

        For a margin below 0 Coal answers none where a body is a mesh.
        """
        if isinstance(patches := self.shape(second), Patches):
            for apart, patch in patches.nearest_first(*self._box_of(first, second)):
                if apart > margin:
                    break
                found = self._penetration((first, second, patch), margin)
                if found is not None:
                    return found
            return None
        return self._penetration((first, second, 0), margin)

    def _penetration(self, meeting: _Meeting, margin: float) -> float | None:
        first, second, _ = meeting
        if self._are_capsules(first, second):
            apart = self._distance(meeting).distance
            return apart if apart <= margin else None
        if meeting not in self._collide:
            self._collide[meeting] = coal.ComputeCollision(*(one.shape for one in self._as_met(meeting)))
        self._request.security_margin = self._request.distance_upper_bound = margin
        self._result.clear()
        self._collide[meeting](self._there(first), self._there(second), self._request, self._result)
        return float(self._result.getContact(0).penetration_depth) if self._result.isCollision() else None

    def distance(self, first: int, second: int) -> ClosestPoints:
        """The distance of two bodies, negative where convex ones overlap, with their closest points."""
        if not isinstance(patches := self.shape(second), Patches):
            return self._distance((first, second, 0))
        nearest: ClosestPoints | None = None
        for apart, patch in patches.nearest_first(*self._box_of(first, second)):
            if nearest is not None and apart > nearest.distance:
                break
            found = self._distance((first, second, patch))
            if nearest is None or found.distance < nearest.distance:
                nearest = found
        assert nearest is not None, "there is a patch"
        return nearest

    def _distance(self, meeting: _Meeting) -> ClosestPoints:
        first, second, _ = meeting
        if self._are_capsules(first, second):
            return measure_capsules(self.shape(first), self._there(first), self.shape(second), self._there(second))
        if meeting not in self._measure:
            self._measure[meeting] = coal.ComputeDistance(*(one.shape for one in self._as_met(meeting)))
        result = coal.DistanceResult()
        here, there = self._there(first), self._there(second)
        self._measure[meeting](here, there, self._distance_request, result)
        one, other = self._as_met(meeting)
        return closest_points(one, here, other, there, result)

    def _are_capsules(self, first: int, second: int) -> bool:
        return isinstance(self.shape(first), coal.Capsule) and isinstance(self.shape(second), coal.Capsule)

    def _as_met(self, meeting: _Meeting) -> tuple[Outline, Outline]:
        """The shapes as they meet; Coal's functors don't keep them alive."""
        if meeting not in self._met:
            first, second, patch = meeting
            other = self.shape(second)
            shapes = as_met(self.shape(first), other.shape(patch) if isinstance(other, Patches) else other)
            one, another = (self._outlines.setdefault(id(shape), Outline(shape)) for shape in shapes)
            self._met[meeting] = one, another
        return self._met[meeting]

    def _box_of(self, first: int, second: int) -> tuple[np.ndarray, np.ndarray]:
        """Corners of a box about a body's shape in the frame of another body, shapes (3,) [m]."""
        if first not in self._boxes:
            shape = self.shape(first)
            shape.computeLocalAABB()
            self._boxes[first] = np.array(shape.aabb_local.min_), np.array(shape.aabb_local.max_)
        low, high = self._boxes[first]
        here, there = self._there(first), self._there(second)
        rotation = there.getRotation().T @ here.getRotation()
        middle = here.getRotation() @ (0.5 * (low + high)) + here.getTranslation() - there.getTranslation()
        centre, reach = there.getRotation().T @ middle, np.abs(rotation) @ (0.5 * (high - low)) + _ROUNDING
        return centre - reach, centre + reach
