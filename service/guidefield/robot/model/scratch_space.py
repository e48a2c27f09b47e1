"""Pinocchio's geometry models: their pairs as an array, and scratch space for contacts and distances."""

from __future__ import annotations

import warnings
from typing import Any

import coal
import numpy as np


def collision_pairs(geometry: Any) -> np.ndarray:
    """Return the collision pairs of a geometry model in its order, shape (p, 2); a million take no second so."""
    places = np.triu(np.asarray(geometry.collisionPairMapping) + 1)
    first, second = np.nonzero(places)
    pairs: np.ndarray = np.column_stack([first, second])[np.argsort(places[first, second])]
    return pairs


def scratch_space(geometry: Any) -> Any:
    """Pinocchio's data for a geometry model, set so that answers are right, and don't depend on questions before.

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
    """So many copies of one request in Coal's list."""
    for _ in range(count):
        requests.append(one)
    return requests
