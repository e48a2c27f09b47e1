"""Load a `RobotModel` from URDF text: check, let Pinocchio parse, settle shapes, groups, pairs, limits, tip and rest.

The order counts: each step needs those before. Default limits here are kept by motions where no file names others, and
are stated in docs/robots.md; the sentences are warnings of every reply about a robot that doesn't come with guidefield.
Such a URDF is read by yourdfpy too (`crosscheck`); only warnings come of that. With a `BENT_SHARE` of 0 or 0.5 joints
may stand at zero, where other axes make no difference; `SAME_PLACEMENT` is above rounding.
"""

from __future__ import annotations

import dataclasses
import io
import logging
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.robot.library import RobotCard
from guidefield.robot.model import pairs, rest
from guidefield.robot.model.collision_shapes import Meshes, choose_shapes, read_meshes
from guidefield.robot.model.configuration import scalar
from guidefield.robot.model.joints import (
    Joint,
    JointKind,
    LimitSource,
    Mimic,
    RobotConfiguration,
    position_names,
    velocity_names,
)
from guidefield.robot.model.mimic_joints import (
    bind_ranges,
    describe_bound_rates,
    find_unwrapped,
    follow,
    mimic_laws,
    with_unwrapped,
)
from guidefield.robot.model.model import (
    NO_GEOMETRY,
    ROOT_JOINT,
    RobotModel,
    RobotSource,
    find_size,
    frame_index,
    joint_indices,
    joints_to,
    moving_joint,
    set_planar_axes,
    with_ball_joints,
)
from guidefield.robot.model.neutral_names import capture_stderr, neutral_names
from guidefield.robot.urdf import srdf
from guidefield.robot.urdf.elements import UrdfFacts
from guidefield.robot.urdf.meshes import MeshResolver
from guidefield.robot.urdf.srdf import Srdf, SrdfGroup
from guidefield.robot.urdf.urdf_validation import check_geometry_complete, check_urdf

DEFAULT_ROTATION_SPEED = 1.0  # velocity limit of a rotation where URDF, card and request name none [rad/s]
DEFAULT_TRANSLATION_SPEED = 0.5  # velocity limit of a translation likewise [m/s]
NO_SPEED_LIMIT = 1e6  # a velocity limit of this or more represents none [rad/s or m/s]
TIME_TO_SPEED = 0.5  # default acceleration limits let a joint reach its velocity limit in this time [s]
FURTHEST = {JointKind.REVOLUTE: 200.0, JointKind.PRISMATIC: 1000.0}
"""Limits beyond this stand for none, and are taken for it [rad or m]: a motion of millions of turns could not be
certified. They are below `LARGEST_VALUE` of joints.py."""

ROOT_JOINTS = {"fixed": None, "planar": pin.JointModelPlanar, "free": pin.JointModelFreeFlyer}

VIRTUAL_ROOTS = {"planar": "planar", "floating": "free"}
"""Root joint that an SRDF's virtual joint means, by its type. Catalog, model.py and referee have tables of roots."""

KINDS = {
    **{f"JointModelR{axis}": JointKind.REVOLUTE for axis in ("X", "Y", "Z", "evoluteUnaligned")},
    **{f"JointModelR{axis}": JointKind.CONTINUOUS for axis in ("UBX", "UBY", "UBZ", "evoluteUnboundedUnaligned")},
    **{f"JointModelP{axis}": JointKind.PRISMATIC for axis in ("X", "Y", "Z", "rismaticUnaligned")},
    "JointModelPlanar": JointKind.PLANAR,
    "JointModelSpherical": JointKind.SPHERICAL,
    "JointModelFreeFlyer": JointKind.FLOATING,
}
"""Kind of joint by Pinocchio's name of it; a further name needs a row in `CODES` of model.py, too."""

