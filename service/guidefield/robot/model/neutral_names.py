"""Neutral names for links and joints while Pinocchio parses a URDF, because Pinocchio resolves frames by name.

Pinocchio gives names of its own (`universe`, `root_joint`) and resolves frames by name while it builds a model. A fixed
joint called `universe` then loses its placement, and a joint called `root_joint` is merged with a moving root. With
names that nobody else uses every model is built alike; the names of the URDF are written back afterwards, by index.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from lxml import etree


@dataclass(frozen=True)
class NeutralNames:
    """A URDF with neutral names.

    Attributes:
        text: The URDF for Pinocchio.
        links, joints: The URDF's own name by neutral name.
    """

    text: str
    links: Mapping[str, str]
    joints: Mapping[str, str]

    def restore(self, model: Any, geometry: Any | None = None) -> None:
        """Write the URDF's own names into a Pinocchio model, and into its geometry model, in place."""
        both = {**self.links, **self.joints}
        for index in range(1, model.njoints):
            model.names[index] = both.get(model.names[index], model.names[index])
        for frame in model.frames:
            frame.name = both.get(frame.name, frame.name)
        for shape in geometry.geometryObjects if geometry is not None else ():
            link, _, number = shape.name.rpartition("_")
            shape.name = f"{self.links[link]}_{number}"

    def restore_text(self, message: str) -> str:
        """A message with the URDF's own names."""
        for neutral, name in (*self.links.items(), *self.joints.items()):
            message = message.replace(neutral, name)
        return message


def neutral_names(urdf: str) -> NeutralNames:
    """Give every link and joint of a checked URDF a neutral name.

    Pinocchio orders the joints below a link by their names; the neutral ones keep that order.
    """
    root = etree.fromstring(urdf.encode())
    links = _ranked("L", [link.get("name") for link in root.findall("link")])
    joints = _ranked("J", [joint.get("name") for joint in root.findall("joint")])
    for link in root.findall("link"):
        link.set("name", links[link.get("name")])
    for joint in root.findall("joint"):
        joint.set("name", joints[joint.get("name")])
        for end in (joint.find("parent"), joint.find("child")):
            end.set("link", links[end.get("link")])
        for mimic in joint.findall("mimic"):
            mimic.set("joint", joints.get(mimic.get("joint"), ""))
    text = etree.tostring(root, encoding="unicode")
    return NeutralNames(text, {new: old for old, new in links.items()}, {new: old for old, new in joints.items()})


def _ranked(kind: str, names: Iterable[str]) -> dict[str, str]:
    """Neutral name by name, in the order of the names' bytes."""
    ordered = sorted(names, key=lambda name: name.encode())
    return {name: f"#{kind}{rank:05d}#" for rank, name in enumerate(ordered)}
