"""Compile an MJCF by MuJoCo, and write its bodies, joints and sites as links and joints of a URDF.

The package `mujoco` is an extra, imported on demand alone. Names that a file leaves out are made up, and no two of one
kind are the same. Limits bound what MuJoCo computes for text from clients.

A joint of MuJoCo turns or slides its body about a point of the body, several one after the other, from the placement at
its reference value. A joint of a URDF moves its child link about the link's own origin, from zero. So a link stands at
the anchor of each joint but the last one whose anchor is the body's origin, and the reference value is part of the
joint's <origin>: joint values are those of MuJoCo.
"""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.robot.urdf.xml import Element, fault, root_of

INSTALL_IT = "MuJoCo reads MJCF: install the extra `mujoco` (pip install 'guidefield[mujoco]')"

_ROOT = re.compile(r"(?:\ufeff|\s+|<\?.*?\?>|<!--.*?-->)*+<mujoco(?:include)?[\s/>]", re.DOTALL)
_FILE = re.compile(r"""\bfile[a-z]*\s*=\s*(?:"([^"]*)"|'([^']*)')""")
MOST_ELEMENTS = 20_000  # elements that an MJCF sent as text may have, repetitions expanded: docs/robots.md states it
MOST_FILE_ELEMENTS = 100_000  # the same of one in a file, and of each file that it includes
MOST_SAMPLES = 2**22  # pixels or heights that an element of it may make MuJoCo compute
MOST_PARAMETER = 200
"""Largest parameter of a built-in mesh; its facets grow with the square, and MuJoCo takes their hull."""
_REPEATED = ("replicate", "composite", "flexcomp")  # elements that stand for `count` times what is in them
_COMPUTED = {"texture": ("width", "height"), "hfield": ("nrow", "ncol")}
"""Attributes whose product is the number of pixels or heights that MuJoCo computes."""
_BUFFERS = ("size", "custom")  # sections of an MJCF that ask for memory and say nothing about a robot
_ALONE = threading.Lock()  # muJoCo has one handler of warnings for the process


@dataclass(frozen=True, eq=False)
class CompiledModel:
    """An MJCF as MuJoCo has compiled it: `mujoco.MjModel`, every file that was read, and MuJoCo's warnings."""

    model: Any
    files: tuple[Path, ...]
    warnings: tuple[str, ...]


def is_mjcf(text: str) -> bool:
    """Return True if the root element of a text is <mujoco>, or <mujocoinclude>."""
    return _ROOT.match(text) is not None


def compile_file(path: Path) -> CompiledModel:
    """Compile an MJCF file and all that it names; RobotInvalid without `mujoco`, or with MuJoCo's reason."""
    mujoco = import_mujoco()

    def load() -> tuple[Any, tuple[Path, ...]]:
        files = tuple(path.parent / file for file in mujoco.mju_getXMLDependencies(str(path)))
        for file in files:
            if file.is_file() and is_mjcf(text := file.read_text(errors="replace")):
                _drop_buffers(text, MOST_FILE_ELEMENTS)
        return mujoco.MjModel.from_xml_path(str(path)), files

    (model, files), warnings = _compile(path.name, load)
    return CompiledModel(model, files, warnings)


def compile_text(text: str) -> CompiledModel:
    """Compile an MJCF that names no file.

    Raises:
        RobotInvalid: if the package `mujoco` is missing, if the text names a file or represents more than a robot has,
            or if MuJoCo refuses it.
    """
    for double, single in _FILE.findall(text):
        file = (double or single)[:200]
        raise RobotInvalid(
            f"an MJCF that is sent as text must name no file, it names {file!r}; name the MJCF itself as a `urdf_file` "
            "on the machine that has its files",
            file=file,
        )
    mujoco = import_mujoco()
    bounded = _drop_buffers(text, MOST_ELEMENTS)
    model, warnings = _compile("MJCF", lambda: mujoco.MjModel.from_xml_string(bounded))
    return CompiledModel(model, (), warnings)


def _drop_buffers(text: str, most: int) -> str:
    """Return an MJCF without its buffers; RobotInvalid if it represents more than `most` elements, or larger pictures.

    A line of MJCF can stand for any number of bodies, which MuJoCo would make without asking.
    """
    root = root_of(text, "MJCF", [])
    buffers = [element for element in root.iterchildren(etree.Element) if _tag(element) in _BUFFERS]
    for element in buffers:
        root.remove(element)
    total, times = 0.0, {root: 1.0}
    for element in root.iter(etree.Element):
        above = element.getparent()
        within = 1.0 if above is None else times[above]
        times[element] = within * (_product(element, "count") if _tag(element) in _REPEATED else 1.0)
        total += times[element]
        if total > most:
            raise fault(element, f"the MJCF expands to more than {most} elements", limit=most)
        if _tag(element) == "mesh" and max(_read_numbers(element, "params"), default=0.0) > MOST_PARAMETER:
            raise fault(element, f"'params' of <mesh> are too large: each is at most {MOST_PARAMETER}")
        sizes = _COMPUTED.get(_tag(element), ())
        if math.prod(_product(element, name) for name in sizes) > MOST_SAMPLES:
            named = " and ".join(repr(name) for name in sizes)
            raise fault(element, f"{named} of <{_tag(element)}> are too large: their product is at most {MOST_SAMPLES}")
    return str(etree.tostring(root, encoding="unicode")) if buffers else text


