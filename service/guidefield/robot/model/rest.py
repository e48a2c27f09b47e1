"""Find the rest configuration of a robot: as its card or SRDF states it, else zero; moved a little where it touches.

Joints that requests leave out have its values, and replies show it; the random search is seeded, so that it is always
the same. Other constants or seeds give robots that touch as stated another rest, and so other plans.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.errors import RobotInvalid
from guidefield.messages.requests import Positions
from guidefield.robot.library import RobotCard
from guidefield.robot.model.configuration import CLAMP_TOLERANCE, LENGTHS, clamp, values_from_wire
from guidefield.robot.model.joints import Joint, JointKind, RobotConfiguration
from guidefield.robot.model.mimic_joints import follow
from guidefield.robot.model.model import MARGIN, ROOT_JOINT
from guidefield.robot.model.pairs import SelfContacts
from guidefield.robot.urdf.srdf import STATES, Srdf, SrdfState

SHARES = np.linspace(0.05, 1.0, 20)  # how much of the way to random values is tried, nearest first
DRAWS = 25  # random directions for each of them
DRAW_RANGE = np.pi  # joints are drawn within their limits and this of their zero [rad or m]


@dataclass(frozen=True)
class StatedRest:
    """The rest configuration that was stated, shape (nq,), and the name of its SRDF state, if any."""

    q: RobotConfiguration
    state: str | None


def stated(model: Any, joints: Sequence[Joint], described: Srdf, card: RobotCard, warnings: list[str]) -> StatedRest:
    """Return the card's rest values over a state of the SRDF over zero, each within its limits.

    Of the SRDF's states the first is taken of `STATES` and then of all others that lies within the joints' limits;
    states of several groups with one name are one. States of groups that aren't there come last. The warnings get a
    sentence for each preferred state that isn't taken, and for each clamped value. RobotInvalid if a value of the card
    doesn't fit its joint.
    """
    name, values = _state(joints, described, card, warnings)
    values = {**values, **card.rest}
    q: RobotConfiguration = pin.neutral(model)
    for joint in joints:
        if joint.name in values:
            q[joint.idx_q : joint.idx_q + joint.nq] = values_from_wire(joint, values[joint.name], RobotInvalid)
    within = clamp(joints, q)
    for joint in joints:
        place = slice(joint.idx_q, joint.idx_q + joint.nq)
        if joint.name in card.rest and np.abs(within[place] - q[place]).max() > CLAMP_TOLERANCE:
            warnings.append(f"the card's rest value of {joint.name!r} is beyond its limits: it has the limit instead")
    q = within
    follow(joints, q)
    return StatedRest(q, name)


def _state(
    joints: Sequence[Joint], described: Srdf, card: RobotCard, warnings: list[str]
) -> tuple[str | None, Positions]:
    """Return name and values of the SRDF's state that is the rest configuration; None and nothing if it has none."""
    states: dict[str, Positions] = {}
    known = ("", *described.groups)
    for state in sorted(described.states, key=lambda state: state.group not in known):
        if state.group in known or state.name not in states:
            states[state.name] = {**_fitting(state, joints, described, warnings), **states.get(state.name, {})}
    lost = {state.name for state in described.states} - {
        state.name for state in described.states if state.group in known
    }
    rank = {name: place for place, name in enumerate(STATES)}
    ordered = sorted(states, key=lambda name: (name in lost, rank.get(name, len(rank))))
    beyond = {name: _beyond({**states[name], **card.rest}, joints) for name in ordered}
    within = next((name for name in ordered if not beyond[name]), None)
    for name in ordered[: None if within is None else ordered.index(within)]:
        use = "it is not the rest configuration" if within else "the rest configuration has the limit instead"
        consequence = use if within or name == ordered[0] else "it is not the rest configuration"
        warnings.append(f"the SRDF's state {name!r} is beyond limits ({', '.join(beyond[name])}): {consequence}")
    chosen = within or next(iter(ordered), None)
    return chosen, states.get(chosen or "", {})


