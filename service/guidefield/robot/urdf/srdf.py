"""What an SRDF says: groups, named states, end effectors and pairs of links not to test."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field

from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.messages.requests import Positions
from guidefield.robot.urdf.xml import root_of


@dataclass(frozen=True)
class SrdfChain:
    """All joints from a base link to a tip link."""

    base: str
    tip: str


@dataclass(frozen=True)
class SrdfGroup:
    """A group as written: joints, links (each stands for its parent joint), chains and other groups."""

    joints: tuple[str, ...] = ()
    links: tuple[str, ...] = ()
    chains: tuple[SrdfChain, ...] = ()
    groups: tuple[str, ...] = ()


@dataclass(frozen=True)
class Srdf:
    """The parts of an SRDF that planning needs.

    Attributes:
        groups: By name.
        states: Joint values by state name; a joint with several numbers has a list of them.
        end_effectors: Parent link and group of each end effector.
        disabled: Pair of links to the reason given.
    """

    groups: dict[str, SrdfGroup] = field(default_factory=dict)
    states: dict[str, Positions] = field(default_factory=dict)
    end_effectors: tuple[tuple[str, str], ...] = ()
    disabled: dict[frozenset[str], str] = field(default_factory=dict)


def parse(text: str) -> Srdf:
    """Read an SRDF.

    Raises:
        RobotInvalid: if it is too long, isn't XML, has a DOCTYPE, its root isn't <robot>, or a state's value is no
            finite number.
    """
    root = root_of(text, "SRDF")
    if root.tag != "robot":
        raise RobotInvalid(f"the SRDF's root element must be <robot>, it is <{root.tag}>", line=root.sourceline)
    return Srdf(
        groups={group.get("name", ""): _group(group) for group in root.findall("group")},
        states={state.get("name", ""): _state(state) for state in root.findall("group_state")},
        end_effectors=tuple((e.get("parent_link", ""), e.get("group", "")) for e in root.findall("end_effector")),
        disabled={
            frozenset((pair.get("link1", ""), pair.get("link2", ""))): pair.get("reason", "unspecified")
            for pair in root.findall("disable_collisions")
        },
    )


def _group(element: etree._Element) -> SrdfGroup:
    return SrdfGroup(
        joints=tuple(e.get("name", "") for e in element.findall("joint")),
        links=tuple(e.get("name", "") for e in element.findall("link")),
        chains=tuple(SrdfChain(e.get("base_link", ""), e.get("tip_link", "")) for e in element.findall("chain")),
        groups=tuple(e.get("name", "") for e in element.findall("group")),
    )


def _state(element: etree._Element) -> Positions:
    values: Positions = {}
    for joint in element.findall("joint"):
        try:
            numbers = [float(number) for number in joint.get("value", "").split()]
        except ValueError:
            numbers = []
        if not numbers or not all(map(math.isfinite, numbers)):
            raise RobotInvalid(
                f"the SRDF's state {element.get('name')!r} gives joint {joint.get('name')!r} the value "
                f"{joint.get('value')!r}, which is no number",
                line=joint.sourceline,
            )
        values[joint.get("name", "")] = numbers if len(numbers) > 1 else numbers[0]
    return values


def unknown_names(described: Srdf, links: Collection[str], joints: Collection[str]) -> list[str]:
    """A sentence for each kind of name in an SRDF that the robot doesn't have; such entries mean nothing.

    Args:
        described: The SRDF.
        links: The robot's links.
        joints: Its joints, fixed ones too.
    """
    pairs = {name for pair in described.disabled for name in pair} - set(links)
    moved = {name for group in described.groups.values() for name in group.joints} - set(joints)
    moved |= {name for values in described.states.values() for name in values} - set(joints)
    grouped = {name for group in described.groups.values() for name in group.links} - set(links)
    grouped |= {name for g in described.groups.values() for c in g.chains for name in (c.base, c.tip)} - set(links)
    told = (("pairs", "link", pairs), ("groups and states", "joint", moved), ("groups", "link", grouped))
    return [f"the SRDF's {what} name {_some(kind, names)}" for what, kind, names in told if names]


def _some(kind: str, names: Collection[str]) -> str:
    first, *others = sorted(names)
    more = f" and {len(others)} more" if others else ""
    return f"{kind} {first!r}{more}, which the robot doesn't have"
