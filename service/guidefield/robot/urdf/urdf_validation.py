"""Validate URDFs before Pinocchio, which refuses faults without a reason or accepts them in silence.

Faults are refused if they could change a verdict; others are warnings and are left out of the text that goes on.
An element or attribute that starts to matter belongs in `ELEMENTS` or `ATTRIBUTES`, so that misspelt ones are noticed.
"""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from typing import Any

import pinocchio as pin
from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.robot.urdf.elements import (
    JOINT_DOF,
    REPEATED,
    JointFacts,
    UrdfFacts,
    check_joint,
    check_link,
    check_mimics,
    name_of_end,
)
from guidefield.robot.urdf.meshes import MeshResolver
from guidefield.robot.urdf.xml import Element, fault, name_of, parse, warning

UNNAMED = "robot"  # name of a robot that has none
MAX_LINKS = 2_000  # stated in service/docs/robots.md, as is the next one
MAX_DOF = 300
"""Most degrees of freedom: Pinocchio's working memory grows with their cube (300: 0.9 GB; 1000: no memory left)."""

OLDEST_VERSION, NEWEST_VERSION = (1, 0), (1, 2)


def check_urdf(text: str, resolver: MeshResolver) -> UrdfFacts:
    """Check a URDF before Pinocchio sees it.

    Raises:
        RobotInvalid: at the first fault; its details hold line and element, and the joint or link that it is in.
    """
    warnings: list[str] = []
    root = parse(text, warnings)
    version = _version(root)
    if not root.get("name", "").strip():
        warnings.append(warning(root, f"<robot> has no name: it is called {UNNAMED!r}"))
        root.set("name", UNNAMED)
    warn_of_misspelt(root, warnings)
    if (count := len(root.findall("link"))) > MAX_LINKS:
        raise fault(root, f"the robot has {count} links, at most {MAX_LINKS} are read", limit=MAX_LINKS)
    links, joint_elements = _by_name(root, "link"), _by_name(root, "joint")
    _drop_repeated_materials(root, warnings)
    if not links:
        raise fault(root, "a robot must have at least one <link>")
    _add_root(root, links, joint_elements, warnings)
    joints = {key: check_joint(element, links, version, warnings) for key, element in joint_elements.items()}
    mimics = check_mimics(joint_elements, joints, warnings)
    root_link = _check_tree(root, links, joints, joint_elements)
    written = [(mesh, mesh.get("filename", "")) for mesh in root.iter("mesh")]
    collisions = {key: check_link(element, version, resolver, warnings) for key, element in links.items()}
    warnings += resolver.warnings()
    return UrdfFacts(
        name=root.get("name"),
        root=root_link,
        links=tuple(links),
        joints=joints,
        collisions={key: shapes for key, shapes in collisions.items() if shapes},
        mimics=mimics,
        warnings=tuple(_fold(warnings)),
        meshes={mesh.get("filename"): uri for mesh, uri in written},
        text=etree.tostring(root, encoding="unicode"),
    )


def check_geometry_complete(facts: UrdfFacts, geometry_model: Any, model: Any) -> None:
    """Check that Pinocchio has read every collision shape; RobotInvalid, with the link, if a `<collision>` got lost."""
    read = dict.fromkeys(facts.links, 0)
    for shape in geometry_model.geometryObjects:
        frame = model.frames[shape.parentFrame]
        assert frame.type == pin.FrameType.BODY, "collision shapes of a URDF belong to links"
        read[frame.name] += 1
    for link, count in read.items():
        written = facts.collisions.get(link, ())
        if count != len(written):
            line = written[0].line if written else None
            raise RobotInvalid(
                f"link {link!r} has {len(written)} <collision> shapes, but {count} were read",
                link=link,
                line=line,
                element="collision",
            )


def _fold(warnings: Collection[str]) -> list[str]:
    """Merge warnings that say the same about many links: keep the first, with the number of the others."""
    ends = {sentence: sentence.rpartition("; ")[2] for sentence in warnings}
    counts = Counter(ends[sentence] for sentence in warnings)
    kept: list[str] = []
    for sentence in warnings:
        end = ends[sentence]
        if end not in REPEATED or not (count := counts.pop(end, 0)):
            kept += [sentence] if end not in REPEATED else []
            continue
        kept.append(f"{sentence} ({count - 1} more likewise)" if count > 1 else sentence)
    return kept


def _version(root: Element) -> tuple[int, int]:
    written = root.get("version", "1.0").strip()
    match = re.fullmatch(r"([0-9]{1,4})\.([0-9]{1,4})", written)
    version = (int(match.group(1)), int(match.group(2))) if match else (0, 0)
    if not OLDEST_VERSION <= version <= NEWEST_VERSION:
        raise fault(root, f"'version' of <robot> must be 1.0, 1.1 or 1.2, got {written!r}", attribute="version")
    return version


