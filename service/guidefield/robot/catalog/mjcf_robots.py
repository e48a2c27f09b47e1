"""Load robots from MJCF.

A robot is refused if its placements differ from MuJoCo's: by `PLACEMENT_TOLERANCE`, which has to be above rounding, at
`TRIALS` configurations, of which more would find rarer faults.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin

from guidefield.errors import RobotInvalid
from guidefield.messages.values import RootJoint
from guidefield.robot.mjcf.compilation import CompiledModel, body_names, import_mujoco
from guidefield.robot.mjcf.conversion import convert, root_is_fixed
from guidefield.robot.model import card as cards
from guidefield.robot.model.loading import load
from guidefield.robot.model.model import RobotModel, RobotSource
from guidefield.robot.model.pairs import random_configuration
from guidefield.robot.model.spaces import RobotConfiguration
from guidefield.robot.urdf import srdf
from guidefield.robot.urdf.meshes import MeshResolver

_LINE = re.compile(r"^line \d+: ")
"""The line number at the beginning of sentences about a generated URDF, which nobody can look up."""


def load_mjcf(name: str, compiled: CompiledModel, srdf_text: str | None, root_joint: RootJoint) -> RobotModel:
    """Load a compiled MJCF; states and pairs of an SRDF come before those of the MJCF.

    Raises:
        RobotInvalid: if it can't be used, with the element at fault.
    """
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


PLACEMENT_TOLERANCE = 1e-9
"""Placements that differ by more than this [m, or 1], for each metre from the world's origin, are not the same."""
TRIALS = 3  # random configurations at which placements are compared, beside the one at rest


def check_placements(
    robot: RobotModel, model: Any, joints: Mapping[int, str], geoms: Mapping[str, Sequence[int]]
) -> None:
    """Compare the placements of bodies and collision shapes with MuJoCo's.

    Args:
        geoms: MuJoCo's indices of the geoms behind each link's <collision>, in their order.

    Raises:
        RobotInvalid: if a body or shape stands elsewhere by more than `PLACEMENT_TOLERANCE`; names it.
    """
    mujoco, rng = import_mujoco(), np.random.default_rng(0)
    model.geom_sameframe[:] = 0  # else MuJoCo takes a geom within 1e-6 of its body's inertia for being there
    data, placed, shapes = mujoco.MjData(model), robot.model.createData(), robot.geometry.createData()
    named = {name: index for index, name in enumerate(body_names(model))}
    frames = {name: robot.model.getFrameId(name, pin.FrameType.BODY) for name in named}
    behind = {f"{link}_{number}": geom for link, some in geoms.items() for number, geom in enumerate(some)}
    drawn = (random_configuration(robot.model, robot.joints, rng, robot.size) for _ in range(TRIALS))
    for q in (robot.rest, *drawn):
        data.qpos[:] = mujoco_configuration(robot, model, joints, q)
        mujoco.mj_kinematics(model, data)
        pin.framesForwardKinematics(robot.model, placed, q)
        pin.updateGeometryPlacements(robot.model, placed, robot.geometry, shapes, q)
        for name, body in named.items():
            _compare(f"body {name!r}", placed.oMf[frames[name]], data.xpos[body], data.xmat[body])
        for shape, at in zip(robot.geometry.geometryObjects, shapes.oMg, strict=True):
            geom = behind[shape.name]
            _compare(f"shape {shape.name!r}", at, data.geom_xpos[geom], data.geom_xmat[geom])


def mujoco_configuration(robot: RobotModel, model: Any, joints: Mapping[int, str], q: RobotConfiguration) -> np.ndarray:
    """Return MuJoCo's configuration, shape (nq,), at one of ours (robot.model.nq,); other joints at reference."""
    theirs = np.array(model.qpos0)
    for index, name in joints.items():
        joint = robot.joint(name)
        assert joint is not None, "joints of an MJCF keep their names"
        values, address = q[joint.idx_q : joint.idx_q + joint.nq], int(model.jnt_qposadr[index])
        if joint.nq == 2:
            theirs[address] = np.arctan2(values[1], values[0])
        elif joint.nq == 1:
            theirs[address] = values[0]
        else:  # a quaternion at the end: w comes first there
            theirs[address : address + joint.nq] = [*values[:-4], values[-1], *values[-4:-1]]
    return theirs


def _compare(what: str, ours: Any, position: np.ndarray, rotation: np.ndarray) -> None:
    apart = max(np.abs(ours.translation - position).max(), np.abs(ours.rotation.ravel() - rotation).max())
    if not apart <= PLACEMENT_TOLERANCE * max(1.0, float(np.abs(position).max())):
        raise RobotInvalid(f"MJCF: {what} stands elsewhere than MuJoCo has it, by {apart:.3g}; please report this file")
