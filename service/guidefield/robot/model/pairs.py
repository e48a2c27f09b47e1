"""Choose the pairs of links that are tested against each other, with a reason for each other pair; test self-contacts.

What is left out here is never tested, in plans and in certificates: samples may only leave out pairs that always touch.
So `SAMPLES`, `ROAM`, `ALWAYS_SHARE`, `TOUCH_DISTANCE` and the seed decide what is tested (docs/robots.md states the
first and third); `ROUNDING` and `SLACK` only spare tests, and must not be less. Reasons and warnings are sentences that
users read.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.geometry.convex import replace_balls
from guidefield.robot.model.collision_shapes import hull
from guidefield.robot.model.joints import WIND, Joint, JointKind, RobotConfiguration
from guidefield.robot.model.mimic_joints import follow
from guidefield.robot.model.model import PairLeftOut


def collision_pairs(geometry: Any) -> np.ndarray:
    """Return the collision pairs of a geometry model in its order, shape (p, 2); a million take no second so."""
    places = np.triu(np.asarray(geometry.collisionPairMapping) + 1)
    first, second = np.nonzero(places)
    pairs: np.ndarray = np.column_stack([first, second])[np.argsort(places[first, second])]
    return pairs


def scratch_space(geometry: Any) -> Any:
    """Make Pinocchio's data for a geometry model, set so that answers are right, and don't depend on questions before.

    Unless contact points are requested, as Pinocchio doesn't, Coal (3.0.3, without a margin) overlooks boxes that
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
    # all queries are alike; to set each by itself takes three times as long as all else here
    scratch.collisionRequests = _alike(coal.StdVec_CollisionRequest(), contact, count)
    scratch.distanceRequests = _alike(coal.StdVec_DistanceRequest(), distance, count)
    return scratch


def _alike(requests: Any, one: Any, count: int) -> Any:
    for _ in range(count):
        requests.append(one)
    return requests


ROUNDING = 1e-9  # share by which spheres about shapes are taken to be larger, for rounding
SLACK = 1e-6  # meshes aren't tested if their hulls are this much further apart than a margin [m]: Coal's accuracy


class SelfContacts:
    """Tests collision pairs of a geometry model for contact; `exact_tests` counts those that tested meshes."""

    def __init__(self, model: Any, geometry: Any) -> None:
        self.geometry = replace_balls(geometry)
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
        """Return whether the shapes of a pair are no further apart than a margin [m]."""
        if self._hulls_apart(pair, margin):
            return False
        self.exact_tests += 1
        self._geometry_data.collisionRequests[pair].security_margin = margin
        return bool(pin.computeCollision(self.geometry, self._geometry_data, pair))

    def find_contacts(self, margin: float) -> list[int]:
        """Return the pairs that are no further apart than a margin [m]."""
        return [pair for pair in self.find_near(margin) if self.is_contact(pair, margin)]

    def _hulls_apart(self, pair: int, margin: float) -> bool:
        """Return whether the hulls of a pair with a mesh are further apart than a margin [m], for certain."""
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


SAMPLES = 200  # random configurations that tell whether two links always touch
ROAM = 1.0  # how far sliding joints are drawn from their zero at most [m], at size 1
TOUCH_DISTANCE = 1e-4
"""Links this close count as touching [m], at size 1: faces that slide on each other, which no motion could be certified
for."""

ALWAYS_SHARE, OFTEN_SHARE = 0.95, 0.05
"""Shares of those configurations: links that touch in more always touch; an SRDF that disables more hides something."""


@dataclass(frozen=True)
class ChosenPairs:
    """The pairs of links that are left out, and what was odd about the SRDF."""

    left_out: tuple[PairLeftOut, ...]
    warnings: tuple[str, ...]


