"""Load and keep robots by name, file or what was sent, also from MJCF, and sum each up in a line for lists.

A robot is found again as long as no file that it was read from has changed (`_stamp`); lines of the catalog are kept on
disk by the state of their files and a hash of the sources of robot/. Names, and the order in which a reference is
resolved, are the public API's. A robot from MJCF is refused if its placements differ from MuJoCo's:
`PLACEMENT_TOLERANCE` has to be above rounding, and more `TRIALS` would find rarer faults.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin
from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.geometry.cache import Arrays, find_or_compute
from guidefield.memory import ROBOT_LINES, ROBOTS, BoundedMap
from guidefield.messages.faults import find_nearest
from guidefield.messages.replies import RobotSummary
from guidefield.messages.requests import ROBOT_DESCRIPTIONS, RobotReference, UrdfFile, UrdfText
from guidefield.messages.values import RootJoint
from guidefield.robot.library import NO_CARD, Entry, RobotCard, SentRobot, entries, find_description
from guidefield.robot.mesh_files.numbers import MeshFault
from guidefield.robot.mesh_files.reading import companions
from guidefield.robot.mjcf_compilation import (
    CompiledModel,
    body_names,
    compile_file,
    compile_text,
    import_mujoco,
    is_mjcf,
)
from guidefield.robot.mjcf_conversion import convert, root_is_fixed
from guidefield.robot.model.joints import RobotConfiguration
from guidefield.robot.model.loading import crosscheck, default_tip, load
from guidefield.robot.model.mimic_joints import find_unwrapped
from guidefield.robot.model.model import RobotModel, RobotSource, with_ball_joints
from guidefield.robot.model.neutral_names import capture_stderr, neutral_names
from guidefield.robot.model.pairs import random_configuration
from guidefield.robot.urdf import srdf
from guidefield.robot.urdf.elements import JOINT_DOF
from guidefield.robot.urdf.meshes import MeshResolver
from guidefield.robot.urdf.urdf_validation import check_urdf
from guidefield.robot.urdf.xml import ArgumentValue, Expanded, expand, is_xacro, read_xml

PLACEMENT_TOLERANCE = 1e-9
"""Placements that differ by more than this [m, or 1], for each metre from the world's origin, are not the same."""
TRIALS = 3  # random configurations at which placements are compared, beside the one at rest

_LINE = re.compile(r"^line \d+: ")
"""The line number at the beginning of sentences about a generated URDF, which nobody can look up."""

MOVABLE = ("revolute", "continuous", "prismatic", "planar", "floating")
ROOT_KINDS = {"planar": "planar", "free": "floating"}  # kind of the joint between the world and a root that moves
DEGREES = {**JOINT_DOF, "spherical": 3}  # degrees of freedom by kind of joint


def summarize(entry: Entry) -> RobotSummary:
    """Sum up joints, groups and tip of a robot of the catalog; or say what is wrong with it."""
    card, path = entry.card, entry.folder / entry.card.urdf
    described = read_xml(entry.folder / card.srdf) if card.srdf else None
    line = RobotSummary(name=entry.name, source=entry.source, family=entry.family)
    return _summarize(line, read_xml(path), described, card, MeshResolver.for_catalog(path))


def summarize_sent(robot: SentRobot, package_dirs: Iterable[Path]) -> RobotSummary:
    """Sum up a robot that a client stored; it may take meshes from those folders too."""
    line = RobotSummary(name=robot.name, source="stored", family=robot.name)
    card = msgspec.structs.replace(NO_CARD, root_joint=robot.root_joint)
    if not is_mjcf(robot.urdf):
        return _summarize(line, robot.urdf, robot.srdf, card, MeshResolver.for_wire(package_dirs, robot.meshes))
    try:
        compiled = compile_text(robot.urdf)
        converted = convert(compiled, robot.name, robot.root_joint)
    except RobotInvalid as error:
        return msgspec.structs.replace(line, problem=str(error))
    root = "fixed" if root_is_fixed(compiled.model, robot.root_joint) else robot.root_joint
    card = msgspec.structs.replace(card, root_joint=root, ball_joints=list(converted.balls))
    return _summarize(line, converted.urdf, robot.srdf, card, MeshResolver(given=converted.meshes))


