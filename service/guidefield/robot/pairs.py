"""Which pairs of links are tested against each other, and why the others are not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.robot.model import PairLeftOut

SAMPLES = 200
"""Random configurations that tell whether two links always touch."""


def settle(
    model: Any, geometry: Any, links: Sequence[str], disabled: Mapping[frozenset[str], str], rest: np.ndarray
) -> tuple[PairLeftOut, ...]:
    """Choose the collision pairs of a geometry model in place, and list the pairs of links left out.

    Pairs that the SRDF disables are left out. Without any, pairs are left out that are adjacent (joined by one joint)
    or that touch in nearly every one of `SAMPLES` random configurations.

    Args:
        model: Pinocchio model.
        geometry: Collision geometry; its pairs are replaced.
        links: Link of each shape of `geometry`.
        disabled: Pairs of links that the SRDF disables, with its reasons.
        rest: Configuration, shape (nq,), at which a robot does not touch itself unless it always does.
    """
    geometry.removeAllCollisionPairs()
    geometry.addAllCollisionPairs()  # leaves out shapes on the same joint
    left_out = {pair: f"SRDF: {reason}" for pair, reason in disabled.items()}
    if not disabled:
        left_out = _adjacent(model, geometry, links)
        left_out |= _always_touching(model, geometry, links, left_out, rest)
    kept, gone = [], set()
    for pair in geometry.collisionPairs:
        names = frozenset((links[pair.first], links[pair.second]))
        if names in left_out:
            gone.add(names)
        else:
            kept.append((pair.first, pair.second))
    geometry.removeAllCollisionPairs()
    for first, second in kept:
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    return tuple(PairLeftOut(tuple(sorted(pair)), left_out[pair]) for pair in sorted(gone, key=sorted))


def _adjacent(model: Any, geometry: Any, links: Sequence[str]) -> dict[frozenset[str], str]:
    joints = [shape.parentJoint for shape in geometry.geometryObjects]
    return {
        frozenset((links[pair.first], links[pair.second])): "adjacent"
        for pair in geometry.collisionPairs
        if model.parents[joints[pair.first]] == joints[pair.second]
        or model.parents[joints[pair.second]] == joints[pair.first]
    }


def _always_touching(
    model: Any, geometry: Any, links: Sequence[str], known: Mapping[frozenset[str], str], rest: np.ndarray
) -> dict[frozenset[str], str]:
    data, geometry_data = model.createData(), geometry.createData()
    rng = np.random.default_rng(0)
    counts = np.zeros(len(geometry.collisionPairs), int)
    configurations = [rest, *(_random_configuration(model, rng) for _ in range(SAMPLES))]
    for q in configurations:
        pin.computeCollisions(model, data, geometry, geometry_data, q, False)
        counts += np.array([result.isCollision() for result in geometry_data.collisionResults], int)
    return {
        names: f"touching in {100 * count / len(configurations):.0f} % of random configurations"
        for pair, count in zip(geometry.collisionPairs, counts, strict=True)
        if (names := frozenset((links[pair.first], links[pair.second]))) not in known
        and count > 0.95 * len(configurations)
    }


def _random_configuration(model: Any, rng: np.random.Generator) -> np.ndarray:
    """A configuration within the limits; angles within one turn, positions without limits within a metre."""
    q: np.ndarray = pin.integrate(model, pin.neutral(model), rng.uniform(-np.pi, np.pi, model.nv))
    for joint in list(model.joints)[1:]:
        if joint.nq == 1:
            lower = max(float(model.lowerPositionLimit[joint.idx_q]), -np.pi)
            upper = min(float(model.upperPositionLimit[joint.idx_q]), np.pi)
            q[joint.idx_q] = rng.uniform(lower, max(lower, upper))
    return q
