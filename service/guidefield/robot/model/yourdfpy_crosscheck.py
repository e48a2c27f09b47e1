"""Compare Pinocchio's reading of a URDF that isn't in the catalog with yourdfpy's, and warn of differences.

Nothing but warnings comes of it: the constants choose how many there are.
"""

from __future__ import annotations

import dataclasses
import io
import logging
from collections import defaultdict
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from guidefield.robot.model.configuration import scalar
from guidefield.robot.model.joints import Joint, JointKind, RobotConfiguration
from guidefield.robot.model.mimic_joints import follow
from guidefield.robot.model.model import RobotModel

PLACEMENT_TOLERANCE = 1e-6  # placements of links that differ by more than this [m, or 1] are not the same
MOST_TOLD = 5  # differences that get a sentence each; the others are counted
BENT_SHARE = 0.3
"""Where in its range each joint stands while placements are compared; the value of those without limits [rad or m]."""
_UNREAD = ("visual", "collision", "transmission", "gazebo")
"""Elements that the other reader isn't given: it fails at shapes that it doesn't know, and would compare nothing."""
_SCALAR = (JointKind.REVOLUTE, JointKind.CONTINUOUS, JointKind.PRISMATIC)


def crosscheck(robot: RobotModel) -> RobotModel:
    """Add a warning for whatever yourdfpy reads otherwise than Pinocchio; faults are found by the intake.

    Compared are capsules, which yourdfpy doesn't know, the joints that can be given, and the placement of each link
    with every joint bent. Placements of robots with what yourdfpy doesn't know are not compared: joints of several
    degrees of freedom, mimic joints of mimic joints, and rotations as quaternions (URDF 1.1). No file is opened.
    """
    told = _differences(robot)
    if len(told) > MOST_TOLD:
        told = [*told[:MOST_TOLD], f"yourdfpy reads {len(told) - MOST_TOLD} more things otherwise"]
    return dataclasses.replace(robot, warnings=(*robot.warnings, *told)) if told else robot


def _differences(robot: RobotModel) -> list[str]:
    root = etree.fromstring(robot.source.urdf_text.encode())
    capsules = _capsules(robot, root)
    return [*capsules, *_find_placed_otherwise(robot, root)]


def _capsules(robot: RobotModel, root: Any) -> list[str]:
    """Return sentences about capsules, also by `<collision_checking>`, which Pinocchio alone reads."""
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


def _find_placed_otherwise(robot: RobotModel, root: Any) -> list[str]:
    if not _is_known_to_both(robot, root):
        return []
    try:
        other = _read(root)
    except Exception as error:  # it raises whatever its Python raises, and a warning is all that comes of it
        return [f"yourdfpy can't read this URDF: {type(error).__name__}: {error}"]
    q = _choose_configuration(robot)
    given = {joint.name: scalar(joint, q) for joint in _joints(robot) if joint.mimic is None}
    if alone := given.keys() ^ set(other.actuated_joint_names):
        return [f"yourdfpy has other joints to move: {', '.join(sorted(alone))} are not in both"]
    other.update_cfg(given)
    return _find_misplaced(robot, q, other)


def _joints(robot: RobotModel) -> list[Joint]:
    return list(robot.joints if robot.source.root_joint == "fixed" else robot.joints[1:])


def _is_known_to_both(robot: RobotModel, root: Any) -> bool:
    joints = _joints(robot)
    scalar_joints = all(joint.kind in _SCALAR for joint in joints)
    followed = {mimic.get("joint") for mimic in root.findall("joint/mimic")}
    chained = any(joint.mimic is not None and joint.name in followed for joint in joints)
    return scalar_joints and not chained and not root.findall(".//origin[@quat_xyzw]")


def _read(root: Any) -> Any:
    import yourdfpy

    for element in [found for tag in _UNREAD for found in root.iter(tag)]:
        element.getparent().remove(element)
    for axis in [axis for axis in root.iter("axis") if axis.get("xyz")]:  # it slides by as much as a long axis says
        direction = np.array(axis.get("xyz").split(), float)
        length = np.linalg.norm(direction)
        if length > 0.0:  # that of a fixed joint may be anything
            axis.set("xyz", " ".join(map(repr, (direction / length).tolist())))
    logging.getLogger("yourdfpy").setLevel(logging.CRITICAL)  # what it finds is reported in the robot's warnings
    return yourdfpy.URDF.load(io.BytesIO(etree.tostring(root)), load_meshes=False, filename_handler=str)


def _find_misplaced(robot: RobotModel, q: RobotConfiguration, other: Any) -> list[str]:
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, q)
    root = data.oMf[robot.frame_id(other.base_link)]
    told, placed = [], _placements(other)
    for link in other.link_map:
        ours = root.actInv(data.oMf[robot.frame_id(link)]).homogeneous
        apart = float(np.abs(ours - placed[link]).max())
        if not apart <= PLACEMENT_TOLERANCE * max(1.0, float(np.abs(ours).max())):
            told.append(f"yourdfpy places link {link!r} otherwise, by {apart:.3g}")
    return told


def _placements(other: Any) -> dict[str, np.ndarray]:
    """Return the placement of each link relative to the root, (4, 4), as yourdfpy has them, joint by joint.

    Asked for the root's, it optimises the order of the matrix product, in a time that grows with the cube of its
    length.
    """
    children: dict[str, list[str]] = defaultdict(list)
    for joint in other.joint_map.values():
        children[joint.parent].append(joint.child)
    placed, left = {other.base_link: np.eye(4)}, [other.base_link]
    while left:
        link = left.pop()
        for child in children[link]:
            placed[child] = placed[link] @ other.get_transform(child, link)
            left.append(child)
    return placed


def _choose_configuration(robot: RobotModel) -> RobotConfiguration:
    """Return a configuration (nq,) with every joint away from zero and from its limits; mimic joints follow."""
    q = robot.rest.copy()
    for joint in robot.joints:
        if joint.kind in _SCALAR:
            limited = bool(np.isfinite([joint.lower[0], joint.upper[0]]).all())
            value = joint.lower[0] + BENT_SHARE * (joint.upper[0] - joint.lower[0]) if limited else BENT_SHARE
            q[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
    follow(robot.joints, q)
    return q
