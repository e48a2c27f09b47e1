"""The links of a URDF: inertia, visual and collision geometry, all of which can make Pinocchio lose the collision."""

from __future__ import annotations

import copy
from pathlib import Path

from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.robot.urdf.facts import CollisionFacts
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

SHAPES = {
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "capsule": {"radius": 1, "length": 1},
    "mesh": {"filename": 0},
}
"""What a `<geometry>` can be, and how many numbers each of its required attributes has (0: it is a name)."""

THICKNESS = 2e-6  # thickness of a collision body that has none [m]
NO_LENGTH = 1e-9  # a length below this is taken as zero [m]: areas of the like of 1e-150 are

NEVER_JUDGED = "a <visual> is never judged"
NOT_DRAWN = "this <visual> will not be drawn"
MASSLESS = "is left out: the link has no mass"
THIN = f"what is zero is judged as {1e3 * THICKNESS:g} mm"
REPEATED = (NEVER_JUDGED, NOT_DRAWN, THIN)  # ends of warnings that a robot may have for each of its links

CAPSULE_SINCE = (1, 1)
INERTIA = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def check_link(
    link: Element, version: tuple[int, int], resolver: MeshResolver, warnings: list[str]
) -> tuple[CollisionFacts, ...]:
    """Check one link, settle where its meshes are, and return its collision shapes; RobotInvalid at the first fault.

    The parser behind Pinocchio reads inertia, visuals and collisions in this order, and at the first that it can't read
    it leaves out all that follow, so that a malformed `<visual>` costs the link its collision geometry. Therefore
    visuals and inertias that can't be read are left out, with a warning: nothing is judged by them.
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
    mesh = _settle_collision_mesh(shape, resolver) if shape.tag == "mesh" else None
    return CollisionFacts(link=name_of(collision.getparent()), shape=shape.tag, mesh=mesh, line=collision.sourceline)


def _check_visual(visual: Element, version: tuple[int, int], resolver: MeshResolver, warnings: list[str]) -> None:
    check_origins(visual, version)
    shape = _check_geometry(visual, version, warnings)
    for material in visual.findall("material"):
        if material.get("name") is None:
            raise fault(material, "<material> must have a name")
    if shape.tag == "mesh":
        try:
            _settle_mesh(shape, resolver)
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

    What is judged then contains the point, line or face, and stands off by half of `THICKNESS`.
    """
    thin = []
    for attribute, count in SHAPES[shape.tag].items():
        sizes = numbers(shape, attribute, count) if count else None
        if sizes and min(sizes) < NO_LENGTH:
            least = 0.5 * THICKNESS if attribute == "radius" else THICKNESS
            thin.append(f"{attribute!r} of {shape.get(attribute)!r}")
            shape.set(attribute, " ".join(repr(size if size >= NO_LENGTH else least) for size in sizes))
    if thin:
        told = f"<{shape.tag}> has the {' and the '.join(thin)}; {THIN}"
        warnings.append(warning(shape, told))


def _settle_collision_mesh(mesh: Element, resolver: MeshResolver) -> Path:
    """Put the real path into a `<mesh>`, or name it and all later ones that can't be had."""
    try:
        return _settle_mesh(mesh, resolver)
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


def _settle_mesh(mesh: Element, resolver: MeshResolver) -> Path:
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