def _summarize(
    line: RobotSummary, urdf: str, srdf_text: str | None, card: RobotCard, resolver: MeshResolver
) -> RobotSummary:
    try:
        facts = check_urdf(urdf, resolver)
        described = srdf.parse(srdf_text) if srdf_text else srdf.Srdf()
        with capture_stderr():
            names = neutral_names(facts.text)
            model = pin.buildModelFromXML(names.text)
            names.restore(model)
    except (RobotInvalid, ValueError) as error:
        return msgspec.structs.replace(line, problem=str(error))
    model = with_ball_joints(line.name, model, card.ball_joints)
    otherwise = {**dict.fromkeys(card.ball_joints, "spherical"), **dict.fromkeys(find_unwrapped(facts), "revolute")}
    kinds = Counter(
        otherwise.get(joint.name, joint.kind)
        for joint in facts.joints.values()
        if joint.kind in MOVABLE and joint.name not in facts.mimics
    )
    if card.root_joint != "fixed":
        kinds[ROOT_KINDS[card.root_joint]] += 1
    return msgspec.structs.replace(
        line,
        dof=sum(DEGREES[kind] * count for kind, count in kinds.items()),
        joint_kinds=dict(kinds),
        mimics=len(facts.mimics),
        groups=sorted({*described.groups, *(["default"] if card.group else [])}),
        tip=default_tip(model, described, card),
        problem=None if facts.collisions else "it has no collision geometry: kinematics alone are answered",
    )


def read_description(
    urdf: Path, srdf: Path | None, xacro_args: Mapping[str, ArgumentValue], resolver: MeshResolver
) -> tuple[Expanded, str | None]:
    """Read a robot's URDF, with the files and warnings of both, and SRDF; xacro files get the arguments that they have.

    Raises:
        RobotInvalid: if a file can't be expanded, or there are arguments and none is a xacro file.
    """
    if xacro_args and not is_xacro(urdf):
        raise RobotInvalid(
            f"{urdf.name} takes no xacro arguments: only files that end in .xacro are expanded", path=str(urdf)
        )
    text = _expand(urdf, xacro_args, resolver, strict=True)
    semantic = None if srdf is None else _expand(srdf, xacro_args, resolver, strict=False)
    if semantic is None:
        return text, None
    return Expanded(text.text, (*text.files, *semantic.files), (*text.warnings, *semantic.warnings)), semantic.text


def absolute(path: str) -> Path:
    """Return a request's path as an absolute one without links, ~ being a home folder; RobotInvalid if none."""
    try:
        return Path(path).expanduser().resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise RobotInvalid(f"{path!r} is no path: {error}", path=path) from None


def robot_name(urdf: Path) -> str:
    """Return the name of a robot in a file: the file's name without its endings."""
    return Path(urdf.stem).stem if is_xacro(urdf) else urdf.stem


def _expand(path: Path, args: Mapping[str, ArgumentValue], resolver: MeshResolver, *, strict: bool) -> Expanded:
    if not is_xacro(path):
        return Expanded(read_xml(path), (), ())
    expanded = expand(path, args, resolver.package_folder, strict=strict)
    if strict and "<link" not in expanded.text and "<joint" not in expanded.text:
        raise RobotInvalid(
            f"{path.name} expands to no link: it only defines what other files use; name the xacro file that calls its "
            "macros",
            path=str(path),
        )
    return expanded


_Stamp = tuple[int, int, int, int]  # when a file was written, its size, and which one it is


@dataclass(frozen=True)
class _Loaded:
    robot: RobotModel
    stamps: dict[str, _Stamp | None]

    @functools.cached_property
    def fingerprint(self) -> str:
        state = f"{sorted(self.stamps.items())}\0{self.robot.source.urdf_text}"
        return hashlib.sha256(state.encode(errors="surrogatepass")).hexdigest()


