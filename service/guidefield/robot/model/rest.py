"""The rest configuration of a robot: what its card or its SRDF states, else zero; or near that, where it is free."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.errors import RobotInvalid
from guidefield.geometry.met import all_as_met
from guidefield.messages.requests import Positions
from guidefield.robot.model.card import RobotCard
from guidefield.robot.model.configuration import LENGTHS, clamp, values_from_wire
from guidefield.robot.model.followers import follow
from guidefield.robot.model.margin import MARGIN
from guidefield.robot.model.model import Joint, JointKind
from guidefield.robot.model.scratch_space import scratch_space
from guidefield.robot.model.spaces import RobotConfiguration
from guidefield.robot.urdf.srdf import Srdf

STATES = ("default", "rest", "home", "ready")
"""Names of the SRDF's states that are preferred, in this order; else it is its first."""

SHARES = np.linspace(0.05, 1.0, 20)
"""How much of the way to random values is tried, nearest first."""
DRAWS = 25
"""Random directions for each of them."""
MOST = np.pi
"""Joints without limits are drawn within this of their zero [rad or m]."""


def stated(model: Any, joints: Sequence[Joint], described: Srdf, card: RobotCard) -> RobotConfiguration:
    """The card's rest values over a state of the SRDF over zero, each within its limits, shape (nq,).

    Args:
        model: Pinocchio model.
        joints: Its joints.
        described: The SRDF.
        card: The robot's card.

    Raises:
        RobotInvalid: if a value doesn't fit its joint.
    """
    states = described.states
    preferred = next((states[key] for key in STATES if key in states), None)
    values = {**_fitting(preferred or next(iter(states.values()), {}), joints), **card.rest}
    q: RobotConfiguration = pin.neutral(model)
    for joint in joints:
        if joint.name in values:
            q[joint.idx_q : joint.idx_q + joint.nq] = values_from_wire(joint, values[joint.name], RobotInvalid)
    q = clamp(joints, q)
    follow(joints, q)
    return q


def _fitting(state: Positions, joints: Sequence[Joint]) -> Positions:
    """What an SRDF's state says of joints that take as many numbers: a root joint may be another than it was made for.

    Quaternions are written with few digits there; they get length 1.
    """
    kinds, fitting = {joint.name: joint.kind for joint in joints}, {}
    for name, value in state.items():
        numbers = value if isinstance(value, list) else [value]
        length = LENGTHS.get(kinds[name], 1) if name in kinds else 0
        if len(numbers) != length:
            continue
        if length >= LENGTHS[JointKind.SPHERICAL]:
            norm = math.hypot(*numbers[-4:])
            numbers = [*numbers[:-4], *(number / norm for number in numbers[-4:])] if norm > 0.0 else numbers
        fitting[name] = numbers if length > 1 else numbers[0]
    return fitting


def settle(
    model: Any, geometry: Any, joints: Sequence[Joint], links: Sequence[str], q: RobotConfiguration, warnings: list[str]
) -> RobotConfiguration:
    """The rest configuration, shape (nq,): what was stated if that is free of contact, else one near it that is.

    Zero means nothing in many a URDF, and some SRDFs' states were never looked at. Where links touch each other, the
    joints between them are moved, as little as seeded random trials find.

    Args:
        model: Pinocchio model.
        geometry: Collision geometry with the pairs that count.
        joints: The model's joints.
        links: Link of each shape of `geometry`.
        q: What was stated, shape (nq,).
        warnings: Gets a sentence where links touch in what was stated.
    """
    search = _Search(model, geometry, joints)
    if at_first := search.touching(q):
        freed = search.freed(q)
        told = _told(links, geometry, at_first)
        moved = [j.name for j in joints if not np.allclose(q[_at(j)], freed[_at(j)], rtol=0.0, atol=1e-12)]
        if moved:
            warnings.append(f"{told} in the rest configuration as stated or zero; {', '.join(moved)} are moved for it")
        if left := search.touching(freed):
            warnings.append(f"{_told(links, geometry, left)} in the rest configuration; none free was found near it")
        q = freed
    q.setflags(write=False)
    return q


