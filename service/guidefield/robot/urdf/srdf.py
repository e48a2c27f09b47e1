"""Read an SRDF: groups, named states, end effectors, virtual and passive joints, and pairs of links not to test."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from typing import Literal

from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.messages.requests import Positions
from guidefield.robot.urdf.xml import drop_xacro, root_of

STATES = ("default", "rest", "home", "ready")
"""Names of states that are preferred as the rest configuration, in this order; else it is the first within limits.

service/docs/robots.md promises it, for MJCF's keyframes, too: another order moves joints that requests leave out."""


@dataclass(frozen=True)
class SrdfChain:
    """All joints from a base link to a tip link."""

    base: str
    tip: str


@dataclass(frozen=True)
class SrdfGroup:
    """A group as written: joints, links (each represents its parent joint), chains and other groups."""

    joints: tuple[str, ...] = ()
    links: tuple[str, ...] = ()
    chains: tuple[SrdfChain, ...] = ()
    groups: tuple[str, ...] = ()


@dataclass(frozen=True)
class SrdfState:
    """A state as written: its group, empty where it names none, and joint values, a list for several numbers."""

    name: str
    group: str
    values: Positions
    line: int


@dataclass(frozen=True)
class Srdf:
    """The parts of an SRDF that planning needs."""

    groups: dict[str, SrdfGroup] = field(default_factory=dict)
    states: tuple[SrdfState, ...] = ()
    end_effectors: tuple[tuple[str, str], ...] = ()  # parent link and group of each end effector
    disabled: dict[frozenset[str], str] = field(default_factory=dict)  # pair of links to the reason given
    untested: tuple[str, ...] = ()  # links that are tested against nothing but what `enabled` names
    enabled: frozenset[frozenset[str]] = frozenset()  # pairs of links to test although one of them is untested
    # type of each virtual joint, by which the robot stands in the world, by name
    virtual: dict[str, str] = field(default_factory=dict)
    passive: tuple[str, ...] = ()  # joints that nothing drives
    warnings: tuple[str, ...] = ()  # what is odd but harmless
    # the format that this was read from. An MJCF says of every pair whether it is tested, an SRDF that disables none
    # says nothing about pairs
    said_by: Literal["SRDF", "MJCF"] = "SRDF"

    def find_disabled(self, links: Iterable[str]) -> dict[frozenset[str], str]:
        """Every pair of a robot's links that isn't to be tested, with the reason."""
        others, pairs = list(links), dict(self.disabled)
        for link in self.untested:
            for other in others:
                pair = frozenset((link, other))
                if other != link and pair not in self.enabled:
                    pairs.setdefault(pair, f"disable_default_collisions of {link}")
        return pairs


def parse(text: str) -> Srdf:
    """Read an SRDF.

    Raises:
        RobotInvalid: if it is too long, isn't XML, has a DOCTYPE, is a xacro file that isn't expanded, its root isn't
            <robot>, or a state's value is no finite number.
    """
    warnings: list[str] = []
    root = root_of(text, "SRDF", warnings)
    drop_xacro(root, warnings)
    if root.tag != "robot":
        raise RobotInvalid(f"the SRDF's root element must be <robot>, it is <{root.tag}>", line=root.sourceline)
    if (link := root.find("link")) is not None:
        warnings.append(f"line {link.sourceline}: <link> is left out: links are those of the URDF; is this a URDF?")
    groups: dict[str, SrdfGroup] = {}
    for group in root.findall("group"):
        if groups.setdefault(name := group.get("name", ""), made := _group(group)) is not made:
            warnings.append(f"line {group.sourceline}: a second group {name!r} is left out")
    return Srdf(
        groups=groups,
        states=tuple(_state(state) for state in root.findall("group_state")),
        end_effectors=tuple((e.get("parent_link", ""), e.get("group", "")) for e in root.findall("end_effector")),
        disabled={_pair(pair): pair.get("reason", "unspecified") for pair in root.findall("disable_collisions")},
        untested=tuple(link.get("link", "") for link in root.findall("disable_default_collisions")),
        enabled=frozenset(_pair(pair) for pair in root.findall("enable_collisions")),
        virtual={joint.get("name", ""): joint.get("type", "") for joint in root.findall("virtual_joint")},
        passive=tuple(joint.get("name", "") for joint in root.findall("passive_joint")),
        warnings=tuple(f"the SRDF: {warning}" for warning in warnings),
    )


def _pair(element: etree._Element) -> frozenset[str]:
    return frozenset((element.get("link1", ""), element.get("link2", "")))


def _group(element: etree._Element) -> SrdfGroup:
    return SrdfGroup(
        joints=tuple(e.get("name", "") for e in element.findall("joint")),
        links=tuple(e.get("name", "") for e in element.findall("link")),
        chains=tuple(SrdfChain(e.get("base_link", ""), e.get("tip_link", "")) for e in element.findall("chain")),
        groups=tuple(e.get("name", "") for e in element.findall("group")),
    )


def _state(element: etree._Element) -> SrdfState:
    values: Positions = {}
    for joint in element.findall("joint"):
        try:
            numbers = [float(number) for number in joint.get("value", "").split()]
        except ValueError:
            numbers = []
        if not numbers or not all(map(math.isfinite, numbers)):
            raise RobotInvalid(
                f"line {joint.sourceline}: the SRDF's state {element.get('name')!r} gives joint {joint.get('name')!r} "
                f"the value {joint.get('value')!r}, which is no number",
                line=joint.sourceline,
            )
        values[joint.get("name", "")] = numbers if len(numbers) > 1 else numbers[0]
    return SrdfState(element.get("name", ""), element.get("group", ""), values, element.sourceline)


def find_unknown_names(described: Srdf, links: Collection[str], joints: Collection[str]) -> list[str]:
    """Return a sentence for each kind of name in an SRDF that the robot doesn't have; such entries mean nothing."""
    pairs = {name for pair in (*described.disabled, *described.enabled) for name in pair} | {*described.untested}
    grouped = {name for group in described.groups.values() for name in group.links}
    grouped |= {name for g in described.groups.values() for c in g.chains for name in (c.base, c.tip)}
    moved = {name for group in described.groups.values() for name in group.joints}
    stated = {name for state in described.states for name in state.values}
    used = (
        ("pairs", "link", pairs - {*links}),
        ("groups", "link", grouped - {*links}),
        ("end effectors", "link", {link for link, _ in described.end_effectors} - {*links}),
        ("groups and states", "joint", (moved | stated) - {*joints}),
        ("passive joints", "joint", {*described.passive} - {*joints}),
        (
            "groups",
            "group",
            {name for group in described.groups.values() for name in group.groups} - {*described.groups},
        ),
        ("states", "group", {state.group for state in described.states} - {*described.groups, ""}),
    )
    return [f"the SRDF's {what} name {_name_all(kind, names)}" for what, kind, names in used if names]


def _name_all(kind: str, names: Collection[str]) -> str:
    plural = "" if len(names) == 1 else "s"
    has = "SRDF" if kind == "group" else "robot"
    return f"{kind}{plural} {', '.join(map(repr, sorted(names)))}, which the {has} doesn't have"