def _tag(element: Element) -> str:
    return str(etree.QName(element).localname)


def _product(element: Element, attribute: str) -> float:
    return math.prod(max(1.0, value) for value in _read_numbers(element, attribute))


def _read_numbers(element: Element, attribute: str) -> list[float]:
    try:
        return [float(word) for word in element.get(attribute, "").split()]
    except ValueError:
        return []


def import_mujoco() -> Any:
    """Import the package `mujoco`; RobotInvalid if it isn't installed."""
    try:
        import mujoco  # type: ignore[import-untyped]
    except ImportError:
        raise RobotInvalid(INSTALL_IT) from None
    return mujoco


def _compile(name: str, load: Callable[[], Any]) -> tuple[Any, tuple[str, ...]]:
    """Return the model and MuJoCo's warnings, which it would write to a file in the working folder."""
    mujoco = import_mujoco()
    warnings: list[str] = []
    with _ALONE:
        before = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(warnings.append)
        try:
            model = load()
        except (ValueError, mujoco.FatalError) as error:
            raise RobotInvalid(f"MuJoCo can't compile {name}: {' '.join(str(error).split())}") from None
        finally:
            mujoco.set_mju_user_warning(before)
    return model, tuple(f"MuJoCo: {' '.join(text.split())}" for text in dict.fromkeys(warnings))


WORLD = "world"  # MuJoCo's name of its body 0, the root link of the URDF


class UniqueNames:
    """Gives out names, each once, and none of those that are taken."""

    def __init__(self, taken: Iterable[str]) -> None:
        self._taken = set(taken)

    def make(self, wanted: str) -> str:
        """Return the wanted name, with a number behind it where it is taken."""
        name, number = wanted, 2
        while name in self._taken:
            name, number = f"{wanted}_{number}", number + 1
        self._taken.add(name)
        return name


def named(model: Any, kind: str) -> list[str]:
    """Return the name of each element of a kind, "" where it has none.

    MuJoCo's words for kinds are `body`, `joint`, `geom`, `site`, `key`, `equality`, `tendon`, `flex`, `mesh`.
    """
    mujoco = import_mujoco()
    counts = {"body": "nbody", "joint": "njnt", "equality": "neq"}
    object_type = getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
    count = getattr(model, counts.get(kind, f"n{kind}"))
    return [mujoco.mj_id2name(model, object_type, index) or "" for index in range(count)]


def body_names(model: Any) -> list[str]:
    """Return the name of each body, `body<index>` where it has none."""
    given = named(model, "body")
    unique = UniqueNames(filter(None, given))
    return [name or unique.make(f"body{index}") for index, name in enumerate(given)]


def joint_names(model: Any) -> list[str]:
    """Return the name of each joint, `<body>_joint` where it has none."""
    given, bodies = named(model, "joint"), body_names(model)
    unique = UniqueNames(filter(None, given))
    return [name or unique.make(f"{bodies[model.jnt_bodyid[index]]}_joint") for index, name in enumerate(given)]


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
        mimic, source = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
        offset, slope, *curve = (float(number) for number in model.eq_data[index, :5])
        constraint = f"{what} of joint {joints[mimic]!r}"
        if mimic in laws.mimics or mimic in laws.constants:
            warnings.append(f"{constraint} isn't kept: the joint has another one")
        elif source < 0 or (slope == 0.0 and not any(curve)):
            laws.constants[mimic] = reference[mimic] + offset
        elif any(curve):
            warnings.append(
                f"{constraint} isn't kept: it follows {joints[source]!r} by a curve, and moves by itself here"
            )
        elif _follows(laws, source, mimic):
            warnings.append(f"{constraint} isn't kept: {joints[source]!r} follows it already")
        else:
            shift = reference[mimic] + offset - slope * reference[source]
            laws.mimics[mimic] = (source, slope, shift)
    return laws


def _follows(laws: JointLaws, joint: int, source: int) -> bool:
    while joint != source and joint in laws.mimics:
        joint = laws.mimics[joint][0]
    return joint == source


def tendon_warnings(model: Any) -> list[str]:
    """Return a sentence about the tendons, if there are any: joints that they couple or limit are free here."""
    if not model.ntendon:
        return []
    names = [name or f"number {index}" for index, name in enumerate(named(model, "tendon"))]
    limited = int(model.tendon_limited.sum())
    limits = f", nor the length limits of {limited} of them" if limited else ""
    some = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
    return [f"what tendons couple isn't kept{limits}: {some}"]


ENDLESS = 1e6  # range of a sliding joint without one [m], which a URDF has to name: beyond `FURTHEST` it is narrowed


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
        """Add a link without shape for a site; `<name>_site` where a body has the name."""
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
            etree.SubElement(element, "axis", xyz=_write_numbers(axis))
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
    """Return the pinocchio.SE3 of a position (3,) and a quaternion w, x, y, z (4,), as MuJoCo has them."""
    w, x, y, z = quaternion.tolist()
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), np.array(position))


def add_origin(element: Element, origin: Any) -> None:
    """Give an element an <origin>; a quaternion keeps all digits where Euler angles lose half of them."""
    quaternion = pin.Quaternion(origin.rotation).coeffs()
    etree.SubElement(element, "origin", xyz=_write_numbers(origin.translation), quat_xyzw=_write_numbers(quaternion))


def _write_numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