def _by_name(root: Element, tag: str) -> dict[str, Element]:
    named: dict[str, Element] = {}
    for element in root.findall(tag):
        name = name_of(element)
        if name in named:
            first = named[name].sourceline
            raise fault(element, f"the name is already that of the <{tag}> in line {first}", first=first)
        named[name] = element
    return named


def _drop_repeated_materials(root: Element, warnings: list[str]) -> None:
    """Leave out materials that are defined again: nothing uses colours, but parsers refuse the robot for them."""
    named: dict[str, Element] = {}
    for material in root.findall("material"):
        first = named.setdefault(name_of(material), material)
        if first is not material:
            same = f"the <material> in line {first.sourceline} has the name {material.get('name')!r}, too"
            warnings.append(warning(material, f"{same}: this one is left out"))
            root.remove(material)


def _add_root(root: Element, links: dict[str, Element], joints: Mapping[str, Element], warnings: list[str]) -> None:
    """Add the link that a part of a robot is mounted on, where joints name it as a parent and nothing defines it.

    It is added where it is the only one that is missing, and each link hangs below another; so it is no misspelt name.
    """
    children = {name_of_end(joint, "child") for joint in joints.values()}
    missing = {parent: joint for joint in joints.values() if (parent := name_of_end(joint, "parent")) not in links}
    if len(missing) != 1 or not children >= links.keys() or missing.keys() & children:
        return
    (name, joint), *_ = missing.items()
    said = f"parent link {name!r} does not exist: it is taken for an empty link, where the robot is mounted"
    warnings.append(warning(joint, said))
    links[name] = etree.SubElement(root, "link", name=name)


def _check_tree(
    root: Element, links: Collection[str], joints: Mapping[str, JointFacts], elements: Mapping[str, Element]
) -> str:
    """Return the root link of a URDF, and refuse joints that don't make one tree of all links."""
    above: dict[str, JointFacts] = {}
    for joint in joints.values():
        if joint.child in above:
            both = [above[joint.child].name, joint.name]
            message = f"link {joint.child!r} is already the child of joint {both[0]!r}: a link has one parent"
            raise fault(elements[joint.name], message, link=joint.child, joints=both)
        above[joint.child] = joint
    if loop := _loop(links, above):
        names = [joint.parent for joint in loop]
        raise fault(elements[loop[0].name], f"the joints form a loop through {', '.join(names)}", links=names)
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        raise fault(root, f"a robot must have one root link, but {', '.join(roots)} have no parent", links=roots)
    dof = sum(JOINT_DOF[joint.kind] for joint in joints.values())
    if dof > MAX_DOF:
        raise fault(root, f"the robot has {dof} degrees of freedom, at most {MAX_DOF} are read", limit=MAX_DOF)
    return roots[0]


def _loop(links: Collection[str], above: Mapping[str, JointFacts]) -> list[JointFacts]:
    """Find the joints of a loop, each below the next; empty if every link leads up to a root."""
    rooted: set[str] = set()
    for start in links:
        climbed: dict[str, JointFacts] = {}
        link = start
        while link in above and link not in rooted:
            if link in climbed:
                joints = list(climbed.values())
                return joints[joints.index(climbed[link]) :]
            climbed[link] = above[link]
            link = above[link].parent
        rooted.update(climbed)
    return []


ELEMENTS = {
    "robot": ("link", "joint"),
    "link": ("inertial", "visual", "collision"),
    "joint": ("origin", "parent", "child", "axis", "limit", "mimic"),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry"),
    "collision": ("origin", "geometry"),
}
"""Children of each element that decide where something is, or whether it is there."""

ATTRIBUTES = {
    "origin": ("xyz", "rpy", "quat_xyzw"),
    "axis": ("xyz",),
    "limit": ("lower", "upper", "velocity", "effort"),
    "mimic": ("joint", "multiplier", "offset"),
    "mesh": ("filename", "scale"),
}
"""Attributes of each element that do the same."""

SIMILAR = 0.8  # least similarity of a misspelt name to the one that is meant, as `difflib` has it


def warn_of_misspelt(root: Element, warnings: list[str]) -> None:
    """Tell of misspelt elements and attributes, such as `<Collision>`; they are left out."""
    for element in root.iter(*ELEMENTS, *ATTRIBUTES):
        if element.getparent() is not None and element.getparent().tag not in (*ELEMENTS, "geometry"):
            continue  # inside something that isn't URDF, such as <gazebo>
        for child in element:
            if isinstance(child.tag, str) and (meant := _meant(child.tag, ELEMENTS.get(element.tag, ()))):
                warnings.append(warning(child, f"<{child.tag}> is unknown and left out: is <{meant}> meant?"))
        for name in element.attrib:
            if meant := _meant(name, ATTRIBUTES.get(element.tag, ())):
                text = f"attribute {name!r} of <{element.tag}> is unknown and left out: is {meant!r} meant?"
                warnings.append(warning(element, text))


def _meant(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that an unknown one resembles, or None."""
    if name in known:
        return None
    close = difflib.get_close_matches(name.lower(), list(known), 1, SIMILAR)
    return close[0] if close else None