SAME_PLACEMENT = 1e-6  # placements of links that differ by more than this [m, or 1] are not the same
MAX_REMARKS = 5  # differences that get a sentence each; the others are counted
BENT_SHARE = 0.3
"""Where in its range each joint stands while placements are compared; the value of those without limits [rad or m]."""
_UNREAD = ("visual", "collision", "transmission", "gazebo")
"""Elements that the other reader isn't given: it fails at shapes that it doesn't know, and would compare nothing."""
_SCALAR = (JointKind.REVOLUTE, JointKind.CONTINUOUS, JointKind.PRISMATIC)


def resolve_groups(
    model: Any, described: Srdf, joints: Sequence[Joint], warnings: list[str]
) -> dict[str, tuple[str, ...]]:
    """Return the joints of SRDF groups that can be planned for, in Pinocchio's order; warn of groups without any."""
    plannable = [joint.name for joint in joints if joint.is_driven]
    resolved = {}
    for name in described.groups:
        members = _find_members(model, described, name, frozenset())
        if ordered := tuple(joint for joint in plannable if joint in members):
            resolved[name] = ordered
        else:
            warnings.append(
                f"the SRDF's group {name!r} is left out: {_reason_left_out(described.groups[name], members, joints)}"
            )
    return resolved


def _reason_left_out(group: SrdfGroup, members: set[str], joints: Sequence[Joint]) -> str:
    kinds = {joint.name: "mimic" if joint.mimic is not None else "passive" for joint in joints}
    if moving := sorted(members & kinds.keys()):
        return f"its joints don't move by themselves ({', '.join(f'{name} is {kinds[name]}' for name in moving)})"
    return "it is empty" if group == SrdfGroup() else "no joint that moves is among what it names"


def _find_members(model: Any, described: Srdf, name: str, visiting: frozenset[str]) -> set[str]:
    """Joint names in a group; a group that contains itself adds nothing."""
    if name in visiting or name not in described.groups:
        return set()
    group = described.groups[name]
    members = set(group.joints)
    for link in group.links:
        if joint := moving_joint(model, link):
            members.add(model.names[joint])
    for chain in group.chains:
        members |= {*joints_to(model, chain.tip)} - {*joints_to(model, chain.base)}
    for inner in group.groups:
        members |= _find_members(model, described, inner, visiting | {name})
    return members


def load(
    name: str, source: RobotSource, semantics: str | srdf.Srdf | None, card: RobotCard, resolver: MeshResolver
) -> RobotModel:
    """Build a robot.

    Args:
        semantics: SRDF, as text or read, if there is one.
        card: Defaults that the URDF doesn't settle.

    Raises:
        RobotInvalid: if the URDF, its meshes or the SRDF cannot be used, with the element at fault.
    """
    facts = check_urdf(source.urdf_text, resolver)
    _check_root_joint(name, facts, source.root_joint)
    described = semantics if isinstance(semantics, srdf.Srdf) else srdf.parse(semantics) if semantics else srdf.Srdf()
    source = dataclasses.replace(source, urdf_text=facts.text)
    warnings = list(facts.warnings)
    model, geometry, meshes = _parse(name, source, facts, warnings)
    check_geometry_complete(facts, geometry, model)
    indices = joint_indices(model)
    axes = {indices[name]: np.array(joint.axis) for name, joint in facts.joints.items() if joint.axis is not None}
    set_planar_axes(model, geometry, axes)
    model = with_unwrapped(with_ball_joints(name, model, card.ball_joints), facts)
    known_joints = [*facts.joints, ROOT_JOINT, *described.virtual]
    warnings += [*described.warnings, *srdf.find_unknown_names(described, facts.links, known_joints)]
    warnings += _describe_differing_root(described, source.root_joint)
    if not geometry.ngeoms:
        warnings.append(f"robot {name!r} {NO_GEOMETRY}: it can be asked for forward and inverse kinematics alone")
    size = find_size(model, geometry, {name: mesh.vertices for name, (*_, mesh) in meshes.items()})
    choices = choose_shapes(model, geometry, meshes, facts.meshes, size, warnings)
    laws = mimic_laws(facts)
    joints = tuple(_make_joint(model, index, facts, laws, card, warnings) for index in range(1, model.njoints))
    _check_columns(name, joints)
    for turning, mimic in find_unwrapped(facts).items():
        warnings.append(
            f"joint {turning!r} is continuous, but {mimic!r}, which follows it, is elsewhere after a turn of it: "
            f"{turning!r} is a revolute joint therefore, whose whole turns count"
        )
    joints = bind_ranges(joints, warnings)
    warnings += describe_bound_rates(joints)
    joints = _mark_passive(joints, described, warnings)
    groups = resolve_groups(model, described, joints, warnings)
    stated = rest.stated(model, joints, described, card, warnings)
    links = [choice.link for choice in choices]
    disabled = described.find_disabled(facts.links)
    settled = pairs.choose_pairs(model, geometry, joints, links, disabled, described.said_by, stated.q, size)
    warnings += settled.warnings
    q_rest = rest.choose_rest(model, geometry, joints, links, stated.q, size, warnings)
    return RobotModel(
        name=name,
        model=model,
        geometry=geometry,
        joints=joints,
        links=tuple(frame.name for frame in model.frames if frame.type == pin.FrameType.BODY),
        tip=default_tip(model, described, card),
        groups=groups if card.group is None else {"default": tuple(card.group), **groups},
        rest=q_rest,
        geometry_choices=choices,
        pairs_left_out=settled.left_out,
        warnings=tuple(warnings),
        source=source,
        rest_state=stated.state,
        size=size,
    )


