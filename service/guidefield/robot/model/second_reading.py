"""A second reading of a URDF, independent of Pinocchio: placements of links by NumPy from the text alone.

Nothing is imported for it and no file is opened: yourdfpy, which was the second reader, takes half a second to import.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from guidefield.robot.model.configuration import scalar
from guidefield.robot.model.followers import follow
from guidefield.robot.model.model import JointKind, RobotModel
from guidefield.robot.model.spaces import RobotConfiguration

SAME = 1e-6
"""Placements of links that differ by more than this [m, or 1] are not the same."""
MOST_TOLD = 5
"""Of so many differences a sentence is made each; of the rest, how many they are."""
BENT = 0.3
"""Where in its range each joint stands while placements are compared; the value of those without limits [rad or m]."""
_SCALAR = (JointKind.REVOLUTE, JointKind.CONTINUOUS, JointKind.PRISMATIC)
_TURNING, _SLIDING = ("revolute", "continuous"), ("prismatic",)
"""The types of joints in a URDF that have one value."""


def crosschecked(robot: RobotModel) -> RobotModel:
    """Return the robot, with a warning for each difference between Pinocchio and a second reading of its URDF.

    Compared are capsules, which other tools don't know, the joints that can be given, and the placement of each link
    with every joint bent, mimic joints where either reading puts them. Robots with joints of several degrees of freedom
    are not compared.
    """
    told = _differences(robot)
    if len(told) > MOST_TOLD:
        told = [*told[:MOST_TOLD], f"a second reading of the URDF differs in {len(told) - MOST_TOLD} more things"]
    return dataclasses.replace(robot, warnings=(*robot.warnings, *told)) if told else robot


def _differences(robot: RobotModel) -> list[str]:
    root = etree.fromstring(robot.source.urdf_text.encode())
    return [*_capsules(robot, root), *_placed_otherwise(robot, root)]


def _capsules(robot: RobotModel, root: Any) -> list[str]:
    """Sentences about capsules, which Pinocchio alone reads.

    They are shapes of URDF 1.1, or cylinders that `<collision_checking>` makes capsules.
    """
    shapes = {link.get("name"): [shape.tag for shape in link.iterfind("collision/geometry/*")] for link in root}
    rounded = dict.fromkeys(
        choice.link
        for choice in robot.geometry_choices
        if choice.shape == "capsule" and "cylinder" in shapes.get(choice.link, ())
    )
    unknown = [link for link, tags in shapes.items() if "capsule" in tags]
    told = (
        (rounded, "by <collision_checking> a cylinder is a capsule; yourdfpy and other tools read flat ends"),
        (unknown, "yourdfpy and other tools don't know <capsule>, and see nothing there"),
    )
    return [f"link {', '.join(map(repr, links))}: {what}" for links, what in told if links]


def _placed_otherwise(robot: RobotModel, root: Any) -> list[str]:
    """A sentence for each joint or link that the second reading has otherwise."""
    joints = list(robot.joints if robot.source.root_joint == "fixed" else robot.joints[1:])
    if any(joint.kind not in _SCALAR for joint in joints):
        return []
    q = _bent(robot)
    given = {joint.name: scalar(joint, q) for joint in joints if joint.mimic is None}
    elements = _joints(root)
    if alone := given.keys() ^ {name for name in elements if _moves_freely(elements, name)}:
        return [f"a second reading of the URDF has other joints to move: {', '.join(sorted(alone))} are not in both"]
    return _misplaced(robot, q, read_placements(root, given))


def _misplaced(robot: RobotModel, q: RobotConfiguration, placements: dict[str, np.ndarray]) -> list[str]:
    """A sentence for each link that is placed differently relative to the root, at a configuration, shape (nq,)."""
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, q)
    root = data.oMf[robot.frame_id(next(iter(placements)))]
    told = []
    for link, other in placements.items():
        ours = root.actInv(data.oMf[robot.frame_id(link)]).homogeneous
        apart = float(np.abs(ours - other).max())
        if not apart <= SAME * max(1.0, float(np.abs(ours).max())):
            told.append(f"a second reading of the URDF places link {link!r} otherwise, by {apart:.3g}")
    return told


def _mimic(elements: dict[str, Any], name: str) -> Any:
    """The `<mimic>` of a joint that follows a joint of the URDF; else None."""
    mimic = elements[name].find("mimic")
    return mimic if mimic is not None and mimic.get("joint") in elements else None


def _moves_freely(elements: dict[str, Any], name: str) -> bool:
    return elements[name].get("type") in (*_TURNING, *_SLIDING) and _mimic(elements, name) is None


def _value(elements: dict[str, Any], name: str, given: dict[str, float]) -> float:
    """The value of a joint where those that follow no other have the values given [rad or m]."""
    mimic = _mimic(elements, name)
    if mimic is None:
        return given.get(name, 0.0)
    followed = _value(elements, mimic.get("joint"), given)
    return float(mimic.get("multiplier", 1.0)) * followed + float(mimic.get("offset", 0.0))


def read_placements(root: Any, given: dict[str, float]) -> dict[str, np.ndarray]:
    """Read the placement of each link relative to the root link from the elements of a URDF.

    Args:
        root: The `<robot>`, as lxml parses it; a valid one.
        given: Values of joints that follow no other [rad or m]; others are at zero.

    Returns:
        Transforms, shape (4, 4), by link; the root link is the first.
    """
    elements = _joints(root)
    above = {element.find("child").get("link"): name for name, element in elements.items()}
    names = [link.get("name") for link in root.findall("link")]
    found = {name: np.eye(4) for name in names if name not in above}
    for name in names:
        chain = [name]
        while chain[-1] not in found:
            chain.append(elements[above[chain[-1]]].find("parent").get("link"))
        for parent, child in itertools.pairwise(reversed(chain)):
            joint = above[child]
            moved = _moved(elements[joint], _value(elements, joint, given))
            found[child] = found[parent] @ _origin(elements[joint].find("origin")) @ moved
    return found


def _joints(root: Any) -> dict[str, Any]:
    """The `<joint>` elements by name."""
    return {element.get("name"): element for element in root.findall("joint")}


def _vector(element: Any, name: str, default: str) -> np.ndarray:
    return np.array((default if element is None else element.get(name) or default).split(), float)


def _origin(element: Any) -> np.ndarray:
    """The transform of an `<origin>`: about x, then y, then z of the parent, or by a quaternion (URDF 1.1)."""
    transform = np.eye(4)
    transform[:3, 3] = _vector(element, "xyz", "0 0 0")
    if element is not None and element.get("quat_xyzw"):
        x, y, z, w = _vector(element, "quat_xyzw", "0 0 0 1")
        transform[:3, :3] = _turned(np.array([x, y, z]), 2.0 * np.arctan2(np.linalg.norm([x, y, z]), w))
        return transform
    for axis, angle in zip(np.eye(3), _vector(element, "rpy", "0 0 0"), strict=True):
        transform[:3, :3] = _turned(axis, angle) @ transform[:3, :3]
    return transform


def _moved(element: Any, value: float) -> np.ndarray:
    """The transform by a joint of the type and axis of an element, at a value [rad or m]."""
    transform = np.eye(4)
    axis = _vector(element.find("axis"), "xyz", "1 0 0")
    if element.get("type") in _TURNING:
        transform[:3, :3] = _turned(axis, value)
    elif element.get("type") in _SLIDING:
        transform[:3, 3] = value * axis / np.linalg.norm(axis)
    return transform


def _turned(axis: np.ndarray, angle: float) -> np.ndarray:
    """The rotation about an axis of any length by an angle [rad], by Rodrigues' formula, shape (3, 3)."""
    length = float(np.linalg.norm(axis))
    x, y, z = axis / length if length > 0.0 else axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: np.ndarray = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return turned


def _bent(robot: RobotModel) -> RobotConfiguration:
    """A configuration with every joint away from zero and from its limits, shape (nq,); followers where they belong."""
    q = robot.rest.copy()
    for joint in robot.joints:
        if joint.kind in _SCALAR:
            limited = bool(np.isfinite([joint.lower[0], joint.upper[0]]).all())
            value = joint.lower[0] + BENT * (joint.upper[0] - joint.lower[0]) if limited else BENT
            q[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
    follow(robot.joints, q)
    return q
