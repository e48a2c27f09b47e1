"""One line about a robot of the catalog, without loading its shapes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import msgspec
import pinocchio as pin

from guidefield.errors import RobotInvalid
from guidefield.messages.replies import RobotSummary
from guidefield.robot.catalog.library import Entry
from guidefield.robot.catalog.sent import SentRobot
from guidefield.robot.mjcf.compilation import compile_text, is_mjcf
from guidefield.robot.mjcf.conversion import convert, root_is_fixed
from guidefield.robot.model import card as cards
from guidefield.robot.model.ball_joints import with_ball_joints
from guidefield.robot.model.card import RobotCard
from guidefield.robot.model.followers import unwrapped
from guidefield.robot.model.loading import default_tip
from guidefield.robot.model.neutral_names import neutral_names
from guidefield.robot.urdf import srdf
from guidefield.robot.urdf.encoding import read_xml
from guidefield.robot.urdf.facts import JOINT_DOF
from guidefield.robot.urdf.meshes import MeshResolver
from guidefield.robot.urdf.native_stderr import captured_stderr
from guidefield.robot.urdf.urdf_validation import check_urdf

MOVABLE = ("revolute", "continuous", "prismatic", "planar", "floating")
ROOT_KINDS = {"planar": "planar", "free": "floating"}
"""Kind of the joint between the world and a root that moves."""
DEGREES = {**JOINT_DOF, "spherical": 3}
"""Degrees of freedom by kind of joint."""


def summarize(entry: Entry) -> RobotSummary:
    """Joints, groups and tip of a robot of the catalog; or what is wrong with it."""
    card, path = entry.card, entry.folder / entry.card.urdf
    described = read_xml(entry.folder / card.srdf) if card.srdf else None
    line = RobotSummary(name=entry.name, source=entry.source, family=entry.family)
    return _summary(line, read_xml(path), described, card, MeshResolver.for_catalog(path))


def summarize_sent(robot: SentRobot, package_dirs: Iterable[Path]) -> RobotSummary:
    """The same about a robot that a client stored; it may take meshes from those folders too."""
    line = RobotSummary(name=robot.name, source="stored", family=robot.name)
    card = msgspec.structs.replace(cards.EMPTY, root_joint=robot.root_joint)
    if not is_mjcf(robot.urdf):
        return _summary(line, robot.urdf, robot.srdf, card, MeshResolver.for_wire(package_dirs, robot.meshes))
    try:
        compiled = compile_text(robot.urdf)
        converted = convert(compiled, robot.name, robot.root_joint)
    except RobotInvalid as error:
        return msgspec.structs.replace(line, problem=str(error))
    root = "fixed" if root_is_fixed(compiled.model, robot.root_joint) else robot.root_joint
    card = msgspec.structs.replace(card, root_joint=root, ball_joints=list(converted.balls))
    return _summary(line, converted.urdf, robot.srdf, card, MeshResolver(given=converted.meshes))


def _summary(
    line: RobotSummary, urdf: str, srdf_text: str | None, card: RobotCard, resolver: MeshResolver
) -> RobotSummary:
    try:
        facts = check_urdf(urdf, resolver)
        described = srdf.parse(srdf_text) if srdf_text else srdf.Srdf()
        with captured_stderr():
            names = neutral_names(facts.text)
            model = pin.buildModelFromXML(names.text)
            names.restore(model)
    except (RobotInvalid, ValueError) as error:
        return msgspec.structs.replace(line, problem=str(error))
    model = with_ball_joints(line.name, model, card.ball_joints)
    otherwise = {**dict.fromkeys(card.ball_joints, "spherical"), **dict.fromkeys(unwrapped(facts), "revolute")}
    kinds = Counter(
        otherwise.get(joint.name, joint.kind)
        for joint in facts.joints.values()
        if joint.kind in MOVABLE and joint.name not in facts.mimics
    )
    if card.root_joint != "fixed":
        kinds[ROOT_KINDS[card.root_joint]] += 1
    return msgspec.structs.replace(
        line,
        dof=sum(DEGREES[kind] * count for kind, count in kinds.items()),
        joint_kinds=dict(kinds),
        mimics=len(facts.mimics),
        groups=sorted({*described.groups, *(["default"] if card.group else [])}),
        tip=default_tip(model, described, card),
        problem=None if facts.collisions else "it has no collision geometry: kinematics alone are answered",
    )