def _beyond(values: Positions, joints: Sequence[Joint]) -> list[str]:
    return [
        f"joint {joint.name!r} at {value:g}, its limits are {joint.limits[0]:g} and {joint.limits[1]:g}"
        for joint in joints
        if joint.mimic is None
        and joint.limits is not None
        and isinstance(value := values.get(joint.name), float)
        and not joint.limits[0] - CLAMP_TOLERANCE <= value <= joint.limits[1] + CLAMP_TOLERANCE
    ]


def _fitting(state: SrdfState, joints: Sequence[Joint], described: Srdf, warnings: list[str]) -> Positions:
    """Return the values of an SRDF's state that fit their joints: a root joint may be another than it was made for.

    A virtual joint represents the root joint. Quaternions are written with few digits there; they get length 1.
    """
    known, fitting = {joint.name: joint for joint in joints}, {}
    for written, value in state.values.items():
        name = ROOT_JOINT if written in described.virtual and written not in known else written
        numbers = value if isinstance(value, list) else [value]
        if name not in known:
            continue
        length = LENGTHS.get(known[name].kind, 1)
        if len(numbers) != length:
            if name != ROOT_JOINT:
                given = f"{len(numbers)} values" if len(numbers) > 1 else "1 value"
                warnings.append(f"the SRDF's state {state.name!r} gives joint {name!r} {given}, not {length}: left out")
            continue
        if length >= LENGTHS[JointKind.SPHERICAL]:
            norm = math.hypot(*numbers[-4:])
            if norm == 0.0:
                warnings.append(f"the SRDF's state {state.name!r} gives joint {name!r} a zero quaternion: left out")
                continue
            numbers = [*numbers[:-4], *(number / norm for number in numbers[-4:])]
        fitting[name] = numbers if length > 1 else numbers[0]
    return fitting


def choose_rest(
    model: Any,
    geometry: Any,
    joints: Sequence[Joint],
    links: Sequence[str],
    q: RobotConfiguration,
    size: float,
    warnings: list[str],
) -> RobotConfiguration:
    """Return the stated rest configuration, shape (nq,), if it is free of contact, else one near it that is.

    Zero means nothing in many a URDF, and some SRDFs' states were never looked at. Where links touch each other, the
    joints between them are moved, as little as seeded random trials find, with a warning.
    """
    search = _RestSearch(model, geometry, joints, MARGIN * size)
    if at_first := search.touching(q):
        freed = search.free_of_contacts(q)
        contacts = _describe_contacts(links, geometry, at_first)
        moved = [j.name for j in joints if not np.allclose(q[_at(j)], freed[_at(j)], rtol=0.0, atol=1e-12)]
        if moved:
            warnings.append(
                f"{contacts} in the rest configuration as stated or zero; {', '.join(moved)} are moved for it"
            )
        if left := search.touching(freed):
            warnings.append(
                f"{_describe_contacts(links, geometry, left)} in the rest configuration; none free was found near it"
            )
        q = freed
    q.setflags(write=False)
    return q


