"""MuJoCo beside Pinocchio: a robot from an MJCF is placed, link by link and shape by shape, as MuJoCo places it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.errors import RobotInvalid
from guidefield.robot.mjcf.compilation import import_mujoco
from guidefield.robot.mjcf.names import body_names
from guidefield.robot.model.followers import follow
from guidefield.robot.model.model import RobotModel
from guidefield.robot.model.spaces import RobotConfiguration

SAME = 1e-9
"""Placements that differ by more than this [m, or 1], for each metre from the world's origin, are not the same."""
TRIALS = 3
"""Random configurations at which placements are compared, beside the one at rest."""
FAR = 1.0
"""Joints without limits are drawn within this of their zero [rad or m]."""


def check_placements(
    robot: RobotModel, model: Any, joints: Mapping[int, str], geoms: Mapping[str, Sequence[int]]
) -> None:
    """Compare the placements of bodies and collision shapes with MuJoCo's.

    Args:
        robot: What was loaded.
        model: `mujoco.MjModel`.
        joints: Name of each joint that moves, by MuJoCo's index.
        geoms: MuJoCo's indices of the geoms behind each link's <collision>, in their order.

    Raises:
        RobotInvalid: if a body or shape stands elsewhere by more than `SAME`; names it.
    """
    mujoco, rng = import_mujoco(), np.random.default_rng(0)
    model.geom_sameframe[:] = 0  # else MuJoCo takes a geom within 1e-6 of its body's inertia for being there
    data, placed, shapes = mujoco.MjData(model), robot.model.createData(), robot.geometry.createData()
    named = {name: index for index, name in enumerate(body_names(model))}
    frames = {name: robot.model.getFrameId(name, pin.FrameType.BODY) for name in named}
    behind = {f"{link}_{number}": geom for link, some in geoms.items() for number, geom in enumerate(some)}
    for q in (robot.rest, *(_drawn(robot, rng) for _ in range(TRIALS))):
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
    """MuJoCo's configuration, shape (nq,), at a configuration (robot.model.nq,) of ours; other joints at reference.

    Args:
        robot: What was loaded.
        model: `mujoco.MjModel`.
        joints: Name of each joint that moves, by MuJoCo's index.
        q: Configuration of ours.
    """
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
    if not apart <= SAME * max(1.0, float(np.abs(position).max())):
        raise RobotInvalid(f"MJCF: {what} stands elsewhere than MuJoCo has it, by {apart:.3g}; please report this file")


def _drawn(robot: RobotModel, rng: np.random.Generator) -> RobotConfiguration:
    """A configuration within the limits, shape (nq,); joints that follow others where they belong."""
    q: RobotConfiguration = pin.integrate(robot.model, robot.rest, rng.uniform(-FAR, FAR, robot.model.nv))
    for joint in robot.joints:
        if joint.nq == 1:
            lower, upper = max(float(joint.lower[0]), -FAR), min(float(joint.upper[0]), FAR)
            q[joint.idx_q] = rng.uniform(lower, max(lower, upper))
    follow(robot.joints, q)
    return q
