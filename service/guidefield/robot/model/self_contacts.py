"""Contacts of a robot with itself: bounding spheres and hulls tell most pairs apart before their meshes are asked."""

from __future__ import annotations

import warnings
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.geometry.convex import all_as_met
from guidefield.robot.model.shapes import hull
from guidefield.robot.model.spaces import RobotConfiguration


def collision_pairs(geometry: Any) -> np.ndarray:
    """Return the collision pairs of a geometry model in its order, shape (p, 2); a million take no second so."""
    places = np.triu(np.asarray(geometry.collisionPairMapping) + 1)
    first, second = np.nonzero(places)
    pairs: np.ndarray = np.column_stack([first, second])[np.argsort(places[first, second])]
    return pairs


def scratch_space(geometry: Any) -> Any:
    """Make Pinocchio's data for a geometry model, set so that answers are right, and don't depend on questions before.

    Unless points of contact are asked for, as Pinocchio doesn't, Coal (3.0.3, without a margin) overlooks boxes that
    overlap by centimetres where an axis of one lies along an axis of the other. And it starts each search where the
    last one ended, which changes the last digits of distances.
    """
    scratch = geometry.createData()
    count = len(scratch.collisionRequests)
    if count == 0:
        return scratch
    contact, distance = scratch.collisionRequests[0], scratch.distanceRequests[0]
    contact.enable_contact = True
    with warnings.catch_warnings():
        # Coal's newer field, `gjk_initial_guess`, does not switch off the older one, which Pinocchio switches on.
        warnings.simplefilter("ignore", DeprecationWarning)
        contact.enable_cached_gjk_guess = distance.enable_cached_gjk_guess = False
    # all pairs are asked alike; to set each by itself takes three times as long as all else here
    scratch.collisionRequests = _alike(coal.StdVec_CollisionRequest(), contact, count)
    scratch.distanceRequests = _alike(coal.StdVec_DistanceRequest(), distance, count)
    return scratch


def _alike(requests: Any, one: Any, count: int) -> Any:
    for _ in range(count):
        requests.append(one)
    return requests


ROUNDING = 1e-9  # by how much spheres about shapes are believed larger than they are, as a share
SLACK = 1e-6  # hulls have to be this much further apart than a margin to tell the meshes in them apart [m]


class SelfContacts:
    """Tests collision pairs of a geometry model for contact; `exact_tests` counts those whose meshes were asked."""

    def __init__(self, model: Any, geometry: Any) -> None:
        self.geometry = all_as_met(geometry)
        self.exact_tests = 0
        self._model, self._data = model, model.createData()
        self._geometry_data = scratch_space(self.geometry)
        shapes = [shape.geometry for shape in self.geometry.geometryObjects]
        for shape in shapes:
            shape.computeLocalAABB()
        self._centres = [np.array(shape.aabb_center) for shape in shapes]
        radii = np.array([shape.aabb_radius for shape in shapes])
        self._pairs = collision_pairs(self.geometry)
        self._reach = radii[self._pairs].sum(axis=1) * (1.0 + ROUNDING)
        self._hulls: dict[int, Any] = {}

    def place(self, q: RobotConfiguration) -> None:
        """Put the robot into a configuration, shape (nq,)."""
        pin.updateGeometryPlacements(self._model, self._data, self.geometry, self._geometry_data, q)

    def find_near(self, margin: float) -> list[int]:
        """Return the pairs, by their place in the model's list, whose bounding spheres are within a margin [m]."""
        there = zip(self._geometry_data.oMg, self._centres, strict=True)
        centres = np.array([placement.act(centre) for placement, centre in there]).reshape(-1, 3)
        apart = np.linalg.norm(centres[self._pairs[:, 0]] - centres[self._pairs[:, 1]], axis=1)
        near: list[int] = np.flatnonzero(~(apart > self._reach + 2.0 * margin)).tolist()
        return near

    def is_contact(self, pair: int, margin: float) -> bool:
        """Whether the shapes of a pair are no further apart than a margin [m]."""
        if self._hulls_apart(pair, margin):
            return False
        self.exact_tests += 1
        self._geometry_data.collisionRequests[pair].security_margin = margin
        return bool(pin.computeCollision(self.geometry, self._geometry_data, pair))

    def find_contacts(self, margin: float) -> list[int]:
        """Return the pairs that are no further apart than a margin [m]."""
        return [pair for pair in self.find_near(margin) if self.is_contact(pair, margin)]

    def _hulls_apart(self, pair: int, margin: float) -> bool:
        """Whether the hulls of a pair with a mesh are further apart than a margin [m], for certain."""
        first, second = self._pairs[pair].tolist()
        shapes = [self.geometry.geometryObjects[index].geometry for index in (first, second)]
        if not any(isinstance(shape, coal.BVHModelBase) for shape in shapes):
            return False
        around = [self._hull_of(index, shape) for index, shape in zip((first, second), shapes, strict=True)]
        if None in around:
            return False
        places = [self._geometry_data.oMg[index] for index in (first, second)]
        there = [coal.Transform3s(place.rotation, place.translation) for place in places]
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        distance = coal.distance(around[0], there[0], around[1], there[1], request, result)
        return bool(distance > margin + SLACK)

    def _hull_of(self, index: int, shape: Any) -> Any:
        if index not in self._hulls:
            self._hulls[index] = hull(shape) if isinstance(shape, coal.BVHModelBase) else shape
        return self._hulls[index]
