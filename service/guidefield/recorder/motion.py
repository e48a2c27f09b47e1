"""The motion that a recording shows, timed or the best partial path, and placements of joints and links along it.

A motion whose clearance was measured is shown at the samples of that (`planner/quality.py`), of which `SHOWN_RATE` and
`FRAMES` leave some out; by these and `SHOWN_STEP` others are sampled, and by `SHOWN_SPEED` a path without times gets
some. They change recordings alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.errors import InvalidConfiguration
from guidefield.geometry.surfaces import frames
from guidefield.kernels.kinematics.forward_kinematics import FrameTable, place_frames
from guidefield.messages import replies as messages
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import JointSetGoal, JointsGoal, PlanRequest
from guidefield.planner.motion.trajectory import Trajectory
from guidefield.planner.quality import ClearanceProfile
from guidefield.read_only import read_only
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.kinematics import joints_of
from guidefield.robot.model.configuration import LENGTHS, values_from_wire
from guidefield.robot.model.joints import (
    Configuration,
    Configurations,
    JointKind,
    LocalPoints,
    LocalRates,
    ModelConfigurations,
    Tangents,
    WireColumns,
)
from guidefield.robot.model.model import frame_index

SHOWN_SPEED = 1.0  # speed of the quickest joint along a path that has no times [rad/s or m/s]
SHOWN_STEP = 0.05  # largest change of a joint between two frames of such a path [rad or m]
SHOWN_RATE = 30.0  # most frames a second of a trajectory [Hz], within `FRAMES`
FRAMES = (60, 400)  # least and largest number of frames of a motion
AT_ORIGIN = np.eye(4)[:3].copy()
"""Placement of the model in the world, shape (3, 4) [m]: its first joints are placed there already."""


@dataclass(frozen=True, eq=False)
class ShownMotion:
    """Configurations (n, nq) at times (n,) [s] from 0; untimed, they are those of a path shown at `SHOWN_SPEED`."""

    times: np.ndarray
    configurations: Configurations
    timed: bool


def shown_motion(
    group: PlanningGroup, reply: PlanReply, profile: ClearanceProfile | None, start: Configuration | None
) -> ShownMotion:
    """Return the motion to show for a reply: the samples of the clearance profile, the trajectory, or the path.

    Without any of these it is a start (nq,), by default that of the request.
    """
    if profile is not None and len(profile.times):
        return ShownMotion(profile.times, profile.configurations, timed=True)
    if reply.trajectory is not None and reply.trajectory.times:
        return _between_knots(group, reply.trajectory)
    if reply.path:
        return _sample_path(group, reply.path)
    q = group.q_origin if start is None else start
    return ShownMotion(np.zeros(1), q[None], timed=False)


def refused_goal(group: PlanningGroup, request: PlanRequest, reply: PlanReply) -> Configuration | None:
    """Return the goal's first configuration (nq,), if the plan failed because it can't end there; else None."""
    step = reply.status.details.get("step")
    goal = request.goal if step is None else request.steps[step].goal
    if reply.status.details.get("stage") != "goal" or not isinstance(goal, JointsGoal | JointSetGoal):
        return None
    positions = goal.positions if isinstance(goal, JointsGoal) else goal.positions[0]
    q = group.q_origin.copy()
    for joint in group.joints:
        if joint.name in positions:
            value = values_from_wire(joint, positions[joint.name], InvalidConfiguration)
            q[joint.idx_q : joint.idx_q + joint.nq] = value
    return q


def configurations_of(group: PlanningGroup, rows: Sequence[Sequence[float]]) -> Configurations:
    """Return configurations (n, nq) of a reply's rows of position columns."""
    if not group.is_euclidean:
        return np.array([_configuration(group, row) for row in rows])
    columns = np.array(rows, float).reshape(len(rows), len(group.joints)).T
    turns = [joint.kind is JointKind.CONTINUOUS for joint in group.joints]
    parts = [(np.cos(c), np.sin(c)) if turn else (c,) for c, turn in zip(columns, turns, strict=True)]
    return np.column_stack([part for pair in parts for part in pair])


def position_rows(group: PlanningGroup, configurations: Configurations) -> WireColumns:
    """Return the wire's position columns (n, k) of configurations (n, nq) in order, angles unwrapped."""
    return np.array(group.wire_rows(group.local_path(list(configurations))))


@dataclass(frozen=True, eq=False)
class Curves:
    """A trajectory as it is plotted, at times (n,) [s]."""

    times: np.ndarray
    positions: WireColumns  # in the wire's position columns, shape (n, k) [rad, m, or entries of a quaternion]
    velocities: Tangents  # in the tangent space, shape (n, nv) [rad/s or m/s, and per s]
    accelerations: Tangents


def curves(group: PlanningGroup, trajectory: messages.Trajectory) -> Curves:
    """Return a reply's trajectory to plot, sampled between its knots too if its columns are plain coordinates."""
    knots = Curves(*(np.array(getattr(trajectory, name)) for name in trajectory.__struct_fields__))
    if not group.is_euclidean:
        return knots
    # the columns are the local coordinates, and the tangents are their rates
    curve = Trajectory(knots.times, cast(LocalPoints, knots.positions), cast(LocalRates, knots.velocities))
    times = _shown_times(curve.times)
    positions, velocities, accelerations = curve.evaluate(times)
    columns = cast(WireColumns, positions)
    return Curves(times, columns, cast(Tangents, velocities), cast(Tangents, accelerations))


