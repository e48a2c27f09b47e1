"""Misspelt elements and attributes of a URDF, which parsers leave out silently."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

from guidefield.robot.urdf.xml import Element, warning

ELEMENTS = {
    "robot": ("link", "joint"),
    "link": ("inertial", "visual", "collision"),
    "joint": ("origin", "parent", "child", "axis", "limit", "mimic"),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry"),
    "collision": ("origin", "geometry"),
}
"""Children of each element that decide where something is, or whether it is there."""

ATTRIBUTES = {
    "origin": ("xyz", "rpy", "quat_xyzw"),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "velocity", "effort"),
    "mimic": ("joint", "multiplier", "offset"),
    "mesh": ("filename", "scale"),
}
"""Attributes that do the same."""

SIMILAR = 0.8
"""Least similarity of a misspelt name to the one that is meant, as `difflib` has it."""


def warn_of_misspelt(root: Element, warnings: list[str]) -> None:
    """Tell of misspelt elements and attributes, such as `<Collision>`; they are left out."""
    for element in root.iter(*ELEMENTS, *ATTRIBUTES):
        if element.getparent() is not None and element.getparent().tag not in (*ELEMENTS, "geometry"):
            continue  # inside something that isn't URDF, such as <gazebo>
        for child in element:
            if isinstance(child.tag, str) and (meant := _meant(child.tag, ELEMENTS.get(element.tag, ()))):
                warnings.append(warning(child, f"<{child.tag}> is unknown and left out: is <{meant}> meant?"))
        for name in element.attrib:
            if meant := _meant(name, ATTRIBUTES.get(element.tag, ())):
                text = f"attribute {name!r} of <{element.tag}> is unknown and left out: is {meant!r} meant?"
                warnings.append(warning(element, text))


def _meant(name: str, known: Iterable[str]) -> str | None:
    """The known name that another one, which isn't known, is nearly."""
    if name in known:
        return None
    close = difflib.get_close_matches(name.lower(), list(known), 1, SIMILAR)
    return close[0] if close else None
