"""Bodies, joints and sites of a compiled MJCF as links and joints of a URDF.

A joint of MuJoCo turns or slides its body about a point of the body, several one after the other, from the placement at
its reference value. A joint of a URDF moves its child link about the link's own origin, from zero. So a link stands at
the anchor of each joint but the last one whose anchor is the body's origin, and the reference value is part of the
joint's <origin>: joint values are those of MuJoCo.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.robot.mjcf.compilation import UniqueNames, body_names, import_mujoco, joint_names, named
from guidefield.robot.urdf.xml import Element


@dataclass(frozen=True)
class JointLaws:
    """Equality constraints by joint: its source joint, multiplier and offset; or the one value that it is held at."""

    mimics: dict[int, tuple[int, float, float]] = field(default_factory=dict)
    constants: dict[int, float] = field(default_factory=dict)


def joint_laws(model: Any, warnings: list[str]) -> JointLaws:
    """Read the linear equalities of joints, y - y0 = a0 + a1 (x - x0); y0 and x0 are the joints' reference values.

    The warnings get a sentence for each active constraint that isn't kept: those of bodies, sites, tendons and flexes,
    of joints by a curve, and a second one of the same joint, or one that would close a circle.
    """
    mujoco = import_mujoco()
    laws, joints = JointLaws(), joint_names(model)
    reference = [float(model.qpos0[address]) for address in model.jnt_qposadr]
    names = named(model, "equality")
    for index in range(model.neq):
        if not model.eq_active0[index]:
            continue
        kind = mujoco.mjtEq(int(model.eq_type[index])).name.removeprefix("mjEQ_").lower()
        what = f"<equality> {kind}" + (f" {names[index]!r}" if names[index] else "")
        if kind != "joint":
            warnings.append(f"{what} isn't kept: what it closes or couples moves by itself")
            continue
        follower, source = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        offset, slope, *curve = (float(number) for number in model.eq_data[index, :5])
        told = f"{what} of joint {joints[follower]!r}"
        if follower in laws.mimics or follower in laws.constants:
            warnings.append(f"{told} isn't kept: the joint has another one")
        elif source < 0 or (slope == 0.0 and not any(curve)):
            laws.constants[follower] = reference[follower] + offset
        elif any(curve):
            warnings.append(f"{told} isn't kept: it follows {joints[source]!r} by a curve, and moves by itself here")
        elif _follows(laws, source, follower):
            warnings.append(f"{told} isn't kept: {joints[source]!r} follows it already")
        else:
            shift = reference[follower] + offset - slope * reference[source]
            laws.mimics[follower] = (source, slope, shift)
    return laws


def _follows(laws: JointLaws, joint: int, source: int) -> bool:
    while joint != source and joint in laws.mimics:
        joint = laws.mimics[joint][0]
    return joint == source


def tendon_warnings(model: Any) -> list[str]:
    """A sentence about the tendons, if there are any: what they couple or limit moves by itself here."""
    if not model.ntendon:
        return []
    names = [name or f"number {index}" for index, name in enumerate(named(model, "tendon"))]
    limited = int(model.tendon_limited.sum())
    limits = f", nor the length limits of {limited} of them" if limited else ""
    some = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return [f"what tendons couple isn't kept{limits}: {some}"]


ENDLESS = 1e6  # range of a sliding joint without one [m]: a URDF has to name one, and the loader narrows it


@dataclass(frozen=True, eq=False)
class KinematicTree:
    """The <robot> of a compiled MJCF, without shapes, and the <link> of each body."""

    robot: Element
    links: tuple[Element, ...]
    joints: dict[int, str]  # name of each joint that moves, by MuJoCo's index
    balls: tuple[str, ...]  # names of ball joints; a URDF calls them floating


class _Tree:
    """Writes links and joints; without `free`, bodies with free joints stand where the file has them."""

    def __init__(self, model: Any, laws: JointLaws, free: bool, name: str) -> None:
        self._model, self._laws, self._free = model, laws, free
        self._kinds = import_mujoco().mjtJoint
        self._names = joint_names(model)
        self._unique_links, self._unique_joints = UniqueNames(body_names(model)), UniqueNames(self._names)
        self.robot = etree.Element("robot", name=name, version="1.1")
        self.links = [self._link(body) for body in body_names(model)]
        self.joints: dict[int, str] = {}
        self.balls: list[str] = []

    def add_body(self, body: int) -> None:
        model = self._model
        parent, link = self.links[model.body_parentid[body]], self.links[body]
        offset = placement(model.body_pos[body], model.body_quat[body])
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        for joint in joints:
            anchor = pin.SE3(np.eye(3), self._anchor(joint))
            last = joint == joints[-1] and not np.any(anchor.translation)
            child = link if last else self._link(self._unique_links.make(f"{link.get('name')}_{self._names[joint]}"))
            self._joint(joint, parent, child, offset * anchor)
            parent, offset = child, anchor.inverse()
        if parent is not link:
            self._fix(parent, link, offset)

    def add_site(self, site: int, name: str) -> None:
        """A link without shape for a site; `<name>_site` where a body has the name."""
        body = self.links[self._model.site_bodyid[site]]
        taken = name != self._unique_links.make(name)
        link = self._link(self._unique_links.make(f"{name}_site") if taken else name)
        self._fix(body, link, placement(self._model.site_pos[site], self._model.site_quat[site]))

    def _anchor(self, joint: int) -> np.ndarray:
        turns = int(self._model.jnt_type[joint]) in (self._kinds.mjJNT_HINGE, self._kinds.mjJNT_BALL)
        return np.array(self._model.jnt_pos[joint]) if turns else np.zeros(3)

    def _link(self, name: str) -> Element:
        return etree.SubElement(self.robot, "link", name=name)

    def _fix(self, parent: Element, child: Element, origin: Any) -> None:
        self._element(self._unique_joints.make(f"{child.get('name')}_fixed"), "fixed", parent, child, origin)

    def _joint(self, joint: int, parent: Element, child: Element, origin: Any) -> None:
        model, kinds, name = self._model, self._kinds, self._names[joint]
        kind = kinds(int(model.jnt_type[joint]))
        limited, (lower, upper) = bool(model.jnt_limited[joint]), model.jnt_range[joint].tolist()
        if kind == kinds.mjJNT_FREE:
            if not self._free:
                self._fix(parent, child, origin)
                return
            self._element(name, "floating", parent, child, pin.SE3.Identity())
        elif kind == kinds.mjJNT_BALL:
            if limited:
                raise RobotInvalid(
                    f"MJCF: ball joint {name!r} has a range of {upper:g} rad, which can't be planned within; "
                    "take its 'range' out, or set limited=\"false\"",
                    joint=name,
                )
            self._element(name, "floating", parent, child, origin)
            self.balls.append(name)
        else:
            axis, turns = np.array(model.jnt_axis[joint]), kind == kinds.mjJNT_HINGE
            reference = float(model.qpos0[model.jnt_qposadr[joint]])
            back = pin.AngleAxis(-reference, axis).matrix() if turns else np.eye(3)
            shift = np.zeros(3) if turns else -reference * axis
            if joint in self._laws.constants:
                limited, lower = True, self._laws.constants[joint]
                upper = lower
            word = "prismatic" if not turns else "revolute" if limited else "continuous"
            element = self._element(name, word, parent, child, origin * pin.SE3(back, shift))
            etree.SubElement(element, "axis", xyz=_numbers(axis))
            if not turns and not limited:
                lower, upper = -ENDLESS, ENDLESS
            if word != "continuous":
                limits = {"lower": repr(lower), "upper": repr(upper), "velocity": "0", "effort": "0"}
                etree.SubElement(element, "limit", limits)
            if joint in self._laws.mimics:
                source, multiplier, shifted = self._laws.mimics[joint]
                law = {"joint": self._names[source], "multiplier": repr(multiplier), "offset": repr(shifted)}
                etree.SubElement(element, "mimic", law)
        self.joints[joint] = name

    def _element(self, name: str, kind: str, parent: Element, child: Element, origin: Any) -> Element:
        element = etree.SubElement(self.robot, "joint", name=name, type=kind)
        add_origin(element, origin)
        etree.SubElement(element, "parent", link=parent.get("name"))
        etree.SubElement(element, "child", link=child.get("name"))
        return element


def kinematic_tree(model: Any, laws: JointLaws, free: bool, name: str) -> KinematicTree:
    """Write bodies and named sites of a compiled MJCF as links below the link `world`, and its joints.

    Without `free`, bodies with free joints stand where the file has them. RobotInvalid if a ball joint has a range.
    """
    tree = _Tree(model, laws, free, name)
    for body in range(1, model.nbody):
        tree.add_body(body)
    for site, given in enumerate(named(model, "site")):
        if given:
            tree.add_site(site, given)
    return KinematicTree(tree.robot, tuple(tree.links), tree.joints, tuple(tree.balls))


def placement(position: np.ndarray, quaternion: np.ndarray) -> Any:
    """`pinocchio.SE3` of a position, shape (3,), and a quaternion w, x, y, z, shape (4,), as MuJoCo has them."""
    w, x, y, z = quaternion.tolist()
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), np.array(position))


def add_origin(element: Element, origin: Any) -> None:
    """Give an element an <origin>; a quaternion keeps all digits where Euler angles lose half of them."""
    quaternion = pin.Quaternion(origin.rotation).coeffs()
    etree.SubElement(element, "origin", xyz=_numbers(origin.translation), quat_xyzw=_numbers(quaternion))


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
