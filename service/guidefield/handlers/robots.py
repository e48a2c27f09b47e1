"""The list of robots, and the description of one; a stored robot is prepared here.

Fields are those of `RobotsReply` and `RobotReply`, the wire.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from typing import Protocol

from guidefield.deadline import Deadline, DeadlineExpired
from guidefield.errors import RobotInvalid
from guidefield.handlers.preparation import prepare
from guidefield.messages.replies import (
    CoverInfo,
    GeometryInfo,
    JointInfo,
    PairLeftOut,
    PartsInfo,
    RobotReply,
    RobotsReply,
    RobotSummary,
)
from guidefield.robot.catalog import Catalog
from guidefield.robot.library import SentRobot
from guidefield.robot.link_bounds import ShapeCoverage, recall_coverage, recall_parts
from guidefield.robot.model.configuration import configuration_to_wire
from guidefield.robot.model.joints import Joint
from guidefield.robot.model.mimic_joints import bind_rates
from guidefield.robot.model.model import RobotModel

PREPARE_WITHIN = 60.0
"""Longest time to prepare a robot that a client stores; its first plan does the rest [s].

With loading it must stay below `STORE_TIME_LIMIT` of `messages/keys.py`, the time that the request may take.
"""


class StoredRobots(Protocol):
    """A store of robots that clients sent."""

    def names(self) -> list[str]:
        """Their names."""

    def find(self, name: str) -> SentRobot | None:
        """One of them; None if it was deleted since, RobotInvalid if it is damaged."""


def robots(catalog: Catalog, stored: StoredRobots) -> RobotsReply:
    """The robots that can be named; those that can't be used with their problem."""
    return RobotsReply(robots=[*catalog.summaries(), *summaries_of(catalog, stored, stored.names())])


def summaries_of(catalog: Catalog, stored: StoredRobots, names: Iterable[str]) -> list[RobotSummary]:
    """A line about each stored robot of some names, the damaged ones last."""
    sent, damaged = [], []
    for name in names:
        try:
            found = stored.find(name)
        except RobotInvalid as fault:
            damaged.append(RobotSummary(name=name, source="stored", family=name, problem=fault.message))
        else:
            sent += [] if found is None else [found]
    return [*map(catalog.line, sent), *damaged]


def prepare_stored(model: RobotModel) -> str:
    """Prepare a stored robot for its first plan; return words to add to the sentence that it is stored."""
    try:
        prepare(model, Deadline(time.monotonic() + PREPARE_WITHIN))
    except DeadlineExpired as stopped:
        return f"; {PREPARE_WITHIN:g} s of preparing its meshes were not enough, its first plan goes on from {stopped}"
    return ""


def robot(model: RobotModel) -> RobotReply:
    """Everything a client needs to know to plan for one robot."""
    return RobotReply(
        name=model.name,
        joints=[_joint(joint) for joint in bind_rates(model.joints)],
        frames=[frame.name for frame in list(model.model.frames)[1:]],
        links=list(model.links),
        groups={name: list(joints) for name, joints in model.groups.items()},
        tip=model.tip,
        rest=configuration_to_wire(model.joints, model.rest),
        geometry=_geometry(model),
        collision_pairs=_linked_pairs(model),
        pairs_left_out=[PairLeftOut(links=list(pair.links), reason=pair.reason) for pair in model.pairs_left_out],
        warnings=[*model.remarks, *model.warnings],
        rest_state=model.rest_state,
    )


def _geometry(model: RobotModel) -> list[GeometryInfo]:
    return [
        GeometryInfo(
            name=choice.name,
            link=choice.link,
            shape=choice.shape,
            judged_as=choice.judged_as,
            stand_off=choice.stand_off,
            cover=None if balls is None else _cover(balls),
            parts=None if found is None else PartsInfo(count=len(found.parts), stand_off=found.stand_off),
        )
        for choice, balls, found in zip(
            model.geometry_choices, recall_coverage(model), recall_parts(model), strict=True
        )
    ]


def _cover(balls: ShapeCoverage) -> CoverInfo:
    cover = balls.cover
    return CoverInfo(spheres=len(cover.spheres), overhang=cover.overhang, inner_balls=len(balls.inner))


def _joint(joint: Joint) -> JointInfo:
    mimic = joint.mimic
    return JointInfo(
        name=joint.name,
        kind=joint.kind.value,
        lower=_finite(joint.lower),
        upper=_finite(joint.upper),
        velocity=[float(limit) for limit in joint.velocity],
        acceleration=[float(limit) for limit in joint.acceleration],
        velocity_source=joint.velocity_source.value,
        acceleration_source=joint.acceleration_source.value,
        mimics=None if mimic is None else mimic.source,
        multiplier=1.0 if mimic is None else mimic.multiplier,
        offset=0.0 if mimic is None else mimic.offset,
    )


def _finite(limits: Iterable[float]) -> list[float | None]:
    return [float(limit) if math.isfinite(limit) else None for limit in limits]


def _linked_pairs(model: RobotModel) -> list[list[str]]:
    pairs = (
        sorted((model.link_of_geometry(pair.first), model.link_of_geometry(pair.second)))
        for pair in model.geometry.collisionPairs
    )
    return [list(pair) for pair in sorted({(first, second) for first, second in pairs})]
