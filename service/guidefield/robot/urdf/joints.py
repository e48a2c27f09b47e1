"""The joints of a URDF: types, limits, axes, and which joint follows which."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping

from guidefield.robot.urdf.facts import JOINT_DOF, SCALAR_JOINTS, JointFacts
from guidefield.robot.urdf.xml import (
    Element,
    check_origins,
    fault,
    leaving_out,
    name_of,
    number,
    numbers,
    warn_of_repeated,
    warning,
)

PLAIN_AXIS = (1e-3, 1e3)
"""Smallest and largest entry of an axis that parsers are given as it is; the squares of others may overflow."""
LARGEST_FACTOR = 1e6  # largest multiplier of a mimic joint, and its largest offset [rad or m]
LEAST_SPEED = 1e-9
"""Least velocity limit but zero, which says none [rad/s or m/s]; no motion with a smaller one would end."""
DEFAULT_AXIS = (1.0, 0.0, 0.0)  # axis of a joint without `<axis>`

_UNUSED_NUMBERS = {
    "dynamics": ("damping", "friction"),
    "safety_controller": ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"),
    "calibration": ("rising", "falling"),
}
"""Numbers of elements that planning doesn't use; not being numbers, they would make the parser refuse the joint."""

_WITHOUT_AXIS = ("fixed", "floating")
_RANGED = ("revolute", "prismatic")


def check_joint(joint: Element, links: Collection[str], version: tuple[int, int], warnings: list[str]) -> JointFacts:
    """Check one joint by itself; RobotInvalid at the first fault, with its line.

    Axes that parsers would misread, limits in reverse order and leftovers are rewritten. The axis of a fixed or
    floating joint means nothing and isn't read. Nor is the range of a continuous, planar or floating one.
    """
    name, kind = name_of(joint), joint.get("type")
    if kind not in JOINT_DOF:
        hint = "; a URDF has no ball joints" if kind in ("spherical", "ball", "universal") else ""
        what = "<joint> must have 'type'" if kind is None else f"unknown type {kind!r}"
        raise fault(
            joint,
            f"{what}; a joint is one of {', '.join(JOINT_DOF)}{hint}",
            type=kind,
            available=[*JOINT_DOF],
        )
    parent, child = _find_end(joint, "parent", links), _find_end(joint, "child", links)
    check_origins(joint, version)
    axes = joint.findall("axis")
    directions = [] if kind in _WITHOUT_AXIS else [_check_axis(axis) for axis in axes]
    if kind == "planar" and not axes:
        warnings.append(
            warning(joint, "a planar joint without <axis> moves in the plane normal to x, the axis that a URDF implies")
        )
    _check_unused_numbers(joint, warnings)
    limits = joint.findall("limit")
    if not limits and kind in _RANGED:
        raise fault(joint, f"a {kind} joint must have <limit> with 'effort' and 'velocity'")
    for tag in ("limit", "axis", "origin", "mimic"):
        warn_of_repeated(joint, tag, warnings)
    figures = [_check_limit(limit, kind, warnings) for limit in limits]
    lower, upper, velocity, effort = figures[0] if figures else (None, None, None, None)
    if kind not in _RANGED:
        if limits and kind != "fixed" and not _is_any_angle(kind, figures[0]):
            warnings.append(warning(limits[0], f"a {kind} joint has no range: 'lower' and 'upper' are left out"))
        lower = upper = None
    axis = (directions[0] if directions else DEFAULT_AXIS) if kind == "planar" else None
    return JointFacts(name, kind, parent, child, joint.sourceline, lower, upper, velocity, effort, axis)


def check_mimics(
    elements: Mapping[str, Element], joints: Mapping[str, JointFacts], warnings: list[str]
) -> dict[str, tuple[str, float, float]]:
    """Check who follows whom: follower to (name of the joint followed, multiplier, offset), of those that move.

    A name that is wrong only in that it lacks the prefix of the follower (`left_finger2` follows `finger1`, and there
    is a `left_finger1`) is taken for the one with the prefix, with a warning: files made by macros have this fault.

    Raises:
        RobotInvalid: if a joint mimics itself, nothing, or a joint without one value; or if mimics form a cycle.
    """
    mimics = {}
    for follower, element in elements.items():
        for mimic in element.findall("mimic")[:1]:
            driver = _driver(mimic, joints[follower], joints, warnings)
            multiplier, offset = (
                number(mimic, attribute, default, LARGEST_FACTOR)
                for attribute, default in (("multiplier", 1.0), ("offset", 0.0))
            )
            if driver is not None:
                mimics[follower] = (driver, multiplier, offset)
    for follower in mimics:
        chain = [follower]
        while chain[-1] in mimics:
            chain.append(mimics[chain[-1]][0])
            if chain[-1] == follower:
                raise fault(
                    elements[follower].find("mimic"), f"mimics form a cycle: {' mimics '.join(chain)}", cycle=chain
                )
            if chain[-1] in chain[:-1]:
                break  # a cycle that doesn't come back here is found from one of its members
    return mimics


