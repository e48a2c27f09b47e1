"""Check the links and joints of a URDF, and hold the facts about one that has been checked.

Everything that can make Pinocchio's parser lose or misread collision geometry is refused or rewritten here.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.robot.urdf.meshes import MAX_LISTED, MeshResolver
from guidefield.robot.urdf.xml import (
    LARGEST_LENGTH,
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

JOINT_DOF = {"revolute": 1, "continuous": 1, "prismatic": 1, "fixed": 0, "floating": 6, "planar": 3}
"""Degrees of freedom of each type of joint that a URDF can have."""

SCALAR_JOINTS = ("revolute", "continuous", "prismatic")
"""Types of joints with one value, which can follow a joint and be followed."""


@dataclass(frozen=True)
class JointFacts:
    """One joint as its URDF has it."""

    name: str
    kind: str  # its type, a key of `JOINT_DOF`
    parent: str
    child: str
    line: int  # where it stands in the text
    # its `<limit>` [rad or m], 0 where an entry is left out; None without `<limit>`, and for types that have no range
    lower: float | None
    upper: float | None
    velocity: float | None  # the same [rad/s or m/s; N m or N], 0 where they are negative or left out
    effort: float | None
    # normal of the plane of a planar joint, of any length; None for other types
    axis: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class CollisionFacts:
    """One `<collision>` as written: the link it belongs to, its shape, its mesh file if it is one, and its line."""

    link: str
    shape: str
    mesh: Path | None
    line: int


@dataclass(frozen=True)
class UrdfFacts:
    """A URDF that has been checked."""

    name: str
    root: str  # the link that has no parent
    links: tuple[str, ...]  # link names in the order of the text
    joints: Mapping[str, JointFacts]  # joints by name, in the order of the text
    collisions: Mapping[str, tuple[CollisionFacts, ...]]  # collision shapes by link; links without any are left out
    # by mimic joint: name of its source joint, multiplier, offset. A source joint may itself be a mimic joint; there
    # are no cycles
    mimics: Mapping[str, tuple[str, float, float]]
    warnings: tuple[str, ...]  # what is odd but harmless
    meshes: Mapping[str, str]  # the URI of each mesh file, by the path that stands in `text` now
    # the URDF as checked, for the parsers that come next: without comments, numbers separated by single spaces, mesh
    # files as absolute paths, and without those `<visual>` whose mesh can't be read
    text: str


PLAIN_AXIS = (1e-3, 1e3)
"""Smallest and largest entry of an axis that parsers are given as it is; the squares of others may overflow."""
LARGEST_FACTOR = 1e6  # largest multiplier of a mimic joint, and its largest offset [rad or m]
LEAST_SPEED = 1e-9
"""Least velocity limit, except zero, which means none [rad/s or m/s]; no motion with a smaller one would end."""
DEFAULT_AXIS = (1.0, 0.0, 0.0)  # axis of a joint without `<axis>`

_UNUSED_NUMBERS = {
    "dynamics": ("damping", "friction"),
    "safety_controller": ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"),
    "calibration": ("rising", "falling"),
}
"""Attributes that planning doesn't use; if they weren't numbers, the parser would refuse the joint for them."""

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
    """Check mimic joints; return name to (name of the source joint, multiplier, offset), of those that move.

    A name that is wrong only in that it lacks the prefix of the mimic joint (`left_finger2` follows `finger1`, and
    there is a `left_finger1`) is taken for the one with the prefix, with a warning: macros write such files.

    Raises:
        RobotInvalid: if a joint mimics itself, nothing, or a joint without one value; or if mimics form a cycle.
    """
    mimics = {}
    for name, joint in elements.items():
        for element in joint.findall("mimic")[:1]:
            source = _find_source(element, joints[name], joints, warnings)
            multiplier, offset = (
                number(element, attribute, default, LARGEST_FACTOR)
                for attribute, default in (("multiplier", 1.0), ("offset", 0.0))
            )
            if source is not None:
                mimics[name] = (source, multiplier, offset)
    for name in mimics:
        chain = [name]
        while chain[-1] in mimics:
            chain.append(mimics[chain[-1]][0])
            if chain[-1] == name:
                raise fault(elements[name].find("mimic"), f"mimics form a cycle: {' mimics '.join(chain)}", cycle=chain)
            if chain[-1] in chain[:-1]:
                break  # a cycle that doesn't come back here is found from one of its members
    return mimics


def _find_source(
    element: Element, mimic: JointFacts, joints: Mapping[str, JointFacts], warnings: list[str]
) -> str | None:
    """Return the name of a mimic joint's source joint; None if the mimic joint is fixed."""
    source = element.get("joint", "")
    if mimic.kind == "fixed":
        warnings.append(warning(element, f"a fixed joint can't mimic {source!r}; it stays fixed"))
        return None
    if mimic.kind not in SCALAR_JOINTS:
        raise fault(element, f"a {mimic.kind} joint can't mimic another")
    if source == mimic.name:
        raise fault(element, "a joint can't mimic itself")
    if source not in joints:
        unknown = f"mimics {source!r}, but there is no such joint"
        meant = _find_prefixed(source, mimic.name, joints)
        if len(meant) != 1:
            raise fault(element, f"{unknown}; there are {', '.join(joints)}", mimics=source)
        source = meant[0]
        warnings.append(warning(element, f"{unknown}; taken for {source!r}"))
    if (kind := joints[source].kind) not in SCALAR_JOINTS:
        valid = ", ".join(SCALAR_JOINTS)
        raise fault(
            element, f"mimics {source!r}, which is {kind}; only {valid} joints have one value to follow", mimics=source
        )
    return str(source)


