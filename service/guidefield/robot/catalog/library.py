"""Find the robots that come with guidefield or with robot_descriptions, by name, and load robots from MJCF.

Names are the public API's. Downloads run in a process of their own, bounded in time. A robot from MJCF is refused if
its placements differ from MuJoCo's.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib.resources
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin

from guidefield.errors import RobotInvalid
from guidefield.memo import memoized_by_value
from guidefield.messages.faults import find_nearest
from guidefield.messages.requests import ROBOT_DESCRIPTIONS, UrdfFile
from guidefield.messages.values import RootJoint
from guidefield.robot.mjcf.compilation import CompiledModel, body_names, import_mujoco
from guidefield.robot.mjcf.conversion import convert, root_is_fixed
from guidefield.robot.model import model as cards
from guidefield.robot.model.loading import load
from guidefield.robot.model.model import RobotCard, RobotModel, RobotSource
from guidefield.robot.model.pairs import random_configuration
from guidefield.robot.model.spaces import RobotConfiguration
from guidefield.robot.urdf import srdf
from guidefield.robot.urdf.meshes import CATALOG_PACKAGE, MeshResolver, catalog_share


@dataclass(frozen=True)
class SentRobot:
    """A robot as a client sent it."""

    name: str  # the client's name of it
    content: str  # hash of all that was sent; the same content is the same robot
    urdf: str  # text of its URDF
    srdf: str | None  # text of its SRDF
    meshes: Mapping[str, Path]  # files on disk by the URIs that the URDF has for them
    root_joint: RootJoint  # how it stands in the world


OURS = "guidefield"
_PACKAGE = "guidefield.robots"
_CARD = ".card.json"


@dataclass(frozen=True)
class Entry:
    """One name of the catalog."""

    name: str
    card: RobotCard  # its files and defaults
    folder: Path  # folder of the card's paths
    source: str  # the package that it comes from
    family: str  # short name of the folder that its URDF is in; several URDFs of one are variants of a robot


@functools.cache
def entries() -> dict[str, Entry]:
    """Return every name, in alphabetical order: found URDFs, and our cards, which take precedence."""
    return dict(sorted({**_find_entries(), **_ours()}.items()))


def _robots() -> Path:
    return catalog_share() / CATALOG_PACKAGE / "robots"


def _find_entries() -> dict[str, Entry]:
    """Find the URDFs of example-robot-data by the names of their files, or of packages where files share a name."""
    robots = _robots()
    urdfs = sorted(robots.glob("*/*/*.urdf"))
    stems = [path.stem for path in urdfs]
    found: dict[str, Entry] = {}
    for path in urdfs:
        family = _family(path.relative_to(robots))
        name = path.stem.removesuffix("_robot").lower()
        if stems.count(path.stem) > 1:
            name = family
        elif name in found:
            name = path.stem.lower()
        srdf = _srdf_of(path, sorted((robots / path.parts[-3] / "srdf").glob("*.srdf")))
        card = RobotCard(str(path.relative_to(robots)), str(srdf.relative_to(robots)) if srdf else None)
        found[name] = Entry(name, card, robots, CATALOG_PACKAGE, family)
    return found


def _ours() -> dict[str, Entry]:
    robots, ours = _robots(), importlib.resources.files(_PACKAGE)
    found = {}
    for resource in ours.iterdir():
        if resource.name.endswith(_CARD):
            name, card = resource.name.removesuffix(_CARD), cards.decode(resource.read_bytes())
            if (robots / card.urdf).is_file():
                found[name] = Entry(name, card, robots, CATALOG_PACKAGE, _family(Path(card.urdf)))
            else:
                found[name] = Entry(name, card, Path(str(ours)), OURS, name)
    return found


def _family(urdf: Path) -> str:
    return urdf.parts[0].removesuffix("_description").removesuffix("_data").lower()


def _srdf_of(urdf: Path, srdfs: Iterable[Path]) -> Path | None:
    """Find the SRDF of a package named most like a URDF: `arm` and `arm_manipulation` describe `arm_with_hand` too."""
    names = {srdf: srdf.stem.removesuffix("_manipulation") for srdf in srdfs}
    fitting = [srdf for srdf, name in names.items() if f"{urdf.stem}_".startswith(f"{name}_")]
    return max(fitting, key=lambda srdf: (len(names[srdf]), -len(srdf.stem)), default=None)


MAX_DOWNLOAD_SECONDS = 300.0  # time that the loader may take: the first time it downloads a Git repository [s]
STALLED_SECONDS = 20  # git gives up where less than 1 kB/s has come for this time [s]

_LOADER = """
import importlib, json, sys
try:
    import robot_descriptions
