"""Pinocchio's scratch space for contacts and distances: it misses no contact, and forgets what it was asked before."""

from __future__ import annotations

import warnings
from typing import Any


def scratch_space(geometry: Any) -> Any:
    """Pinocchio's data for a geometry model, set so that answers are right, and don't depend on questions before.

    Unless points of contact are asked for, as Pinocchio doesn't, Coal (3.0.3, without a margin) overlooks boxes that
    overlap by centimetres where an axis of one lies along an axis of the other. And it starts each search where the
    last one ended, which changes the last digits of distances.
    """
    scratch = geometry.createData()
    for request in scratch.collisionRequests:
        request.enable_contact = True
    with warnings.catch_warnings():
        # Coal's newer field, `gjk_initial_guess`, does not switch off the older one, which Pinocchio switches on.
        warnings.simplefilter("ignore", DeprecationWarning)
        for requests in (scratch.collisionRequests, scratch.distanceRequests):
            for request in requests:
                request.enable_cached_gjk_guess = False
    return scratch