def _describe_differing_root(described: srdf.Srdf, root_joint: str) -> list[str]:
    """Return a sentence for each virtual joint of an SRDF that means another root joint than the robot has."""
    return [
        f"the SRDF's virtual joint {name!r} is {kind}, but the robot's root is {root_joint}: `root_joint` may be"
        f" {VIRTUAL_ROOTS[kind]!r}"
        for name, kind in described.virtual.items()
        if kind in VIRTUAL_ROOTS and root_joint == "fixed"
    ]


def _mark_passive(joints: Sequence[Joint], described: srdf.Srdf, warnings: list[str]) -> tuple[Joint, ...]:
    names = [ROOT_JOINT if name in described.virtual else name for name in described.passive]
    marked = [joint.name for joint in joints if joint.name in names and joint.mimic is None]
    if marked:
        warnings.append(
            f"the SRDF calls {', '.join(map(repr, marked))} passive: planned for only where `group` names such a joint"
        )
    return tuple(dataclasses.replace(joint, passive=joint.name in marked) for joint in joints)


def _check_root_joint(name: str, facts: UrdfFacts, root_joint: str) -> None:
    """Refuse a joint named as the one by which the robot moves in the world: requests couldn't tell them apart."""
    if root_joint != "fixed" and (joint := facts.joints.get(ROOT_JOINT)) is not None:
        raise RobotInvalid(
            f"line {joint.line}: joint {ROOT_JOINT!r} has the name of the joint by which robot {name!r} moves in the"
            f" world, as its root joint is {root_joint!r}: give it another name",
            line=joint.line,
            element="joint",
            joint=ROOT_JOINT,
        )


def _check_columns(name: str, joints: Sequence[Joint]) -> None:
    """Refuse joints whose names make the same column of positions or velocities: replies couldn't tell them apart."""
    for columns_of in (position_names, velocity_names):
        owners: dict[str, str] = {}
        for joint in joints:
            for column in columns_of(joint):
                if (other := owners.setdefault(column, joint.name)) != joint.name:
                    raise RobotInvalid(
                        f"robot {name!r}: joints {other!r} and {joint.name!r} would both have the column {column!r}:"
                        " give one of them another name",
                        joints=[other, joint.name],
                        column=column,
                    )


