"""Named sets of joints: from an SRDF's groups to the movable joints that they mean."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from guidefield.robot.model.frames import moving_joint
from guidefield.robot.model.model import Joint
from guidefield.robot.urdf.srdf import Srdf, SrdfChain


def resolve_groups(model: Any, described: Srdf, joints: Sequence[Joint]) -> dict[str, tuple[str, ...]]:
    """Joints of each SRDF group that can be planned for, in Pinocchio's order; empty groups are left out."""
    plannable = [joint.name for joint in joints if joint.mimic is None]
    resolved = {}
    for name in described.groups:
        members = _members(model, described, name, frozenset())
        if ordered := tuple(joint for joint in plannable if joint in members):
            resolved[name] = ordered
    return resolved


def joints_to(model: Any, frame: str) -> list[str]:
    """Names of the joints between the root and a frame, from the root on."""
    return [model.names[index] for index in model.supports[moving_joint(model, frame)] if index]


def _members(model: Any, described: Srdf, name: str, visiting: frozenset[str]) -> set[str]:
    """Joint names in a group; a group that contains itself adds nothing."""
    if name in visiting or name not in described.groups:
        return set()
    group = described.groups[name]
    members = set(group.joints)
    for link in group.links:
        if joint := moving_joint(model, link):
            members.add(model.names[joint])
    for chain in group.chains:
        members |= _chain_joints(model, chain)
    for inner in group.groups:
        members |= _members(model, described, inner, visiting | {name})
    return members


def _chain_joints(model: Any, chain: SrdfChain) -> set[str]:
    return set(joints_to(model, chain.tip)) - set(joints_to(model, chain.base))
