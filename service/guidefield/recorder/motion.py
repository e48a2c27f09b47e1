"""The motion that a recording shows, whatever came out of the plan: certified and timed, or the best partial path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.messages import replies as messages
from guidefield.messages.replies import PlanReply
from guidefield.planner.quality import ClearanceProfile
from guidefield.planner.trajectory import Trajectory
from guidefield.robot.group import PlanningGroup

SHOWN_SPEED = 1.0
"""How fast the quickest joint moves along a path that has no times [rad/s or m/s]."""

SHOWN_STEP = 0.02
"""Largest change of a joint between two frames of such a path [rad or m]."""


SHOWN_RATE = 30.0
"""Frames a second of a trajectory [Hz], within `FRAMES`."""

FRAMES = (60, 400)


@dataclass(frozen=True, eq=False)
class Motion:
    """Configurations of the planning group over time.

    Attributes:
        times: Shape (n,) [s], from 0.
        configurations: Shape (n, nq).
        timed: Whether the times are the plan's; else a path without times is shown at `SHOWN_SPEED`.
    """

    times: np.ndarray
    configurations: np.ndarray
    timed: bool


def shown_motion(
    group: PlanningGroup, reply: PlanReply, profile: ClearanceProfile | None, start: np.ndarray | None
) -> Motion:
    """The motion to show for a reply.

    Args:
        group: The joints that were planned for.
        reply: The reply; its trajectory is shown, else its path.
        profile: Samples of the trajectory, if it was measured; they are shown before its knots.
        start: Configuration (nq,) to show if the reply has neither; None for that of the request.
    """
    if profile is not None and len(profile.times):
        return Motion(profile.times, profile.configurations, timed=True)
    if reply.trajectory is not None and reply.trajectory.times:
        times, positions, _, _ = curves(reply.trajectory)
        return Motion(times, np.array([group.from_chart(row) for row in positions]), timed=True)
    if reply.path:
        return _untimed(group, np.array(reply.path))
    q = start if start is not None else reference_configuration(group)
    return Motion(np.zeros(1), q[None], timed=False)


def curves(trajectory: messages.Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A reply's trajectory as smooth curves: what happens between its knots too.

    Returns:
        Times (n,) [s]; positions, velocities and accelerations (n, nv).
    """
    knots = Trajectory(
        times=np.array(trajectory.times),
        positions=np.array(trajectory.positions),
        velocities=np.array(trajectory.velocities),
    )
    count = int(np.clip(np.ceil(knots.duration * SHOWN_RATE), *FRAMES))
    times = np.union1d(np.linspace(knots.times[0], knots.times[-1], count), knots.times)
    return times, *knots.evaluate(times)


def reference_configuration(group: PlanningGroup) -> np.ndarray:
    """The group's part (nq,) of the configuration that it was selected at."""
    q = np.empty(group.nq)
    for joint in group.joints:
        whole = group.robot.joint(joint.name)
        assert whole is not None, "a group's joints are the robot's"
        q[joint.idx_q : joint.idx_q + joint.nq] = group.q_reference[whole.idx_q : whole.idx_q + whole.nq]
    return q


def _untimed(group: PlanningGroup, path: np.ndarray) -> Motion:
    """A path of chart rows (n, nv), filled in evenly and shown at an even pace."""
    lengths = np.abs(np.diff(path, axis=0)).max(axis=1, initial=0.0)
    arc = np.concatenate([[0.0], np.cumsum(lengths)])
    shown = np.linspace(0.0, arc[-1], 1 + int(np.ceil(arc[-1] / SHOWN_STEP)))
    rows = np.column_stack([np.interp(shown, arc, column) for column in path.T])
    return Motion(shown / SHOWN_SPEED, np.array([group.from_chart(row) for row in rows]), timed=False)


@dataclass(frozen=True, eq=False)
class Poses:
    """Where a robot's joints and tip are, at n configurations.

    Attributes:
        joints: Pinocchio's indices of the joints in question, in order.
        placements: Position and quaternion (x, y, z, w), shape (n, joints, 7) [m, world].
        tip: Positions of the tip, shape (n, 3) [m, world].
    """

    joints: tuple[int, ...]
    placements: np.ndarray
    tip: np.ndarray


def poses(group: PlanningGroup, configurations: Sequence[np.ndarray] | np.ndarray) -> Poses:
    """Forward kinematics of every joint and of the tip.

    Args:
        group: The joints that were planned for.
        configurations: n configurations (nq,).
    """
    model, data = group.model, group.model.createData()
    joints = tuple(range(1, model.njoints))
    tip_frame = model.frames[group.tip_id]
    placements = np.empty((len(configurations), len(joints), 7))
    tip = np.empty((len(configurations), 3))
    for row, q in enumerate(configurations):
        pin.forwardKinematics(model, data, group.expand(q))
        for column, joint in enumerate(joints):
            placements[row, column] = pin.SE3ToXYZQUAT(data.oMi[joint])
        tip[row] = data.oMi[tip_frame.parentJoint].act(tip_frame.placement.translation)
    return Poses(joints, placements, tip)


def link_placements(group: PlanningGroup, q: np.ndarray, links: Sequence[str]) -> dict[str, Any]:
    """``T_world_link`` (pinocchio.SE3) of some links at a configuration (nq,)."""
    data = group.model.createData()
    pin.framesForwardKinematics(group.model, data, group.expand(q))
    return {link: data.oMf[group.model.getFrameId(link)].copy() for link in links}