def _parse(name: str, source: RobotSource, facts: UrdfFacts, warnings: list[str]) -> tuple[Any, Any, Meshes]:
    root = ROOT_JOINTS[source.root_joint]
    text, meshes = read_meshes(facts, warnings)
    names = neutral_names(text)
    with capture_stderr() as stderr:
        try:
            model = pin.buildModelFromXML(names.text, root()) if root else pin.buildModelFromXML(names.text)
            geometry = pin.GeometryModel()
            pin.buildGeomFromUrdfString(model, names.text, pin.GeometryType.COLLISION, geometry, [])
        except (ValueError, RuntimeError) as error:
            reason = stderr.reason() or " ".join(str(error).partition("message: ")[2].split()) or str(error)
            reason = names.restore_text(reason)
            raise RobotInvalid(f"robot {name!r} could not be read: {reason}", robot=name) from None
    names.restore(model, geometry)
    return model, geometry, meshes


def _make_joint(
    model: Any, index: int, facts: UrdfFacts, laws: Mapping[str, Mimic], card: RobotCard, warnings: list[str]
) -> Joint:
    pinocchio_joint = model.joints[index]
    name, short = model.names[index], pinocchio_joint.shortname()
    if short not in KINDS:
        raise RobotInvalid(f"joint {name!r} is a {short}, which cannot be planned for", joint=name, kind=short)
    kind = KINDS[short]
    at_q = slice(pinocchio_joint.idx_q, pinocchio_joint.idx_q + pinocchio_joint.nq)
    lower, upper = np.full(pinocchio_joint.nv, -np.inf), np.full(pinocchio_joint.nv, np.inf)
    if kind in (JointKind.REVOLUTE, JointKind.PRISMATIC):
        lower, upper = model.lowerPositionLimit[at_q] + 0.0, model.upperPositionLimit[at_q] + 0.0  # no negative zero
        furthest = FURTHEST[kind]
        if np.isfinite(upper[0]) and max(-lower[0], upper[0]) > furthest:  # infinite where there are none
            warnings.append(f"joint {name!r}: its limits {lower[0]:g} and {upper[0]:g} are taken for {furthest:g}")
            lower, upper = np.clip(lower, -furthest, furthest), np.clip(upper, -furthest, furthest)
    said = facts.joints[name].velocity if name in facts.joints else None
    velocity, velocity_source = _velocity_limit(kind, pinocchio_joint.nv, said, card.velocity.get(name))
    acceleration = velocity / TIME_TO_SPEED
    acceleration_source = LimitSource.DEFAULT
    if name in card.acceleration:
        acceleration, acceleration_source = np.full(pinocchio_joint.nv, card.acceleration[name]), LimitSource.CARD
    for array in (lower, upper, velocity, acceleration):
        array.setflags(write=False)
    return Joint(
        name=name,
        kind=kind,
        index=index,
        idx_q=pinocchio_joint.idx_q,
        nq=pinocchio_joint.nq,
        idx_v=pinocchio_joint.idx_v,
        nv=pinocchio_joint.nv,
        lower=lower,
        upper=upper,
        velocity=velocity,
        acceleration=acceleration,
        velocity_source=velocity_source,
        acceleration_source=acceleration_source,
        mimic=laws.get(name),
    )


def _velocity_limit(kind: JointKind, nv: int, urdf: float | None, card: float | None) -> tuple[np.ndarray, LimitSource]:
    """Return the velocity limit of each freedom; a URDF's limit of a joint with several freedoms binds each of them."""
    if card is not None:
        return np.full(nv, card), LimitSource.CARD
    if urdf is not None and 0.0 < urdf < NO_SPEED_LIMIT:
        return np.full(nv, urdf), LimitSource.URDF
    rotation, translation = DEFAULT_ROTATION_SPEED, DEFAULT_TRANSLATION_SPEED
    by_kind = {
        JointKind.PRISMATIC: [translation],
        JointKind.PLANAR: [translation, translation, rotation],
        JointKind.FLOATING: [translation] * 3 + [rotation] * 3,
    }
    return np.array(by_kind.get(kind, [rotation] * nv)), LimitSource.DEFAULT