def choose_pairs(
    model: Any,
    geometry: Any,
    joints: Sequence[Joint],
    links: Sequence[str],
    disabled: Mapping[frozenset[str], str],
    said_by: str,
    rest: RobotConfiguration,
    size: float,
) -> ChosenPairs:
    """Choose the collision pairs of a geometry model in place.

    Pairs that the SRDF or MJCF disables are left out; without any in an SRDF, those that are adjacent (joined by one
    joint); and always those that touch in nearly every one of `SAMPLES` random configurations, for a plan would be
    impossible otherwise. Pairs that no sample found touching stay in: samples prove nothing.

    Args:
        disabled: Pairs of links that the SRDF or MJCF disables, with its reasons.
        said_by: Which of them; an MJCF says of every pair whether it is tested.
        rest: Configuration, shape (nq,), that is tested besides the random ones.
    """
    joints_of = np.array([shape.parentJoint for shape in geometry.geometryObjects], np.int64)
    tested = joints_of[:, None] != joints_of
    adjacent = _adjacent(model, joints_of, links)
    reasons = {pair: f"{said_by}: {reason}" for pair, reason in disabled.items()}
    if not reasons and said_by == "SRDF":
        reasons = dict.fromkeys(adjacent, "adjacent")
    # neighbours that are left out need no samples
    geometry.setCollisionPairs(tested & ~_are_among(links, adjacent & reasons.keys()), True)
    touching = _shares_touching(model, geometry, joints, links, rest, disabled, size)
    warnings = [
        f"the {said_by} disables {' and '.join(sorted(pair))}, which touch in {_percent(touching[pair])}"
        for pair in sorted(disabled, key=sorted)
        if pair not in adjacent and OFTEN_SHARE < touching.get(pair, 0.0) <= ALWAYS_SHARE
    ]
    for pair in sorted(touching, key=sorted):
        if touching[pair] > ALWAYS_SHARE and pair not in reasons:
            reasons[pair] = f"touching in {_percent(touching[pair])}"
            if disabled or said_by != "SRDF":
                both = " and ".join(sorted(pair))
                warnings.append(f"{both} always touch, though the {said_by} has them tested; left out")
    left_out = tested & _are_among(links, reasons)
    geometry.setCollisionPairs(tested & ~left_out, True)
    present = {frozenset((links[first], links[second])) for first, second in np.argwhere(left_out).tolist()}
    gone = sorted((pair for pair in reasons if pair in present), key=sorted)
    return ChosenPairs(tuple(PairLeftOut((min(pair), max(pair)), reasons[pair]) for pair in gone), tuple(warnings))


def _percent(share: float) -> str:
    return f"{100 * share:.0f} % of random configurations"


def _adjacent(model: Any, joints_of: np.ndarray, links: Sequence[str]) -> set[frozenset[str]]:
    parents = np.array(model.parents)[joints_of]
    neighbours = (parents[:, None] == joints_of) & (joints_of > 0)[:, None]
    return {frozenset((links[first], links[second])) for first, second in np.argwhere(neighbours).tolist()}


def _are_among(links: Sequence[str], pairs: Collection[frozenset[str]]) -> np.ndarray:
    """Tell of all pairs of shapes, of whose links these are the names, if pairs of links hold them, shape (n, n)."""
    number = {name: k for k, name in enumerate(dict.fromkeys(links))}
    among = np.zeros((len(number), len(number)), np.bool_)
    for pair in pairs:
        known = [number[name] for name in pair if name in number]
        if len(known) == len(pair):
            among[known, known[::-1]] = True
    of_shapes = np.array([number[name] for name in links], np.int64)
    found: np.ndarray = among[of_shapes[:, None], of_shapes]
    return found


def _shares_touching(
    model: Any,
    geometry: Any,
    joints: Sequence[Joint],
    links: Sequence[str],
    rest: RobotConfiguration,
    disabled: Collection[frozenset[str]],
    size: float,
) -> dict[frozenset[str], float]:
    """Return the share of configurations, at rest and random but repeatable, in which each pair of links touches.

    A pair that was apart so often that it can't always touch is tested no more, unless the SRDF disables it: its share
    is too small then, and below `ALWAYS_SHARE`.
    """
    contacts = SelfContacts(model, geometry)
    rng = np.random.default_rng(0)
    pairs, counts = collision_pairs(geometry), Counter[frozenset[str]]()
    most, touch = (1.0 - ALWAYS_SHARE) * (SAMPLES + 1), TOUCH_DISTANCE * size
    for done, q in enumerate([rest, *(random_configuration(model, joints, rng, size) for _ in range(SAMPLES))]):
        contacts.place(q)
        found: set[frozenset[str]] = set()
        for k in contacts.find_near(touch):
            pair = frozenset((links[pairs[k, 0]], links[pairs[k, 1]]))
            tested = done - counts[pair] <= most or pair in disabled
            if tested and pair not in found and contacts.is_contact(k, touch):
                found.add(pair)
        counts.update(found)
    return {pair: count / (SAMPLES + 1) for pair, count in counts.items()}


def random_configuration(
    model: Any, joints: Sequence[Joint], rng: np.random.Generator, size: float
) -> RobotConfiguration:
    """Draw a configuration, shape (nq,), within the limits, lengths within `ROAM`, angles within one turn.

    Angles that others follow count whole turns: they are drawn from all their limits, or within `WIND`.
    """
    q: RobotConfiguration = pin.integrate(model, pin.neutral(model), rng.uniform(-np.pi, np.pi, model.nv))
    followed = {joint.mimic.source for joint in joints if joint.mimic is not None}
    for joint in joints:
        if joint.nq == 1:
            most = ROAM * size if joint.kind is JointKind.PRISMATIC else np.pi
            if joint.kind is JointKind.REVOLUTE and joint.name in followed:
                most = WIND if np.isinf(joint.upper[0]) else np.inf
            lower, upper = max(float(joint.lower[0]), -most), min(float(joint.upper[0]), most)
            q[joint.idx_q] = rng.uniform(lower, max(lower, upper))
    follow(joints, q)
    return q