except ImportError as error:
    print(json.dumps({"missing": str(error)}))
    sys.exit()
name = sys.argv[1]
if name not in robot_descriptions.DESCRIPTIONS:
    print(json.dumps({"names": sorted(robot_descriptions.DESCRIPTIONS)}))
    sys.exit()
module = importlib.import_module(f"robot_descriptions.{name}")
wanted = "URDF_PATH XACRO_PATH XACRO_ARGS MJCF_PATH SRDF_PATH PACKAGE_PATH REPOSITORY_PATH".split()
print("\\n" + json.dumps({key: getattr(module, key) for key in wanted if hasattr(module, key)}))
"""
"""Runs in a process of its own, as importing a description may download it without end."""


def is_description(name: str) -> bool:
    """Tell whether a robot's name is one of robot_descriptions."""
    return name.startswith(ROBOT_DESCRIPTIONS)


@memoized_by_value(64)
def find_description(name: str) -> UrdfFile:
    """Return the files of a robot, named with the prefix, downloaded if they aren't in the cache of robot_descriptions.

    Raises:
        RobotInvalid: if the package or the name is unknown, or the files can't be downloaded.
    """
    own = name.removeprefix(ROBOT_DESCRIPTIONS)
    if not re.fullmatch(r"[A-Za-z]\w{0,99}", own):
        raise RobotInvalid(f"{own[:64]!r} is no name of robot_descriptions", robot=name[:99])
    found = _load(own)
    if "missing" in found:
        raise RobotInvalid(
            f"{name!r} needs the package robot_descriptions: pip install 'guidefield[robot_descriptions]' "
            f"({found['missing']})",
            robot=name,
        )
    if "names" in found:
        close = find_nearest(own, found["names"]) or [one for one in found["names"] if one.startswith(f"{own}_")]
        hint = f"; did you mean {' or '.join(close)}?" if close else ""
        raise RobotInvalid(f"robot_descriptions has no {own!r}{hint}", robot=name, available=found["names"])
    path = next((found[key] for key in ("URDF_PATH", "XACRO_PATH", "MJCF_PATH") if key in found), None)
    if path is None:
        raise RobotInvalid(f"{name!r} has neither URDF nor MJCF", robot=name)
    folders = [str(Path(found[key]).parent) for key in ("PACKAGE_PATH", "REPOSITORY_PATH") if key in found]
    arguments = found.get("XACRO_ARGS", {}) if path == found.get("XACRO_PATH") else {}
    return UrdfFile(path, found.get("SRDF_PATH"), list(dict.fromkeys(folders)), xacro_args=arguments)


def _load(own: str) -> dict[str, Any]:
    """Import a description in a process of its own; RobotInvalid with its last line if that fails."""
    environment = {
        **os.environ,
        "GIT_TERMINAL_PROMPT": "0",
        "GIT_HTTP_LOW_SPEED_LIMIT": "1000",
        "GIT_HTTP_LOW_SPEED_TIME": str(STALLED_SECONDS),
    }
    with subprocess.Popen(  # noqa: S603 - our interpreter, and a name that was checked
        [sys.executable, "-c", _LOADER, own],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
        start_new_session=True,
    ) as process:
        try:
            said, complaint = process.communicate(timeout=MAX_DOWNLOAD_SECONDS)
        except subprocess.TimeoutExpired:
            raise _not_delivered(own, f"it took more than {MAX_DOWNLOAD_SECONDS:g} s") from None
        finally:
            if process.poll() is None:  # it and git
                os.killpg(process.pid, signal.SIGKILL)
    if process.returncode:
        lines = [line.strip() for line in complaint.decode(errors="replace").splitlines() if line.strip()]
        causes = [line for line in lines if "fatal:" in line] or lines[-1:]
        raise _not_delivered(own, causes[-1] if causes else f"its loader ended with {process.returncode}")
    found: dict[str, Any] = json.loads(said.decode().splitlines()[-1])
    return found


def _not_delivered(own: str, reason: str) -> RobotInvalid:
    return RobotInvalid(
        f"robot_descriptions could not load {own!r}: {reason}; it downloads from Git what isn't in its cache: run "
        f"`python -m robot_descriptions pull {own}` where there is a network, or copy its cache folder",
        robot=f"{ROBOT_DESCRIPTIONS}{own}",
    )


_LINE = re.compile(r"^line \d+: ")
"""The line number at the beginning of sentences about a generated URDF, which nobody can look up."""


