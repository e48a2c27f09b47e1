"""A robot as Pinocchio reads its URDF, at many configurations; nothing of our code.

Mimic joints follow their own words. A planar joint is two slides and a turn, as Pinocchio's own ignores its axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from tests.robot.by_formula import built, without_planar

from doubting import mesh_files
from doubting.curve import Values

ROOTS = {"fixed": None, "planar": pin.JointModelPlanar, "free": pin.JointModelFreeFlyer}


@dataclass(frozen=True, eq=False)
class Formula:
    """A URDF as Pinocchio reads it, its meshes as Assimp does.

    Attributes:
        model: Its model, in which mimic joints are joints like others, and balls are floating joints that stay.
        geometry: Its collision geometry.
        followed: By mimic joint: its source joint, multiplier and offset.
        planar: By part of a planar joint: the planar joint, and which of its values the part has.
    """

    model: Any
    geometry: Any
    followed: dict[str, tuple[str, float, float]]
    planar: dict[str, tuple[str, int]]

    @classmethod
    def of(cls, text: str, root_joint: str) -> Formula:
        root = ROOTS[root_joint]
        text, planar = without_planar(text)
        text, meshes = mesh_files.put_in(text)
        model, geometry = built(text, *([root()] if root else []))
        for shape in geometry.geometryObjects:
            shape.geometry = meshes.get(shape.name, shape.geometry)
        followed = {
            joint.get("name", ""): (m.get("joint", ""), float(m.get("multiplier", 1)), float(m.get("offset", 0)))
            for joint in ElementTree.fromstring(text).findall("joint")  # noqa: S314 - drawn here, or of the catalog
            if joint.get("type") != "fixed"
            for m in joint.findall("mimic")[:1]
        }
        return cls(model, geometry, followed, planar)

    def value(self, name: str, given: Values) -> np.ndarray:
        """Values of a joint: as given, else multiplier * those of the joint that it follows + offset."""
        if name in self.planar:
            joint, index = self.planar[name]
            return given[joint][:, index]
        if name not in self.followed:
            return given[name]
        source, multiplier, offset = self.followed[name]
        return multiplier * self.value(source, given) + offset

    def configurations(self, given: Values) -> np.ndarray:
        """Configurations of `model`, shape (n, nq), at values of the joints that follow none."""
        count, parts = max(len(value) for value in given.values()), []
        for name, joint in list(zip(self.model.names, self.model.joints, strict=True))[1:]:
            value = np.broadcast_to(self.value(name, given), (count, *np.shape(self.value(name, given))[1:]))
            if joint.nv == 1:
                parts.append(value[:, None] if joint.nq == 1 else np.column_stack([np.cos(value), np.sin(value)]))
            elif joint.nv == 3:
                parts.append(np.column_stack([value[:, :2], np.cos(value[:, 2]), np.sin(value[:, 2])]))
            else:
                still = np.zeros((count, 7 - value.shape[1]))
                parts.append(np.hstack([still, value]))
        return np.ascontiguousarray(np.hstack(parts))

    def moved_by(self, planned: set[str]) -> list[frozenset[int]]:
        """Return which of the planned joints, or their mimic joints, are before each shape: indices of `model`."""
        moving = {j for j in range(1, self.model.njoints) if self._leader(self.model.names[j]) in planned}
        return [
            frozenset(j for j in self.model.supports[shape.parentJoint] if j in moving)
            for shape in self.geometry.geometryObjects
        ]

    def _leader(self, name: str) -> str:
        while name in self.followed:
            name = self.followed[name][0]
        return self.planar.get(name, (name, 0))[0]