class _RestSearch:
    def __init__(self, model: Any, geometry: Any, joints: Sequence[Joint], margin: float) -> None:
        self._model, self._joints, self._margin = model, joints, margin
        self._contacts = SelfContacts(model, geometry)
        self._geometry = self._contacts.geometry
        self._last = -1  # the pair that was found last: probably the next trial touches there too

    def touching(self, q: RobotConfiguration, margin: float = 0.0) -> list[int]:
        """Return the pairs of shapes that are no further apart than a margin [m]."""
        self._contacts.place(q)
        return self._contacts.find_contacts(margin)

    def free_of_contacts(self, q: RobotConfiguration) -> RobotConfiguration:
        """Return a configuration near one that touches, in which fewer pairs touch, none if that is found.

        One pair after the other is parted, by the joints between its links; no other may come to touch for it.
        """
        rng = np.random.default_rng(0)
        tried: set[int] = set()
        while pending := [pair for pair in self.touching(q) if pair not in tried]:
            tried.add(pending[0])
            q = self._part(q, pending[0], rng)
        return q

    def _part(self, q: RobotConfiguration, pair: int, rng: np.random.Generator) -> RobotConfiguration:
        near, touching = set(self.touching(q, self._margin)), set(self.touching(q))
        moving = self._find_between(pair)
        moved = self._find_moved_by(moving)
        fallback = None
        for share in SHARES if moving else ():
            for _ in range(DRAWS):
                trial = _draw_configuration(self._model, self._joints, moving, q, share, rng)
                if self._touches_none(trial, pair, moved - (touching - {pair}), 0.0):
                    if self._touches_none(trial, pair, moved - (near - {pair}), self._margin):
                        return trial
                    fallback = trial if fallback is None else fallback
        return q if fallback is None else fallback

    def _touches_none(self, q: RobotConfiguration, first: int, pairs: set[int], margin: float) -> bool:
        """Return whether none of some pairs is within a margin [m]; the pair `first` is tested first."""
        self._contacts.place(q)
        near = [pair for pair in self._contacts.find_near(margin) if pair in pairs]
        for pair in sorted(near, key=lambda pair: (pair != first, pair != self._last)):
            if self._contacts.is_contact(pair, margin):
                self._last = pair
                return False
        return True

    def _find_moved_by(self, moving: Sequence[Joint]) -> set[int]:
        """Find the pairs whose shapes move relative to each other with some joints or their mimic joints."""
        names = {joint.name for joint in moving}
        turned = {
            joint.index
            for joint in self._joints
            if joint.name in names or (joint.mimic is not None and joint.mimic.source in names)
        }
        supports = [set(self._model.supports[shape.parentJoint]) & turned for shape in self._geometry.geometryObjects]
        pairs = enumerate(self._geometry.collisionPairs)
        return {index for index, pair in pairs if supports[pair.first] != supports[pair.second]}

    def _find_between(self, pair: int) -> list[Joint]:
        """Find the joints that move the links of a pair relative to each other, or whose mimic joints do."""
        bodies = self._geometry.collisionPairs[pair]
        first, second = (
            set(self._model.supports[self._geometry.geometryObjects[body].parentJoint])
            for body in (bodies.first, bodies.second)
        )
        names = {joint.name for joint in self._joints if joint.index in first ^ second}
        names |= {joint.mimic.source for joint in self._joints if joint.mimic is not None and joint.name in names}
        return [joint for joint in self._joints if joint.name in names and joint.mimic is None and joint.nv == 1]


def _describe_contacts(links: Sequence[str], geometry: Any, touching: Sequence[int]) -> str:
    bodies = [geometry.collisionPairs[index] for index in touching]
    pairs = sorted({" and ".join(sorted((links[pair.first], links[pair.second]))) for pair in bodies})
    return f"{pairs[0]} touch" + (f" (and {len(pairs) - 1} more pairs)" if len(pairs) > 1 else "")


def _draw_configuration(
    model: Any,
    joints: Sequence[Joint],
    moving: Sequence[Joint],
    q: RobotConfiguration,
    share: float,
    rng: np.random.Generator,
) -> RobotConfiguration:
    """Move some joints, and their mimic joints, towards random values by a share of the way."""
    step = np.zeros(model.nv)
    for joint in moving:
        value = q[joint.idx_q] if joint.nq == 1 else 0.0
        lower, upper = max(float(joint.lower[0]), -DRAW_RANGE), min(float(joint.upper[0]), DRAW_RANGE)
        step[joint.idx_v] = share * (rng.uniform(lower, max(lower, upper)) - value)
    trial: RobotConfiguration = pin.integrate(model, q, step)
    trial = clamp(joints, trial)
    follow(joints, trial)
    return trial


def _at(joint: Joint) -> slice:
    return slice(joint.idx_q, joint.idx_q + joint.nq)
