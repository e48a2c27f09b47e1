"""A robot placed by the formulas of its URDF, with Pinocchio on the text alone.

Mimic joints follow their own words. A planar joint is two slides and a turn: Pinocchio's own ignores the axis.
"""

from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin


class ByFormula:
    """A URDF as Pinocchio reads it.

    Attributes:
        text: The URDF, its planar joints as joints of one freedom each.
        model: Its model, in which mimic joints are joints like others.
        data: Scratch space.
    """

    def __init__(self, text: str) -> None:
        self.text, self._planar = without_planar(text)
        self.model, _ = built(self.text)
        self.data = self.model.createData()
        self._followed = {
            joint.get("name"): (m.get("joint"), float(m.get("multiplier", 1.0)), float(m.get("offset", 0.0)))
            for joint in ElementTree.fromstring(text).findall("joint")
            for m in joint.findall("mimic")
        }

    def value(self, name: str, given: Mapping[str, Any]) -> Any:
        """Value of a joint: as given, else multiplier * that of the joint it follows + offset."""
        if name in self._planar:
            planar, index = self._planar[name]
            return given[planar][index]
        if name not in self._followed:
            return given[name]
        source, multiplier, offset = self._followed[name]
        return multiplier * self.value(source, given) + offset

    def configuration(self, given: Mapping[str, Any]) -> np.ndarray:
        """Configuration of `model`, shape (nq,), at values of the joints that follow none, as the wire has them."""
        parts = []
        for name, joint in list(zip(self.model.names, self.model.joints, strict=True))[1:]:
            value = self.value(name, given)
            if joint.nv == 1:
                parts.append([value] if joint.nq == 1 else [np.cos(value), np.sin(value)])
            else:
                parts.append(value)
        return np.concatenate(parts).astype(float)

    def placements(self, given: Mapping[str, Any]) -> dict[str, np.ndarray]:
        """Placement (4, 4) of each joint's frame in the world."""
        pin.forwardKinematics(self.model, self.data, self.configuration(given))
        return {name: T.homogeneous for name, T in list(zip(self.model.names, self.data.oMi, strict=True))[1:]}


def built(text: str, *root: Any) -> tuple[Any, Any]:
    """Pinocchio's model and collision geometry of a URDF; its parts are numbered meanwhile.

    Pinocchio takes some names for its own, such as `universe`. Numbers keep the order of the names, as it sorts them.
    """
    numbered, names = ElementTree.fromstring(text), {}
    for kind in ("link", "joint"):
        parts = sorted(numbered.findall(kind), key=lambda part: part.get("name", "").encode())
        names |= {f"{kind} {number:04}": part.get("name", "") for number, part in enumerate(parts)}
        numbers = {part.get("name"): f"{kind} {number:04}" for number, part in enumerate(parts)}
        for part in parts:
            part.set("name", numbers[part.get("name")])
        for end in [*numbered.iterfind("joint/parent"), *numbered.iterfind("joint/child")] if kind == "link" else []:
            end.set("link", numbers[end.get("link")])
    for joint in numbered.findall("joint"):
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
    plain, geometry = ElementTree.tostring(numbered, "unicode"), pin.GeometryModel()
    model = pin.buildModelFromXML(plain, *root)
    pin.buildGeomFromUrdfString(model, plain, pin.GeometryType.COLLISION, geometry, [])
    for index in range(1, model.njoints):
        model.names[index] = names.get(model.names[index], model.names[index])
    for frame in model.frames:
        frame.name = names.get(frame.name, frame.name)
    for shape in geometry.geometryObjects:
        link, _, number = shape.name.rpartition("_")
        shape.name = f"{names[link]}_{number}"
    return model, geometry


def without_planar(text: str) -> tuple[str, dict[str, tuple[str, int]]]:
    """A URDF whose planar joints are chains of two slides and a turn.

    The slides go along the joint frame's x axis, as far as it lies in the plane, and square to that; where the axis is
    nearly along x they start from y.

    Returns:
        The text; and of each joint of a chain the planar joint's name and which of its values it has.
    """
    root, parts = ElementTree.fromstring(text), {}
    if not any(one.get("type") == "planar" for one in root.findall("joint")):
        return text, {}
    for joint in [one for one in root.findall("joint") if one.get("type") == "planar"]:
        name, axis = joint.get("name", ""), joint.find("axis")
        normal = np.array((axis.get("xyz") if axis is not None else "1 0 0").split(), float)
        normal /= np.linalg.norm(normal)
        start = [1.0, 0, 0] if abs(normal[0]) <= 0.9 else [0, 1.0, 0]
        second = np.cross(normal, start)
        second /= np.linalg.norm(second)
        above, below = joint.find("parent").get("link"), joint.find("child").get("link")
        links = [above, f"{name}:1", f"{name}:2", below]
        root.remove(joint)
        for index, direction in enumerate((np.cross(second, normal), second, normal)):
            kind, of = ("continuous", name) if index == 2 else ("prismatic", f"{name}:{index}")
            made = ElementTree.SubElement(root, "joint", name=of, type=kind)
            if index == 0 and (origin := joint.find("origin")) is not None:
                made.append(origin)
            ElementTree.SubElement(made, "parent", link=links[index])
            ElementTree.SubElement(made, "child", link=links[index + 1])
            ElementTree.SubElement(made, "axis", xyz=" ".join(map(repr, direction.tolist())))
            ElementTree.SubElement(made, "limit", lower="-9", upper="9", effort="1", velocity="1")
            parts[of] = name, index
            if index < 2:
                ElementTree.SubElement(root, "link", name=links[index + 1])
    return ElementTree.tostring(root, "unicode"), parts


def given_by(names: list[str], row: list[float]) -> dict[str, Any]:
    """Position columns of a reply and a row of them as a configuration of the wire."""
    gathered: dict[str, list[float]] = {}
    for name, value in zip(names, row, strict=True):
        gathered.setdefault(name.partition(".")[0], []).append(value)
    return {name: values[0] if len(values) == 1 else values for name, values in gathered.items()}