class Catalog:
    """Loads robots and keeps them; `package_dirs` are further folders of meshes for robots sent as text."""

    def __init__(self, package_dirs: Iterable[Path] = ()) -> None:
        self._package_dirs = tuple(package_dirs)
        self._loaded = BoundedMap[str, _Loaded](ROBOTS)
        self._lines = BoundedMap[str, RobotSummary](ROBOT_LINES)

    def names(self) -> list[str]:
        """Names that `load` knows."""
        return list(entries())

    def summaries(self) -> list[RobotSummary]:
        """Return a line about each name, in their order; those with a problem say it."""
        return list(self._own_lines)

    @functools.cached_property
    def _own_lines(self) -> list[RobotSummary]:
        return lines_of(entries().values())

    def line(self, sent: SentRobot) -> RobotSummary:
        """Return a line about a robot that was sent; it is kept, unless there is a problem, which may be mended."""
        line = self._lines.get(_key(sent))
        if line is None:
            line = summarize_sent(sent, self._package_dirs)
            if line.problem is None:
                self._lines.insert(_key(sent), line)
        return line

    def load(self, reference: RobotReference | SentRobot) -> RobotModel:
        """Return the robot that a request means; RobotInvalid if its name is unknown, or its description unusable."""
        reference = _resolve(reference)
        key = _key(reference)
        loaded = self._loaded.get(key)
        if loaded is None or any(_stamp(file) != was for file, was in loaded.stamps.items()):
            self._loaded.remove(key)
            robot = self._build(reference)
            stamps = {file: _stamp(file) for file in _files_of(reference, robot)}
            loaded = self._loaded.insert(key, _Loaded(robot, stamps))
        return loaded.robot

    def origin(self, reference: RobotReference | SentRobot) -> tuple[RobotReference | SentRobot, str]:
        """Return a loaded robot's origin, wherever a process stands, and a hash of its text and its files' state."""
        reference = _resolve(reference)
        loaded = self._loaded.get(_key(reference))
        assert loaded is not None, "it was loaded"
        if isinstance(reference, UrdfFile):
            srdf = reference.srdf_path and str(absolute(reference.srdf_path))
            folders = [str(absolute(folder)) for folder in reference.package_dirs]
            path = str(absolute(reference.path))
            reference = msgspec.structs.replace(reference, path=path, srdf_path=srdf, package_dirs=folders)
        return reference, loaded.fingerprint

    def _build(self, reference: RobotReference | SentRobot) -> RobotModel:
        if isinstance(reference, str):
            return self._from_catalog(reference)
        if isinstance(reference, SentRobot):
            if is_mjcf(reference.urdf):
                return load_mjcf(reference.name, compile_text(reference.urdf), reference.srdf, reference.root_joint)
            source = RobotSource(reference.urdf, None, reference.root_joint)
            resolver = MeshResolver.for_wire(self._package_dirs, reference.meshes)
            return crosscheck(load(reference.name, source, reference.srdf, NO_CARD, resolver))
        if isinstance(reference, UrdfText):
            if is_mjcf(reference.text):
                return load_mjcf("mjcf", compile_text(reference.text), reference.srdf, reference.root_joint)
            source = RobotSource(reference.text, None, reference.root_joint)
            resolver = MeshResolver.for_wire(self._package_dirs)
            return crosscheck(load("urdf", source, reference.srdf, NO_CARD, resolver))
        return _from_file(reference)

    def _from_catalog(self, name: str) -> RobotModel:
        entry = entries().get(name)
        if entry is None:
            variants = [e.name for e in entries().values() if e.family == name]
            hint = f"there are {', '.join(variants)}" if variants else "`guidefield robots` lists those there are"
            if name.lower().endswith((".urdf", ".xacro", ".xml")):
                hint = f'a file is named by {{"type": "urdf_file", "path": "{name[:64]}"}}'
            elif not variants and (near := find_nearest(name, self.names())):
                hint = f"did you mean {' or '.join(near)}? {hint}"
            raise RobotInvalid(
                f"there is no robot {name[:64]!r}; {hint}",
                robot=name[:64],
                available=variants or self.names(),
            )
        path = entry.folder / entry.card.urdf
        srdf = read_xml(entry.folder / entry.card.srdf) if entry.card.srdf else None
        source = RobotSource(read_xml(path), path, entry.card.root_joint)
        robot = load(name, source, srdf, entry.card, MeshResolver.for_catalog(path))
        return dataclasses.replace(robot, warnings=(), remarks=robot.warnings)


def _from_file(reference: UrdfFile) -> RobotModel:
    path = _find_file(reference.path, "URDF")
    srdf_path = _find_file(reference.srdf_path, "SRDF") if reference.srdf_path else None
    if is_mjcf(path.read_text(errors="replace")):
        semantics = None if srdf_path is None else read_xml(srdf_path)
        return load_mjcf(path.stem, compile_file(path), semantics, reference.root_joint)
    resolver = MeshResolver.for_file(path, map(absolute, reference.package_dirs))
    described, semantics = read_description(path, srdf_path, reference.xacro_args, resolver)
    source = RobotSource(described.text, path, reference.root_joint, described.files)
    try:
        robot = crosscheck(load(robot_name(path), source, semantics, NO_CARD, resolver))
    except RobotInvalid as error:
        if not is_xacro(path):
            raise
        raise RobotInvalid(f"{path.name}, expanded: {error.message}", **error.details) from None
    return dataclasses.replace(robot, warnings=(*described.warnings, *robot.warnings))


