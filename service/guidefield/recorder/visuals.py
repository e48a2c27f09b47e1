"""The `<visual>` elements of a URDF, read tolerantly: what can't be drawn is left out and named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from lxml import etree

from guidefield.recorder import surface
from guidefield.recorder.surface import GREY, Surface
from guidefield.robot.model.model import RobotSource


@dataclass(frozen=True, eq=False)
class Body:
    """Something rigid to draw.

    Attributes:
        name: `<link>_<number>`.
        link: The link that carries it.
        surface: Its surface in the link's frame, or a GLB file's content.
        placement: ``T_link_body`` of a GLB; a surface has it applied already.
        color: RGBA, where the surface has no colours of its own.
    """

    name: str
    link: str
    surface: Surface | bytes
    placement: Any
    color: tuple[int, int, int, int] = GREY


def visual_bodies(source: RobotSource) -> tuple[tuple[Body, ...], tuple[str, ...]]:
    """What a robot looks like.

    Args:
        source: The robot's text as it was checked: meshes are absolute paths, within folders that are allowed.

    Returns:
        Bodies in the URDF's order, and one sentence for each element that can't be drawn.
    """
    parser = etree.XMLParser(resolve_entities=False, no_network=True, remove_comments=True)
    root = etree.fromstring(source.urdf_text.encode(), parser)
    materials = {material.get("name"): material for material in root.findall("material")}
    bodies, faults = [], []
    for link in root.findall("link"):
        for number, element in enumerate(link.findall("visual")):
            name = f"{link.get('name')}_{number}"
            try:
                bodies.append(_body(name, link.get("name"), element, materials))
            except (ValueError, KeyError, TypeError, IndexError, AttributeError, OSError) as error:
                # Readers of foreign mesh files raise all of these; a picture may lack a part, a plan doesn't.
                faults.append(f"visual {name} is not drawn: {error}")
    return tuple(bodies), tuple(faults)


def _body(name: str, link: str, element: Any, materials: dict[str, Any]) -> Body:
    placement = _placement(element.find("origin"))
    color = _color(element.find("material"), materials)
    shape = element.find("geometry")[0]
    if shape.tag == "mesh":
        scale = _numbers(shape.get("scale", "1 1 1"))
        drawn = surface.read_mesh(Path(shape.get("filename")), scale, color)
    elif shape.tag in PRIMITIVES:
        drawn = surface.of_shape(PRIMITIVES[shape.tag](shape))
    else:
        raise ValueError(f"<{shape.tag}> is no geometry")
    if isinstance(drawn, Surface):
        drawn, placement = drawn.moved(placement), pin.SE3.Identity()
    return Body(name, link, drawn, placement, color or GREY)


def _placement(origin: Any) -> Any:
    """``T_link_body`` of an <origin>, pinocchio.SE3."""
    if origin is None:
        return pin.SE3.Identity()
    if (quaternion := origin.get("quat_xyzw")) is not None:
        rotation = pin.Quaternion(_numbers(quaternion)).normalized().matrix()
    else:
        rotation = pin.rpy.rpyToMatrix(_numbers(origin.get("rpy", "0 0 0")))
    return pin.SE3(rotation, _numbers(origin.get("xyz", "0 0 0")))


def _color(material: Any, materials: dict[str, Any]) -> tuple[int, int, int, int] | None:
    """RGBA of a <material>, its own or the one it names; None where neither says."""
    for one in (material, None if material is None else materials.get(material.get("name"))):
        color = None if one is None else one.find("color")
        if color is not None:
            rgba = np.round(255.0 * np.clip(_numbers(color.get("rgba")), 0.0, 1.0)).astype(int)
            return int(rgba[0]), int(rgba[1]), int(rgba[2]), int(rgba[3])
    return None


def _numbers(text: str) -> np.ndarray:
    return np.array([float(number) for number in text.split()])


PRIMITIVES: dict[str, Callable[[Any], Any]] = {
    "box": lambda box: coal.Box(*_numbers(box.get("size"))),
    "sphere": lambda sphere: coal.Sphere(float(sphere.get("radius"))),
    "cylinder": lambda c: coal.Cylinder(float(c.get("radius")), float(c.get("length"))),
    "capsule": lambda c: coal.Capsule(float(c.get("radius")), float(c.get("length"))),
}
"""Coal shape by URDF element."""
