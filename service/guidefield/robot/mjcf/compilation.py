"""MuJoCo compiles an MJCF: defaults, includes, angles, orientations, frames and meshes are settled by it alone.

Names that it leaves out are made up, and no two of one kind are the same.
"""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.robot.urdf.xml import Element, fault, root_of

INSTALL_IT = "MuJoCo reads MJCF: install the extra `mujoco` (pip install 'guidefield[mujoco]')"

_ROOT = re.compile(r"(?:\ufeff|\s+|<\?.*?\?>|<!--.*?-->)*+<mujoco(?:include)?[\s/>]", re.DOTALL)
_FILE = re.compile(r"""\bfile[a-z]*\s*=\s*(?:"([^"]*)"|'([^']*)')""")
MOST_ELEMENTS = 20_000  # elements that an MJCF sent as text may have once MuJoCo has repeated what it repeats
MOST_FILE_ELEMENTS = 100_000  # the same of one in a file, and of each file that it includes
MOST_SAMPLES = 2**22  # pixels or heights that an element of it may make MuJoCo compute
MOST_PARAMETER = 200
"""Largest parameter of a built-in mesh; its facets grow with the square, and MuJoCo takes their hull."""
_REPEATED = ("replicate", "composite", "flexcomp")  # elements that stand for `count` times what is in them
_COMPUTED = {"texture": ("width", "height"), "hfield": ("nrow", "ncol")}
"""Attributes whose product is the size of what is computed."""
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
        if _tag(element) == "mesh" and max(_numbers(element, "params"), default=0.0) > MOST_PARAMETER:
            raise fault(element, f"'params' of <mesh> are too large: each is at most {MOST_PARAMETER}")
        sizes = _COMPUTED.get(_tag(element), ())
        if math.prod(_product(element, name) for name in sizes) > MOST_SAMPLES:
            named = " and ".join(repr(name) for name in sizes)
            raise fault(element, f"{named} of <{_tag(element)}> are too large: their product is at most {MOST_SAMPLES}")
    return str(etree.tostring(root, encoding="unicode")) if buffers else text


def _tag(element: Element) -> str:
    return str(etree.QName(element).localname)


def _product(element: Element, attribute: str) -> float:
    return math.prod(max(1.0, value) for value in _numbers(element, attribute))


def _numbers(element: Element, attribute: str) -> list[float]:
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
    """The model and MuJoCo's warnings, which it would write to a file in the working folder."""
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
        """The wanted name, with a number behind it where it is taken."""
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
    """Name of each body, `body<index>` where it has none."""
    given = named(model, "body")
    unique = UniqueNames(filter(None, given))
    return [name or unique.make(f"body{index}") for index, name in enumerate(given)]


def joint_names(model: Any) -> list[str]:
    """Name of each joint, `<body>_joint` where it has none."""
    given, bodies = named(model, "joint"), body_names(model)
    unique = UniqueNames(filter(None, given))
    return [name or unique.make(f"{bodies[model.jnt_bodyid[index]]}_joint") for index, name in enumerate(given)]