def default_tip(model: Any, described: srdf.Srdf, card: RobotCard) -> str:
    """Return the frame that goals are about: the card's, else the SRDF's, else the one that most joints move."""
    if card.tip is not None:
        return card.tip
    for parent_link, _ in described.end_effectors:
        if frame_index(model, parent_link) is not None:
            return parent_link
    bodies = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
    depth = [len(model.supports[frame.parentJoint]) for frame in bodies]
    return str(bodies[max(range(len(bodies)), key=lambda i: (depth[i], i))].name)


def crosscheck(robot: RobotModel) -> RobotModel:
    """Add a warning for whatever yourdfpy reads otherwise than Pinocchio; faults are found by `check_urdf`.

    Compared are capsules, which yourdfpy doesn't know, the joints that can be given, and the placement of each link
    with every joint bent. Placements of robots with what yourdfpy doesn't know are not compared: joints of several
    degrees of freedom, mimic joints of mimic joints, and rotations as quaternions (URDF 1.1). No file is opened.
    """
    root = etree.fromstring(robot.source.urdf_text.encode())
    remarks = [*_describe_capsules(robot, root), *_find_placed_otherwise(robot, root)]
    if len(remarks) > MAX_REMARKS:
        remarks = [*remarks[:MAX_REMARKS], f"yourdfpy reads {len(remarks) - MAX_REMARKS} more things otherwise"]
    return dataclasses.replace(robot, warnings=(*robot.warnings, *remarks)) if remarks else robot


def _describe_capsules(robot: RobotModel, root: Any) -> list[str]:
    """Return sentences about capsules, also by `<collision_checking>`, which Pinocchio alone reads."""
    shapes = {link.get("name"): [shape.tag for shape in link.iterfind("collision/geometry/*")] for link in root}
    rounded = dict.fromkeys(
        choice.link
        for choice in robot.geometry_choices
        if choice.shape == "capsule" and "cylinder" in shapes.get(choice.link, ())
    )
    unknown = [link for link, tags in shapes.items() if "capsule" in tags]
    remarks = (
        (rounded, "by <collision_checking> a cylinder is a capsule; yourdfpy and other tools read flat ends"),
        (unknown, "yourdfpy and other tools don't know <capsule>, and see nothing there"),
    )
    return [f"link {', '.join(map(repr, links))}: {what}" for links, what in remarks if links]


def _find_placed_otherwise(robot: RobotModel, root: Any) -> list[str]:
    if not _is_known_to_both(robot, root):
        return []
    try:
        other = _read_by_yourdfpy(root)
    except Exception as error:  # it raises whatever its Python raises, and a warning is all that comes of it
        return [f"yourdfpy can't read this URDF: {type(error).__name__}: {error}"]
    q = _choose_configuration(robot)
    given = {joint.name: scalar(joint, q) for joint in _own_joints(robot) if joint.mimic is None}
    if alone := given.keys() ^ set(other.actuated_joint_names):
        return [f"yourdfpy has other joints to move: {', '.join(sorted(alone))} are not in both"]
    other.update_cfg(given)
    return _find_misplaced(robot, q, other)


def _own_joints(robot: RobotModel) -> list[Joint]:
    return list(robot.joints if robot.source.root_joint == "fixed" else robot.joints[1:])


def _is_known_to_both(robot: RobotModel, root: Any) -> bool:
    joints = _own_joints(robot)
    scalar_joints = all(joint.kind in _SCALAR for joint in joints)
    followed = {mimic.get("joint") for mimic in root.findall("joint/mimic")}
    chained = any(joint.mimic is not None and joint.name in followed for joint in joints)
    return scalar_joints and not chained and not root.findall(".//origin[@quat_xyzw]")


def _read_by_yourdfpy(root: Any) -> Any:
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
    differences, placed = [], _find_placements(other)
    for link in other.link_map:
        ours = root.actInv(data.oMf[robot.frame_id(link)]).homogeneous
        apart = float(np.abs(ours - placed[link]).max())
        if not apart <= SAME_PLACEMENT * max(1.0, float(np.abs(ours).max())):
            differences.append(f"yourdfpy places link {link!r} otherwise, by {apart:.3g}")
    return differences


def _find_placements(other: Any) -> dict[str, np.ndarray]:
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