def _find_file(named: str, kind: str) -> Path:
    path = absolute(named)
    try:
        if path.is_file():
            path.open("rb").close()
            return path
        why = "it is a folder; name a file in it" if path.is_dir() else ""
    except OSError as error:
        raise RobotInvalid(f"the {kind} file {named[:200]!r} can't be opened: {error.strerror}", path=named) from None
    raise RobotInvalid(f"there is no {kind} file {named!r}{why and f': {why}'}", path=named)


def _resolve(reference: RobotReference | SentRobot) -> RobotReference | SentRobot:
    if isinstance(reference, str) and reference.startswith(ROBOT_DESCRIPTIONS):
        return find_description(reference)
    return reference


def _key(reference: RobotReference | SentRobot) -> str:
    if isinstance(reference, str):
        return f"catalog:{reference}"
    if isinstance(reference, SentRobot):
        return f"sent:{reference.name}:{reference.content}"
    if isinstance(reference, UrdfText):
        content = "\0".join((reference.text, reference.srdf or "", reference.root_joint))
        return f"text:{hashlib.sha256(content.encode(errors='surrogatepass')).hexdigest()}"
    arguments = sorted(reference.xacro_args.items())
    files = f"{reference.path}:{reference.srdf_path}:{reference.package_dirs}:{arguments}"
    return f"file:{Path.cwd()}:{files}:{reference.root_joint}"


def _files_of(reference: RobotReference | SentRobot, robot: RobotModel) -> list[str]:
    if not isinstance(reference, UrdfFile):
        return []
    meshes = [mesh.get("filename") for mesh in etree.fromstring(robot.source.urdf_text.encode()).iter("mesh")]
    files = [str(file) for file in robot.source.files]
    named = [
        reference.path,
        reference.srdf_path,
        *files,
        *meshes,
        *(one for mesh in meshes for one in _companions(Path(mesh))),
    ]
    return list({str(Path(name).expanduser().absolute()) for name in named if name})


def _companions(mesh: Path) -> list[str]:
    try:
        return [str(mesh.parent / name) for name in companions(mesh)]
    except MeshFault:  # of a visual, which is reported where it is drawn
        return []


def _stamp(file: str) -> _Stamp | None:
    try:
        found = os.stat(file)  # noqa: PTH116  # of each file, for each request: a Path takes half as long again
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino, found.st_dev


def lines_of(entries: Iterable[Entry]) -> list[RobotSummary]:
    """Return a line about each robot, in their order; from disk if they were made before of the same files."""
    known = list(entries)
    state = f"{_hash_sources()} {pin.__version__}"
    for entry in known:
        files = [entry.folder / name for name in (entry.card.urdf, entry.card.srdf) if name is not None]
        state += f"\0{entry} {[(file.stat().st_mtime_ns, file.stat().st_size) for file in files]}"

    def summarize_all() -> Arrays:
        return {"lines": np.frombuffer(msgspec.json.encode([summarize(entry) for entry in known]), np.uint8)}

    found = find_or_compute("robots", {"state": np.frombuffer(state.encode(), np.uint8)}, summarize_all)
    return msgspec.json.decode(found["lines"].tobytes(), type=list[RobotSummary])


@functools.cache
def _hash_sources() -> str:
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()


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
    card = msgspec.structs.replace(NO_CARD, ball_joints=list(converted.balls))
    try:
        robot = load(name, source, semantics, card, MeshResolver(given=converted.meshes))
    except RobotInvalid as error:
        raise RobotInvalid(f"MJCF: {_LINE.sub('', error.message)}", **error.details) from None
    check_placements(robot, compiled.model, converted.joints, converted.geoms)
    warnings = (_LINE.sub("", sentence) for sentence in robot.warnings)
    return dataclasses.replace(robot, warnings=(*converted.warnings, *warnings))


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
            _check_place(f"body {name!r}", placed.oMf[frames[name]], data.xpos[body], data.xmat[body])
        for shape, at in zip(robot.geometry.geometryObjects, shapes.oMg, strict=True):
            geom = behind[shape.name]
            _check_place(f"shape {shape.name!r}", at, data.geom_xpos[geom], data.geom_xmat[geom])


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


def _check_place(what: str, ours: Any, position: np.ndarray, rotation: np.ndarray) -> None:
    apart = max(np.abs(ours.translation - position).max(), np.abs(ours.rotation.ravel() - rotation).max())
    if not apart <= PLACEMENT_TOLERANCE * max(1.0, float(np.abs(position).max())):
        raise RobotInvalid(f"MJCF: {what} stands elsewhere than MuJoCo has it, by {apart:.3g}; please report this file")
