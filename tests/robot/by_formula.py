"""Where a URDF's formula puts a robot: Pinocchio on the text as written, followers by their own words, nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin


class ByFormula:
    """A URDF as Pinocchio reads it.

    Attributes:
        model: Its model, in which followers are joints like others.
        data: Scratch space.
    """

    def __init__(self, text: str) -> None:
        self.model = pin.buildModelFromXML(text)
        self.data = self.model.createData()
        self._followed = {
            joint.get("name"): (m.get("joint"), float(m.get("multiplier", 1.0)), float(m.get("offset", 0.0)))
            for joint in ElementTree.fromstring(text).findall("joint")
            for m in joint.findall("mimic")
        }

    def value(self, name: str, given: Mapping[str, Any]) -> Any:
        """Value of a joint: as given, else multiplier * that of the joint it follows + offset."""
        if name not in self._followed:
            return given[name]
        driver, multiplier, offset = self._followed[name]
        return multiplier * self.value(driver, given) + offset

    def configuration(self, given: Mapping[str, Any]) -> np.ndarray:
        """Configuration of `model`, shape (nq,), at values of the joints that follow none, as the wire has them."""
        parts = []
        for name, joint in list(zip(self.model.names, self.model.joints, strict=True))[1:]:
            value = self.value(name, given)
            if joint.shortname() == "JointModelPlanar":
                parts.append([*value[:2], np.cos(value[2]), np.sin(value[2])])
            elif joint.nv == 1:
                parts.append([value] if joint.nq == 1 else [np.cos(value), np.sin(value)])
            else:
                parts.append(value)
        return np.concatenate(parts).astype(float)

    def placements(self, given: Mapping[str, Any]) -> dict[str, np.ndarray]:
        """Placement (4, 4) of each joint's frame in the world."""
        pin.forwardKinematics(self.model, self.data, self.configuration(given))
        return {name: T.homogeneous for name, T in list(zip(self.model.names, self.data.oMi, strict=True))[1:]}


def given_by(names: list[str], row: list[float]) -> dict[str, Any]:
    """Position columns of a reply and a row of them as a configuration of the wire."""
    gathered: dict[str, list[float]] = {}
    for name, value in zip(names, row, strict=True):
        gathered.setdefault(name.partition(".")[0], []).append(value)
    return {name: values[0] if len(values) == 1 else values for name, values in gathered.items()}