def _configuration(group: PlanningGroup, row: Sequence[float]) -> Configuration:
    parts, at = [], 0
    for joint in group.joints:
        count = LENGTHS.get(joint.kind, 1)
        value = list(row[at : at + count]) if joint.kind in LENGTHS else row[at]
        parts.append(values_from_wire(joint, value, InvalidConfiguration))
        at += count
    return np.concatenate(parts)


def _between_knots(group: PlanningGroup, trajectory: messages.Trajectory) -> ShownMotion:
    """Sample a trajectory: by its curve if columns are plain coordinates, else straight from knot to knot."""
    if group.is_euclidean:
        plotted = curves(group, trajectory)
        return ShownMotion(plotted.times, configurations_of(group, plotted.positions.tolist()), timed=True)
    knots, qs = np.array(trajectory.times), configurations_of(group, trajectory.positions)
    times = _shown_times(knots)
    before = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, max(len(knots) - 2, 0))
    after = np.minimum(before + 1, len(knots) - 1)
    shares = (times - knots[before]) / np.where(after > before, knots[after] - knots[before], 1.0)
    between = zip(before, after, shares, strict=True)
    return ShownMotion(
        times, np.array([group.interpolate(qs[i], qs[j], float(share)) for i, j, share in between]), timed=True
    )


def frames_of(times: np.ndarray) -> int:
    """Return the number of frames between the first and the last of some times (n,) [s]."""
    return int(np.clip(np.ceil((times[-1] - times[0]) * SHOWN_RATE), *FRAMES))


def _shown_times(knots: np.ndarray) -> np.ndarray:
    count = frames_of(knots)
    return np.union1d(np.linspace(knots[0], knots[-1], count), knots)


def _sample_path(group: PlanningGroup, path: Sequence[Sequence[float]]) -> ShownMotion:
    """Sample a path of position rows evenly, to be shown at an even speed."""
    rows = group.local_path(list(configurations_of(group, path)))
    lengths = np.abs(np.diff(rows, axis=0)).max(axis=1, initial=0.0)
    arc = np.concatenate([[0.0], np.cumsum(lengths)])
    shown = np.linspace(0.0, arc[-1], 1 + int(np.ceil(arc[-1] / SHOWN_STEP)))
    filled = np.column_stack([np.interp(shown, arc, column) for column in rows.T])
    return ShownMotion(shown / SHOWN_SPEED, np.array([group.from_local(row) for row in filled]), timed=False)


@dataclass(frozen=True, eq=False)
class Poses:
    """Placements of a robot's joints and tip at n configurations."""

    joints: tuple[int, ...]  # pinocchio's indices
    placements: np.ndarray  # position and quaternion (x, y, z, w), shape (n, joints, 7) [m, world]
    tip: np.ndarray  # positions of the tip, shape (n, 3) [m, world]


def poses(group: PlanningGroup, configurations: Sequence[Configuration] | Configurations) -> Poses:
    """Place every joint and the tip at n configurations (nq,)."""
    joints = tuple(range(1, group.model.njoints))
    expanded = _expand_each(group, configurations)
    placements = np.empty((len(expanded), len(joints) + 1, 7))
    place_frames(joints_of(group), _joints_and_tip(group, group.tip_id), AT_ORIGIN, expanded, placements)
    return Poses(joints, placements[:, :-1], placements[:, -1, :3])


@memoized_for_alike
def _joints_and_tip(group: PlanningGroup, tip: int) -> FrameTable:
    count = group.model.njoints
    return _frame_table([*((joint, np.eye(4)[:3]) for joint in range(1, count)), _find_carrier(group, tip)])


def link_placements(group: PlanningGroup, configurations: Configurations, links: tuple[str, ...]) -> np.ndarray:
    """Return placements of some links at configurations (n, nq), shape (n, links, 3, 4) [m, world]."""
    expanded = _expand_each(group, configurations)
    rows = placed_links(group, expanded, links).reshape(-1, 7)
    return frames(rows[:, :3], rows[:, 3:]).reshape(len(expanded), len(links), 3, 4)


def _expand_each(group: PlanningGroup, configurations: Sequence[Configuration] | Configurations) -> ModelConfigurations:
    expanded = np.array([group.expand(q) for q in configurations], float)
    return cast(ModelConfigurations, expanded.reshape(-1, group.model.nq))


def placed_links(group: PlanningGroup, expanded: ModelConfigurations, links: tuple[str, ...]) -> np.ndarray:
    """Return positions and quaternions of links at the model's configurations (n, model.nq), (n, links, 7) [world]."""
    placed = np.empty((len(expanded), len(links), 7))
    place_frames(joints_of(group), _links(group, links), AT_ORIGIN, np.ascontiguousarray(expanded), placed)
    return placed


@memoized_for_alike
def _links(group: PlanningGroup, links: tuple[str, ...]) -> FrameTable:
    indices = [frame_index(group.model, link) for link in links]
    return _frame_table([_find_carrier(group, index) for index in indices if index is not None])


def _find_carrier(group: PlanningGroup, frame: int) -> tuple[int, np.ndarray]:
    """Return the joint that carries a frame, and the frame's placement in it, shape (3, 4) [m]."""
    there = group.model.frames[frame]
    return int(there.parentJoint), there.placement.homogeneous[:3]


def _frame_table(carried: Sequence[tuple[int, np.ndarray]]) -> FrameTable:
    table = FrameTable(
        np.array([joint for joint, _ in carried], np.int64),
        np.array([placement for _, placement in carried], float).reshape(-1, 3, 4),
    )
    read_only(*table)
    return table
