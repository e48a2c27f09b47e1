"""Named sets of joints: from an SRDF's groups to the movable joints that they mean."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from guidefield.robot.model.frames import moving_joint
from guidefield.robot.model.model import Joint
from guidefield.robot.urdf.srdf import Srdf, SrdfGroup


def resolve_groups(
    model: Any, described: Srdf, joints: Sequence[Joint], warnings: list[str]
) -> dict[str, tuple[str, ...]]:
    """Return the joints of SRDF groups that can be planned for, in Pinocchio's order; warn of groups without any."""
    plannable = [joint.name for joint in joints if joint.is_driven]
    resolved = {}
    for name in described.groups:
        members = _members(model, described, name, frozenset())
        if ordered := tuple(joint for joint in plannable if joint in members):
            resolved[name] = ordered
        else:
            warnings.append(
                f"the SRDF's group {name!r} is left out: {_reason(described.groups[name], members, joints)}"
            )
    return resolved


def _reason(group: SrdfGroup, members: set[str], joints: Sequence[Joint]) -> str:
    kinds = {joint.name: "mimic" if joint.mimic is not None else "passive" for joint in joints}
    if moving := sorted(members & kinds.keys()):
        return f"its joints don't move by themselves ({', '.join(f'{name} is {kinds[name]}' for name in moving)})"
    return "it is empty" if group == SrdfGroup() else "no joint that moves is among what it names"


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
        members |= {*joints_to(model, chain.tip)} - {*joints_to(model, chain.base)}
    for inner in group.groups:
        members |= _members(model, described, inner, visiting | {name})
    return members