def _find_prefixed(source: str, mimic: str, joints: Iterable[str]) -> list[str]:
    prefixes = {name: name[: -len(source)] for name in joints if source and name.endswith(source) and name != mimic}
    return [name for name, prefix in prefixes.items() if mimic.startswith(prefix)]


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
    """Check an axis and return its direction, rewritten with numbers of a plain size, as only the direction counts."""
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
    """Return whether a range that is ignored restricts nothing: none is given, or a continuous joint's is a turn."""
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


SHAPES = {
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "capsule": {"radius": 1, "length": 1},
    "mesh": {"filename": 0},
}
"""What a `<geometry>` can be, and how many numbers each of its required attributes has (0: it is a name).

These are the shapes that Pinocchio's parser reads: it would lose any other.
"""

THICKNESS = 2e-6  # thickness of a body that has none [m]; far below `POINT_EXTENT` of model.py, not below `NO_LENGTH`
NO_LENGTH = 1e-9  # a length below this is zero, of a held object refused [m]: products of such lengths underflow

NEVER_JUDGED = "a <visual> is never judged"
NOT_DRAWN = "this <visual> will not be drawn"
MASSLESS = "is left out: the link has no mass"
THIN = f"what is zero is judged as {1e3 * THICKNESS:g} mm"
REPEATED = (NEVER_JUDGED, NOT_DRAWN, THIN)
"""Ends of warnings that a robot may have for each of its links: `urdf_validation.py` merges those of the same end."""

CAPSULE_SINCE = (1, 1)
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def check_link(
    link: Element, version: tuple[int, int], resolver: MeshResolver, warnings: list[str]
) -> tuple[CollisionFacts, ...]:
    """Check one link, settle where its meshes are, and return its collision shapes; RobotInvalid at the first fault.

    The parser behind Pinocchio reads inertia, visuals and collisions in this order, and at the first that it can't read
    it leaves out all that follow, so that a malformed `<visual>` costs the link its collision geometry. Therefore
    visuals and inertias that can't be read are left out, with a warning: no verdict depends on them.
    """
    warn_of_repeated(link, "inertial", warnings)
    for inertial in link.findall("inertial"):
        if any("${" in value for part in inertial.iter() for value in part.attrib.values()):
            warnings.append(warning(inertial, f"<inertial> has leftovers of xacro and {MASSLESS}"))
            link.remove(inertial)
            continue
        warn_of_repeated(inertial, "origin", warnings)
        with leaving_out(inertial, MASSLESS, warnings):
            _check_inertial(inertial, version)
    for visual in link.findall("visual"):
        with leaving_out(visual, NOT_DRAWN, warnings):
            _check_visual(visual, version, resolver, warnings)
    for part in (*link.findall("visual"), *link.findall("collision")):
        warn_of_repeated(part, "origin", warnings)
    for collision in link.findall("collision"):
        _split(collision, warnings)
    return tuple(_check_collision(collision, version, resolver, warnings) for collision in link.findall("collision"))


def _split(collision: Element, warnings: list[str]) -> None:
    """Give each further shape of a `<collision>` one of its own, as parsers read the first alone."""
    geometries = collision.findall("geometry")
    shapes = [shape for geometry in geometries for shape in geometry]
    for further in shapes[1:]:
        if further.tag in SHAPES:
            own = etree.Element("collision")
            for origin in collision.findall("origin")[:1]:
                own.append(copy.deepcopy(origin))
            etree.SubElement(own, "geometry").append(copy.deepcopy(further))
            own.sourceline = further.sourceline
            collision.getparent().append(own)
            what = "a second shape in one <collision> is judged too; other tools leave it out"
        else:
            what = f"<{further.tag}> is no shape and is left out of <geometry>"
        warnings.append(warning(further, what))
        further.getparent().remove(further)
    for geometry in geometries:
        if shapes and not len(geometry):
            collision.remove(geometry)


def _check_collision(
    collision: Element, version: tuple[int, int], resolver: MeshResolver, warnings: list[str]
) -> CollisionFacts:
    check_origins(collision, version)
    shape = _check_geometry(collision, version, None)
    _thicken(shape, warnings)
    mesh = _resolve_collision_mesh(shape, resolver) if shape.tag == "mesh" else None
    return CollisionFacts(link=name_of(collision.getparent()), shape=shape.tag, mesh=mesh, line=collision.sourceline)


def _check_visual(visual: Element, version: tuple[int, int], resolver: MeshResolver, warnings: list[str]) -> None:
    check_origins(visual, version)
    shape = _check_geometry(visual, version, warnings)
    for material in visual.findall("material"):
        if material.get("name") is None:
            raise fault(material, "<material> must have a name")
    if shape.tag == "mesh":
        try:
            _resolve_mesh(shape, resolver)
        except RobotInvalid:
            raise fault(shape, f"mesh {shape.get('filename')!r} can't be read") from None