def load_mjcf(name: str, compiled: CompiledModel, srdf_text: str | None, root_joint: RootJoint) -> RobotModel:
    """Load a compiled MJCF; states and pairs of an SRDF come before those of the MJCF.

    Raises:
        RobotInvalid: if it can't be used, with the element at fault.
    """
    converted = convert(compiled, name, root_joint)
    semantics = converted.semantics
    if srdf_text:
        given = srdf.parse(srdf_text)
        states, disabled = (*given.states, *semantics.states), {**semantics.disabled, **given.disabled}
        semantics = dataclasses.replace(given, states=states, disabled=disabled, said_by="MJCF")
    root = "fixed" if root_is_fixed(compiled.model, root_joint) else root_joint
    source = RobotSource(converted.urdf, None, root, compiled.files)
    card = msgspec.structs.replace(cards.EMPTY, ball_joints=list(converted.balls))
    try:
        robot = load(name, source, semantics, card, MeshResolver(given=converted.meshes))
    except RobotInvalid as error:
        raise RobotInvalid(f"MJCF: {_LINE.sub('', error.message)}", **error.details) from None
    check_placements(robot, compiled.model, converted.joints, converted.geoms)
    warnings = (_LINE.sub("", sentence) for sentence in robot.warnings)
    return dataclasses.replace(robot, warnings=(*converted.warnings, *warnings))


PLACEMENT_TOLERANCE = 1e-9
"""Placements that differ by more than this [m, or 1], for each metre from the world's origin, are not the same."""
TRIALS = 3  # random configurations at which placements are compared, beside the one at rest


def check_placements(
    robot: RobotModel, model: Any, joints: Mapping[int, str], geoms: Mapping[str, Sequence[int]]
) -> None:
    """Compare the placements of bodies and collision shapes with MuJoCo's.

    Args:
        geoms: MuJoCo's indices of the geoms behind each link's <collision>, in their order.

    Raises:
        RobotInvalid: if a body or shape stands elsewhere by more than `PLACEMENT_TOLERANCE`; names it.
    """
    mujoco, rng = import_mujoco(), np.random.default_rng(0)
    model.geom_sameframe[:] = 0  # else MuJoCo takes a geom within 1e-6 of its body's inertia for being there
    data, placed, shapes = mujoco.MjData(model), robot.model.createData(), robot.geometry.createData()
    named = {name: index for index, name in enumerate(body_names(model))}
    frames = {name: robot.model.getFrameId(name, pin.FrameType.BODY) for name in named}
    behind = {f"{link}_{number}": geom for link, some in geoms.items() for number, geom in enumerate(some)}
    drawn = (random_configuration(robot.model, robot.joints, rng, robot.size) for _ in range(TRIALS))
    for q in (robot.rest, *drawn):
        data.qpos[:] = mujoco_configuration(robot, model, joints, q)
        mujoco.mj_kinematics(model, data)
        pin.framesForwardKinematics(robot.model, placed, q)
        pin.updateGeometryPlacements(robot.model, placed, robot.geometry, shapes, q)
        for name, body in named.items():
            _compare(f"body {name!r}", placed.oMf[frames[name]], data.xpos[body], data.xmat[body])
        for shape, at in zip(robot.geometry.geometryObjects, shapes.oMg, strict=True):
            geom = behind[shape.name]
            _compare(f"shape {shape.name!r}", at, data.geom_xpos[geom], data.geom_xmat[geom])


def mujoco_configuration(robot: RobotModel, model: Any, joints: Mapping[int, str], q: RobotConfiguration) -> np.ndarray:
    """Return MuJoCo's configuration, shape (nq,), at one of ours (robot.model.nq,); other joints at reference."""
    theirs = np.array(model.qpos0)
    for index, name in joints.items():
        joint = robot.joint(name)
        assert joint is not None, "joints of an MJCF keep their names"
        values, address = q[joint.idx_q : joint.idx_q + joint.nq], int(model.jnt_qposadr[index])
        if joint.nq == 2:
            theirs[address] = np.arctan2(values[1], values[0])
        elif joint.nq == 1:
            theirs[address] = values[0]
        else:  # a quaternion at the end: w comes first there
            theirs[address : address + joint.nq] = [*values[:-4], values[-1], *values[-4:-1]]
    return theirs


def _compare(what: str, ours: Any, position: np.ndarray, rotation: np.ndarray) -> None:
    apart = max(np.abs(ours.translation - position).max(), np.abs(ours.rotation.ravel() - rotation).max())
    if not apart <= PLACEMENT_TOLERANCE * max(1.0, float(np.abs(position).max())):
        raise RobotInvalid(f"MJCF: {what} stands elsewhere than MuJoCo has it, by {apart:.3g}; please report this file")