class _Search:
    """Looks for configurations without contact."""

    def __init__(self, model: Any, geometry: Any, joints: Sequence[Joint]) -> None:
        self._model, self._geometry, self._joints = model, all_as_met(geometry), joints
        self._data, self._geometry_data = model.createData(), scratch_space(self._geometry)

    def touching(self, q: RobotConfiguration, margin: float = 0.0) -> list[int]:
        """Pairs of shapes that are no further apart than a margin [m]."""
        for request in self._geometry_data.collisionRequests:
            request.security_margin = margin
        pin.computeCollisions(self._model, self._data, self._geometry, self._geometry_data, q, False)
        return [index for index, result in enumerate(self._geometry_data.collisionResults) if result.isCollision()]

    def freed(self, q: RobotConfiguration) -> RobotConfiguration:
        """A configuration near one that touches, in which fewer pairs touch, none if that is found.

        One pair after the other is parted, by the joints between its links; no other may come to touch for it.
        """
        rng = np.random.default_rng(0)
        tried: set[int] = set()
        while pending := [pair for pair in self.touching(q) if pair not in tried]:
            tried.add(pending[0])
            q = self._parted(q, pending[0], rng)
        return q

    def _parted(self, q: RobotConfiguration, pair: int, rng: np.random.Generator) -> RobotConfiguration:
        near, touching = set(self.touching(q, MARGIN)), set(self.touching(q))
        moving = self._between(pair)
        fallback = None
        for share in SHARES if moving else ():
            for _ in range(DRAWS):
                trial = _drawn(self._model, self._joints, moving, q, share, rng)
                if set(self.touching(trial)) < touching and pair not in self.touching(trial):
                    if set(self.touching(trial, MARGIN)) <= near - {pair}:
                        return trial
                    fallback = trial if fallback is None else fallback
        return q if fallback is None else fallback

    def _between(self, pair: int) -> list[Joint]:
        """Joints that move the links of a pair relative to each other, or are followed by such."""
        bodies = self._geometry.collisionPairs[pair]
        first, second = (
            set(self._model.supports[self._geometry.geometryObjects[body].parentJoint])
            for body in (bodies.first, bodies.second)
        )
        names = {joint.name for joint in self._joints if joint.index in first ^ second}
        names |= {joint.mimic.driver for joint in self._joints if joint.mimic is not None and joint.name in names}
        return [joint for joint in self._joints if joint.name in names and joint.mimic is None and joint.nv == 1]


def _told(links: Sequence[str], geometry: Any, touching: Sequence[int]) -> str:
    bodies = [geometry.collisionPairs[index] for index in touching]
    pairs = sorted({" and ".join(sorted((links[pair.first], links[pair.second]))) for pair in bodies})
    return f"{pairs[0]} touch" + (f" (and {len(pairs) - 1} more pairs)" if len(pairs) > 1 else "")


def _drawn(
    model: Any,
    joints: Sequence[Joint],
    moving: Sequence[Joint],
    q: RobotConfiguration,
    share: float,
    rng: np.random.Generator,
) -> RobotConfiguration:
    """Some joints moved towards random values by a share of the way; their followers with them."""
    step = np.zeros(model.nv)
    for joint in moving:
        value = q[joint.idx_q] if joint.nq == 1 else 0.0
        lower, upper = max(float(joint.lower[0]), -MOST), min(float(joint.upper[0]), MOST)
        step[joint.idx_v] = share * (rng.uniform(lower, max(lower, upper)) - value)
    trial: RobotConfiguration = pin.integrate(model, q, step)
    trial = clamp(joints, trial)
    follow(joints, trial)
    return trial


def _at(joint: Joint) -> slice:
    return slice(joint.idx_q, joint.idx_q + joint.nq)