def _check_geometry(owner: Element, version: tuple[int, int], warnings: list[str] | None) -> Element:
    """Return the one shape of a `<visual>` or `<collision>`; faults that collisions alone mind may be warnings."""

    def complain(element: Element, message: str) -> None:
        if warnings is None:
            raise fault(element, message)
        warnings.append(warning(element, f"{message}; {NEVER_JUDGED}"))

    shapes = [shape for geometry in owner.findall("geometry") for shape in geometry]
    if not shapes:
        raise fault(owner, f"<{owner.tag}> must have a <geometry> with a shape ({_shape_names(version)})")
    if len(shapes) > 1:
        complain(
            shapes[1], f"a second shape in one <{owner.tag}> would be left out; it needs a <{owner.tag}> of its own"
        )
    shape = shapes[0]
    if shape.tag == "capsule" and version < CAPSULE_SINCE:
        raise fault(shape, 'a <capsule> needs <robot version="1.1">; in this version it would be left out')
    if shape.tag not in SHAPES:
        raise fault(shape, f"unknown shape <{shape.tag}>; a <geometry> is one of {_shape_names(version)}")
    for attribute, count in SHAPES[shape.tag].items():
        if not shape.get(attribute, "").strip():
            raise fault(shape, f"<{shape.tag}> must have {attribute!r}", attribute=attribute)
        sizes = numbers(shape, attribute, count, LARGEST_LENGTH) if count else None
        if sizes and (min(sizes) < 0.0 or (min(sizes) == 0.0 and owner.tag == "visual")):
            complain(shape, f"{attribute!r} of <{shape.tag}> must be positive, got {shape.get(attribute)!r}")
    if shape.tag == "mesh" and len(shape.get("scale", "").split()) == 1:
        shape.set("scale", " ".join([shape.get("scale")] * 3))  # as other tools read it
    scale = numbers(shape, "scale", 3, LARGEST_LENGTH) if shape.tag == "mesh" else None
    if scale and 0.0 in scale and owner.tag == "visual":
        complain(shape, f"'scale' of <mesh> must not be zero, got {shape.get('scale')!r}")
    return shape


def _thicken(shape: Element, warnings: list[str]) -> None:
    """Give a `<collision>` without extent along some direction a thickness, so that it has an inside.

    The tested shape then contains the point, line or face, and stands off by half of `THICKNESS`.
    """
    thin = []
    for attribute, count in SHAPES[shape.tag].items():
        sizes = numbers(shape, attribute, count) if count else None
        if sizes and min(sizes) < NO_LENGTH:
            least = 0.5 * THICKNESS if attribute == "radius" else THICKNESS
            thin.append(f"{attribute!r} of {shape.get(attribute)!r}")
            shape.set(attribute, " ".join(repr(size if size >= NO_LENGTH else least) for size in sizes))
    if thin:
        sentence = f"<{shape.tag}> has the {' and the '.join(thin)}; {THIN}"
        warnings.append(warning(shape, sentence))


def _resolve_collision_mesh(mesh: Element, resolver: MeshResolver) -> Path:
    """Put the real path into a `<mesh>`; if it isn't there, the fault names it and all later ones that aren't."""
    try:
        return _resolve_mesh(mesh, resolver)
    except RobotInvalid as error:
        meshes = mesh.getroottree().getroot().findall("link/collision/geometry/mesh")
        own, *later = dict.fromkeys(one.get("filename", "").strip() for one in meshes[meshes.index(mesh) :])
        missing = [uri for uri in later if uri and not _can_be_had(uri, resolver)]
        error.details["missing"] = [own, *missing]
        if not missing:
            raise
        more = f" and {len(missing) - MAX_LISTED} more" if len(missing) > MAX_LISTED else ""
        listed = ", ".join(map(repr, missing[:MAX_LISTED]))
        raise RobotInvalid(f"{error.message}; these can't be had either: {listed}{more}", **error.details) from None


def _can_be_had(uri: str, resolver: MeshResolver) -> bool:
    try:
        return bool(resolver.resolve(uri))
    except RobotInvalid:
        return False


def _resolve_mesh(mesh: Element, resolver: MeshResolver) -> Path:
    try:
        path = resolver.resolve(mesh.get("filename").strip())
    except RobotInvalid as error:
        raise fault(mesh, error.message, **error.details) from None
    mesh.set("filename", str(path))
    return path


def _check_inertial(inertial: Element, version: tuple[int, int]) -> None:
    check_origins(inertial, version)
    for tag, attributes in (("mass", ("value",)), ("inertia", INERTIA)):
        element = inertial.find(tag)
        if element is None:
            raise fault(inertial, f"<inertial> must have <{tag}>")
        for attribute in attributes:
            number(element, attribute)


def _shape_names(version: tuple[int, int]) -> str:
    return ", ".join(shape for shape in SHAPES if shape != "capsule" or version >= CAPSULE_SINCE)
