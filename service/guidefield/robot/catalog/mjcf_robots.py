"""Robots from MJCF: compiled by MuJoCo, loaded as the URDF that they become, and checked against MuJoCo."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import msgspec

from guidefield.errors import RobotInvalid
from guidefield.messages.values import RootJoint
from guidefield.robot.mjcf.compilation import CompiledModel, compile_file, compile_text
from guidefield.robot.mjcf.conversion import convert, root_is_fixed
from guidefield.robot.model import card as cards
from guidefield.robot.model.loading import load
from guidefield.robot.model.model import RobotModel, RobotSource
from guidefield.robot.model.mujoco_crosscheck import check_placements
from guidefield.robot.urdf import srdf
from guidefield.robot.urdf.meshes import MeshResolver

_LINE = re.compile(r"^line \d+: ")
"""Where a sentence about the URDF that an MJCF became begins with a line that nobody has written."""


def load_mjcf_file(path: Path, srdf_text: str | None, root_joint: RootJoint) -> RobotModel:
    """Load an MJCF file.

    Args:
        path: The file; what it includes and names is looked for by MuJoCo.
        srdf_text: An SRDF, whose states and pairs come before those of the MJCF.
        root_joint: How the robot stands in the world.

    Raises:
        RobotInvalid: if it can't be used, with the element at fault.
    """
    return _load(path.stem, compile_file(path), srdf_text, root_joint)


def load_mjcf_text(name: str, text: str, srdf_text: str | None, root_joint: RootJoint) -> RobotModel:
    """Load an MJCF that was sent; it must name no file."""
    return _load(name, compile_text(text), srdf_text, root_joint)


def _load(name: str, compiled: CompiledModel, srdf_text: str | None, root_joint: RootJoint) -> RobotModel:
    converted = convert(compiled, name, root_joint)
    semantics = converted.semantics
    if srdf_text:
        given = srdf.parse(srdf_text)
        states, disabled = (*given.states, *semantics.states), {**semantics.disabled, **given.disabled}
        semantics = dataclasses.replace(given, states=states, disabled=disabled, said_by="MJCF")
    root = "fixed" if root_is_fixed(compiled.model, root_joint) else root_joint
    source = RobotSource(converted.urdf, None, root, compiled.files)
    card = msgspec.structs.replace(cards.EMPTY, ball_joints=list(converted.balls))
    try:
        robot = load(name, source, semantics, card, MeshResolver(given=converted.meshes))
    except RobotInvalid as error:
        raise RobotInvalid(f"MJCF: {_LINE.sub('', error.message)}", **error.details) from None
    check_placements(robot, compiled.model, converted.joints, converted.geoms)
    warnings = (_LINE.sub("", sentence) for sentence in robot.warnings)
    return dataclasses.replace(robot, warnings=(*converted.warnings, *warnings))
