"""Recognize chains of links joined by ball or universal joints alone, for the thesis' own minimizer ('univariate').

kernels/kinematics/link_chain.py reads the tables; robots that aren't such chains are refused with the reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from guidefield.errors import InvalidGroup
from guidefield.kernels.kinematics.forward_kinematics import JointTable, joint_placements
from guidefield.kernels.kinematics.link_chain import BALL, FREE, UNIVERSAL, LinkChain
from guidefield.read_only import read_only
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.link_charges import robot_charges
from guidefield.robot.model.joints import Configuration, JointKind
from guidefield.robot.model.model import joint_table

SAME_PLACE = 1e-9  # two revolute joints whose origins are nearer than this are one universal joint [m]
SQUARE = 1e-6  # axes of a universal joint are square to each other, and the second one to its link, up to this cosine


@dataclass(frozen=True, eq=False)
class SerialChain:
    """A group of joints as a chain of links."""

    group: PlanningGroup
    joints: JointTable  # the joints of the group's model
    table: LinkChain  # the chain as the kernels read it
    # whether its first joint is the tip, and nothing holds it (a moving base); else the last link ends in it
    leads: bool
    parent_joints: np.ndarray  # index in the group's model of the joint that carries each link, shape (n,)

    @property
    def n(self) -> int:
        """The number of links."""
        return len(self.parent_joints)

    def places(self, q: Configuration) -> tuple[np.ndarray, np.ndarray]:
        """Return places of joints and end (n + 1, 3) [m] and rotations of links (n, 3, 3) at a configuration (nq,)."""
        placements = np.empty((len(self.joints.parents), 3, 4))
        joint_placements(self.joints, q, placements)
        links = placements[self.parent_joints]
        rotations = np.ascontiguousarray(links[:, :, :3])
        end = rotations[-1] @ self.table.links[-1] + links[-1, :, 3]
        return np.vstack([links[:, :, 3], end]), rotations


def link_chain(group: PlanningGroup) -> SerialChain:
    """Return a group of joints as a chain of links.

    Raises:
        InvalidGroup: if it isn't one of ball joints or universal joints alone, standing still or floating freely.
    """
    model = group.model
    if group.space is not model:
        raise _unfit(group, "other joints follow its own")
    for index in range(1, model.njoints):
        if model.parents[index] != index - 1:
            raise _unfit(group, f"it branches at joint {model.names[index]!r}")
    ends, kinds, at = _links_of(group)
    table, n = joint_table(model), len(ends)
    frames, between = np.tile(np.eye(3), (n, 1, 1)), np.tile(np.eye(3), (n, 1, 1))
    axes = np.zeros((2, n, 3))
    circling = np.zeros((n, 2), np.int64)
    for k, joint in enumerate(ends):
        first = joint - 1 if kinds[k] == UNIVERSAL else joint
        frames[k] = model.jointPlacements[first].rotation
        if kinds[k] == UNIVERSAL:
            between[k] = model.jointPlacements[joint].rotation
            axes[:, k] = table.axes[first], table.axes[joint]
            circling[k] = [model.joints[i].nq == 2 for i in (first, joint)]
    leads = kinds[0] == FREE
    links = np.array([model.jointPlacements[joint + 1].translation for joint in ends[:-1]]).reshape(-1, 3)
    links = np.vstack([links, _last_link(group, ends[-1], leads)])
    _check(group, links, axes, between, kinds, leads)
    origin = np.array(model.jointPlacements[1].translation)
    chain = LinkChain(
        np.array(kinds, np.int64), np.array(at, np.int64), frames, origin, links, axes[0], axes[1], between, circling
    )
    parent_joints = np.array(ends, np.int64)
    read_only(*chain, parent_joints)
    return SerialChain(group, table, chain, leads, parent_joints)


def _links_of(group: PlanningGroup) -> tuple[list[int], list[int], list[tuple[int, int]]]:
    """Return for each link the joint that carries it, the kind of its joint, and where its values stand."""
    model = group.model
    ends, kinds, at = [], [], []
    turning = (JointKind.REVOLUTE, JointKind.CONTINUOUS)
    index = 1
    while index < model.njoints:
        kind, idx_q = _kind(group, index), model.joints[index].idx_q
        if kind is JointKind.SPHERICAL:
            kinds.append(BALL)
            at.append((idx_q, idx_q))
        elif kind is JointKind.FLOATING and index == 1:
            kinds.append(FREE)
            at.append((idx_q, idx_q))
        elif kind in turning and index + 1 < model.njoints and _kind(group, index + 1) in turning:
            index += 1
            if float(np.linalg.norm(model.jointPlacements[index].translation)) > SAME_PLACE:
                raise _unfit(
                    group, f"{model.names[index - 1]!r} and {model.names[index]!r} turn about different places"
                )
            kinds.append(UNIVERSAL)
            at.append((idx_q, model.joints[index].idx_q))
        else:
            raise _unfit(group, f"joint {model.names[index]!r} is {kind.value}")
        ends.append(index)
        index += 1
    return ends, kinds, at


def _kind(group: PlanningGroup, index: int) -> JointKind:
    joint = group.robot.joint(group.model.names[index])
    assert joint is not None, "a group's joints are the robot's"
    return joint.kind


def _last_link(group: PlanningGroup, joint: int, leads: bool) -> np.ndarray:
    """Return the last link from its joint to its end (3,): the tip, or if the tip leads the far end of its shape."""
    tip = group.model.frames[group.tip_id]
    if leads:
        if tip.parentJoint != 1 or float(np.linalg.norm(tip.placement.translation)) > SAME_PLACE:
            raise _unfit(group, f"its tip {group.tip!r} isn't where its floating joint is")
    elif tip.parentJoint != joint:
        raise _unfit(group, f"its tip {group.tip!r} isn't on its last link")
    else:
        return np.array(tip.placement.translation)
    farthest = np.zeros(3)
    for charged, shape in zip(robot_charges(group.robot).shapes, group.geometry.geometryObjects, strict=True):
        if shape.parentJoint == joint:
            for end in (charged.capsule.p0, charged.capsule.p1):
                place = shape.placement.act(end)
                if np.linalg.norm(place) > np.linalg.norm(farthest):
                    farthest = place
    return farthest


def _check(
    group: PlanningGroup, links: np.ndarray, axes: np.ndarray, between: np.ndarray, kinds: list[int], leads: bool
) -> None:
    short = np.flatnonzero(np.linalg.norm(links, axis=1) < 1e-6)
    if len(short):
        raise _unfit(group, f"its link {short[0] + 1} has no length")
    for k, kind in enumerate(kinds):
        if kind == UNIVERSAL:
            square = abs(float(axes[0, k] @ between[k] @ axes[1, k]))
            along = abs(float(axes[1, k] @ links[k])) / float(np.linalg.norm(links[k]))
            if max(square, along) > SQUARE:
                raise _unfit(group, f"the axes of its joint {k + 1} aren't square to each other and to the link")
    if not leads and len(kinds) < 2:
        raise _unfit(group, "a fixed chain of one link has no way to slide")


def _unfit(group: PlanningGroup, why: str) -> InvalidGroup:
    names: list[Any] = [joint.name for joint in group.joints]
    return InvalidGroup(
        "minimizer 'univariate' is for chains of ball joints, or of universal joints (two revolute joints in one"
        f" place), that stand still or float: {why}; use 'projected'",
        joints=names,
    )