def _driver(mimic: Element, follower: JointFacts, joints: Mapping[str, JointFacts], warnings: list[str]) -> str | None:
    """The joint that is followed; None where the follower doesn't move anyway."""
    driver = mimic.get("joint", "")
    if follower.kind == "fixed":
        warnings.append(warning(mimic, f"a fixed joint can't mimic {driver!r}; it stays fixed"))
        return None
    if follower.kind not in SCALAR_JOINTS:
        raise fault(mimic, f"a {follower.kind} joint can't mimic another")
    if driver == follower.name:
        raise fault(mimic, "a joint can't mimic itself")
    if driver not in joints:
        unknown = f"mimics {driver!r}, but there is no such joint"
        meant = _find_prefixed(driver, follower.name, joints)
        if len(meant) != 1:
            raise fault(mimic, f"{unknown}; there are {', '.join(joints)}", mimics=driver)
        driver = meant[0]
        warnings.append(warning(mimic, f"{unknown}; taken for {driver!r}"))
    if (kind := joints[driver].kind) not in SCALAR_JOINTS:
        valid = ", ".join(SCALAR_JOINTS)
        raise fault(
            mimic, f"mimics {driver!r}, which is {kind}; only {valid} joints have one value to follow", mimics=driver
        )
    return str(driver)


def _find_prefixed(driver: str, follower: str, joints: Iterable[str]) -> list[str]:
    prefixes = {name: name[: -len(driver)] for name in joints if driver and name.endswith(driver) and name != follower}
    return [name for name, prefix in prefixes.items() if follower.startswith(prefix)]


def name_of_end(joint: Element, tag: str) -> str:
    """Return the name of the link that a joint has as its parent or child."""
    ends = joint.findall(tag)
    if len(ends) != 1 or not ends[0].get("link"):
        raise fault(joint, f'a joint must have one <{tag} link="…"/>')
    link: str = ends[0].get("link")
    return link


def _find_end(joint: Element, tag: str, links: Collection[str]) -> str:
    link, ends = name_of_end(joint, tag), joint.findall(tag)
    if link not in links:
        raise fault(ends[0], f"{tag} link {link!r} does not exist; there are {', '.join(links)}", link=link)
    return link


def _check_axis(axis: Element) -> tuple[float, float, float]:
    """The direction of an axis; written with plain numbers, as only its direction counts."""
    direction = numbers(axis, "xyz", 3)
    if direction is None:  # Pinocchio would take it for zero; a joint without <axis> has its default, x
        raise fault(axis, "<axis> must have 'xyz'", attribute="xyz")
    largest = max(map(abs, direction))
    if largest == 0.0:
        raise fault(axis, f"<axis> must not be zero, got {axis.get('xyz')!r}", attribute="xyz")
    if not PLAIN_AXIS[0] <= largest <= PLAIN_AXIS[1]:
        direction = [entry / largest for entry in direction]
        axis.set("xyz", " ".join(map(repr, direction)))
    x, y, z = direction
    return x, y, z


def _is_any_angle(kind: str, figures: tuple[float, float, float, float]) -> bool:
    """Whether a range that means nothing takes nothing away: none is given, or a continuous joint's is a turn."""
    lower, upper, _, _ = figures
    return lower == upper == 0.0 or (kind == "continuous" and upper - lower >= 2.0 * math.pi - 1e-2)


def _check_limit(limit: Element, kind: str, warnings: list[str]) -> tuple[float, float, float, float]:
    lower, upper = number(limit, "lower", 0.0), number(limit, "upper", 0.0)
    velocity, effort = number(limit, "velocity", math.nan), number(limit, "effort", math.nan)
    if kind in _RANGED and lower > upper:
        taken = f"the range is taken for {upper:g} to {lower:g}"
        warnings.append(warning(limit, f"'lower' exceeds 'upper', {lower:g} > {upper:g}: {taken}"))
        lower, upper = upper, lower
        limit.set("lower", repr(lower))
        limit.set("upper", repr(upper))
    for attribute, value in (("velocity", velocity), ("effort", effort)):
        if not value >= 0.0:
            how = "missing" if math.isnan(value) else f"negative, {value:g}"
            what = "the joint has no such limit" if attribute == "effort" else "the default limit holds"
            if kind != "fixed":
                warnings.append(warning(limit, f"{attribute!r} of <limit> is {how}: {what}"))
            limit.set(attribute, "0")
    velocity, effort = velocity if velocity >= 0.0 else 0.0, effort if effort >= 0.0 else 0.0
    if kind != "fixed" and 0.0 < velocity < LEAST_SPEED:
        raise fault(limit, f"'velocity' of <limit> must be 0 or at least {LEAST_SPEED:g}", attribute="velocity")
    if kind in _RANGED and lower == upper:
        warnings.append(warning(limit, f"the joint can't move: 'lower' and 'upper' are both {lower:g}"))
    return lower, upper, velocity, effort


def _check_unused_numbers(joint: Element, warnings: list[str]) -> None:
    for tag, attributes in _UNUSED_NUMBERS.items():
        for element in joint.findall(tag):
            with leaving_out(element, f"<{tag}> is left out: nothing uses it", warnings):
                for attribute in attributes:
                    number(element, attribute, None if attribute == "k_velocity" else 0.0)
                if tag == "dynamics" and not {"damping", "friction"} & {*element.attrib}:
                    raise fault(element, "<dynamics> must have 'damping' or 'friction'")
