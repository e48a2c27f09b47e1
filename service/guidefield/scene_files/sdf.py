"""Read SDF worlds and models: the shapes of all <collision>, where named frames, nested models and includes have them.

Frames are those of SDFormat 1.7 and later: a pose is relative to what holds it, or to the frame in its `relative_to`.
Obstacles' names, `model::link::collision`, are in scenes that users keep.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from lxml import etree

from guidefield.errors import RobotInvalid, SceneInvalid
from guidefield.geometry.surfaces import se3
from guidefield.messages.faults import list_choices
from guidefield.messages.scene import Box, Capsule, Cylinder, HalfSpace, Mesh, Sphere
from guidefield.robot.mesh_files.kinds import MESH_SUFFIXES
from guidefield.robot.mesh_files.numbers import MeshFault
from guidefield.robot.mesh_files.reading import read_mesh, read_objects
from guidefield.robot.urdf.meshes import MeshResolver
from guidefield.robot.urdf.nearby_files import enclosing_folders
from guidefield.robot.urdf.xml import Element, fault, name_of, read_xml, root_of, warning
from guidefield.scene_files.builder import Kind, SceneBuilder, cone, ellipsoid, located

SUFFIXES = (".sdf", ".world")
ROOTS = ("sdf", "gazebo")  # names of the root element; the second one is that of Gazebo's first files
MAX_INCLUDES = 10_000  # a file with more, those of included files counted, is refused
GAZEBO_MODELS = {
    "model://sun": ("it is a light", "<model name='sun'/>"),
    "model://ground_plane": (
        "it is the plane z = 0",
        "<model name='ground_plane'><link name='link'><collision name='collision'><geometry><plane/></geometry>"
        "</collision></link></model>",
    ),
}
"""Models that come with Gazebo and that most worlds include: a phrase for the warning, and the model itself as SDF."""
MAX_DEPTH = 32  # models nested or included deeper are refused; some hundreds would exhaust Python's stack
OWN = ("", "__model__", "__root__", "world")  # names of the frame of a world or model itself; of a model the first two


@dataclass
class _Scope:
    """The frames of a world or model."""

    element: Element
    file: Path  # the file that it is in, for its meshes
    # by name: the frame that it is relative to, and its placement there
    frames: dict[str, tuple[str, Any]] = field(default_factory=dict)
    # name of each nested model, the frame that it is relative to, its placement there, and its own frames
    models: list[tuple[str, str, Any, _Scope]] = field(default_factory=list)
    _known: dict[str, Any] = field(default_factory=dict)

    def place(self, name: str, element: Element) -> Any:
        """Return the placement of a frame, link, joint or model in the scope's own; `model::frame` is a nested one's.

        Raises:
            RobotInvalid: if there is no such frame, or it is relative to itself.
        """
        own = OWN if self.element.tag == "world" else OWN[:2]
        chain: dict[str, Any] = {}
        while name not in self._known and name not in own:
            if name in chain:
                raise fault(element, f"the frames are relative to each other: {' to '.join(chain)} to {name}")
            head, separator, tail = name.partition("::")
            model = next((model for one, *_, model in self.models if one == head), None)
            if name in self.frames:
                relative_to, chain[name] = self.frames[name]
            elif separator and model is not None:
                relative_to, chain[name] = head, model.place(tail, element)
            else:
                known = list_choices([*self.frames, *own[1:]])
                raise fault(element, f"there is no frame {name!r}; there are {known}", frame=name)
            name = relative_to
        placement = self._known.get(name, pin.SE3.Identity())
        for one, local in reversed(chain.items()):
            placement = self._known[one] = placement * local
        return placement


class SdfReader:
    """Reads SDF files and what they include into a builder; obstacles are named `model::link::collision`."""

    def __init__(self, builder: SceneBuilder, package_dirs: Sequence[Path]) -> None:
        self._builder, self._package_dirs = builder, package_dirs
        self._roots: dict[Path, Element] = {}
        self._resolvers: dict[Path, MeshResolver] = {}
        self._includes, self._top = 0, Path()

    def read(self, path: Path, root: Element) -> None:
        """Read the world of a file, or its models, from its root element; raises RobotInvalid or SceneInvalid."""
        worlds = root.findall("world")
        if len(worlds) > 1:
            names = ", ".join(repr(world.get("name", "")) for world in worlds)
            raise fault(worlds[1], f"the file has the worlds {names}; one is read: leave only that in it")
        whole = worlds[0] if worlds else root
        if whole.find("state") is not None:
            said = "<state> is left out, as Gazebo Sim does: models stand where their own <pose> is"
            self._builder.warnings.append(warning(whole.find("state"), said))
        whole.tag, self._top = "world", path
        scope = self._scope(whole, path, (path.resolve(),), 0)
        self._add(scope, "", pin.SE3.Identity(), ())
        for resolver in self._resolvers.values():
            self._builder.warnings += resolver.warnings()

    def _scope(self, element: Element, file: Path, stack: tuple[Path, ...], depth: int) -> _Scope:
        """Read the frames of a world or model, and of the models in it."""
        if depth > MAX_DEPTH:
            raise fault(element, f"models are nested more than {MAX_DEPTH} deep")
        scope = _Scope(element, file)
        for child in element:
            match child.tag:
                case "link":
                    scope.frames[name_of(child)] = _pose(child)
                case "frame":
                    scope.frames[name_of(child)] = _pose(child, child.get("attached_to", ""))
                case "model":
                    nested = self._scope(child, file, stack, depth + 1)
                    self._nest(scope, name_of(child), nested, child, child.get("placement_frame", ""))
                case "include":
                    self._include(scope, child, stack, depth)
                case "population":
                    raise fault(child, "a <population> places its models by chance; write them out as models")
        for joint in element.findall("joint"):
            scope.frames.setdefault(name_of(joint), _pose(joint, _text(joint, "child")))
        return scope

    def _nest(self, scope: _Scope, name: str, nested: _Scope, posed: Element, placement_frame: str) -> None:
        """Put a model into a scope, so that its placement frame is at a pose."""
        relative_to, placement = _pose(posed)
        scope.frames[name] = relative_to, placement * nested.place(placement_frame, posed).inverse()
        scope.models.append((name, *scope.frames[name], nested))

    def _include(self, scope: _Scope, include: Element, stack: tuple[Path, ...], depth: int) -> None:
        self._includes += 1
        if self._includes > MAX_INCLUDES:
            raise fault(include, f"the file has more than {MAX_INCLUDES} includes, those of included files counted")
        if include.get("merge", "false").strip() in ("true", "1"):
            raise fault(include, "<include merge> is not read: leave 'merge' out, names then begin with the model's")
        uri = _text(include, "uri")
        if self._builder.leaves_out(include.findtext("name", uri.rstrip("/").rpartition("/")[2]).strip()):
            return
        try:
            file = self._find(uri, scope.file, include)
        except RobotInvalid as error:
            if uri not in GAZEBO_MODELS:
                message = f"{error.message}; or leave the model out: --without"
                raise RobotInvalid(message, **error.details) from None
            self._builder.warnings.append(warning(include, f"{uri} isn't there: {GAZEBO_MODELS[uri][0]}"))
            file = Path(uri)
            self._roots[file] = etree.fromstring(f"<sdf>{GAZEBO_MODELS[uri][1]}</sdf>")
        if file in stack:
            chain = " includes ".join(one.name for one in (*stack[stack.index(file) :], file))
            raise fault(include, f"the includes form a circle: {chain}", uri=uri)
        try:
            with located(file):
                if file not in self._roots:
                    self._roots[file] = read_root(file, self._builder.warnings)
                models = self._roots[file].findall("model")
                if len(models) != 1:
                    raise SceneInvalid(f"a file that is included must have one <model>, it has {len(models)}")
                nested = self._scope(models[0], file, (*stack, file), depth + 1)
                name = include.findtext("name", name_of(models[0])).strip()
        except SceneInvalid as error:
            raise fault(include, error.message, uri=uri) from None
        frame = include.findtext("placement_frame", models[0].get("placement_frame", ""))
        self._nest(scope, name, nested, include if include.find("pose") is not None else models[0], frame.strip())

    def _find(self, uri: str, file: Path, element: Element) -> Path:
        """Return the SDF file that a URI means: itself, or the one of the folder of a model."""
        if uri.partition("://")[0] in ("http", "https"):
            raise fault(
                element, f"model {uri!r} is on a server: download it, and name the folder above it: --package-dir"
            )
        if Path(uri).suffix in SUFFIXES:
            return self._resolve(uri, file, element, SUFFIXES)
        try:
            manifest = self._resolve(f"{uri.rstrip('/')}/model.config", file, element, (".config",))
        except RobotInvalid:
            return self._resolve(f"{uri.rstrip('/')}/model.sdf", file, element, SUFFIXES)
        versions = root_of(read_xml(manifest), "SDF", []).findall("sdf")
        numbered = [(re.findall(r"\d+", one.get("version", "0")), (one.text or "").strip()) for one in versions]
        named = max(numbered, key=lambda one: [int(digits[:9]) for digits in one[0]], default=([], ""))[1]
        found = (manifest.parent / named).resolve()
        if not (found.is_relative_to(manifest.parent) and found.is_file()):
            raise fault(
                element, f"the <sdf> of {str(manifest)!r} is {named!r}, which is no file in its folder", uri=uri
            )
        return found

    def _resolve(self, uri: str, file: Path, element: Element, suffixes: tuple[str, ...] = MESH_SUFFIXES) -> Path:
        resolver = self._resolvers.get(file.parent)
        if resolver is None:
            beside = [folder / "models" for folder in enclosing_folders(file.parent.resolve())]
            folders = [*self._package_dirs, *(folder for folder in beside if folder.is_dir())]
            resolver = self._resolvers[file.parent] = MeshResolver.for_file(file, folders)
        try:
            return resolver.resolve(uri, suffixes)
        except RobotInvalid as error:
            raise fault(element, error.message, **error.details) from None

    def _add(self, scope: _Scope, prefix: str, placement: Any, owners: tuple[str, ...]) -> None:
        with located(scope.file) if scope.file != self._top else contextlib.nullcontext():
            for link in scope.element.findall("link"):
                name = f"{prefix}{link.get('name')}"
                relative_to, local = _pose(link)
                at = scope.place(relative_to, link) * local
                for collision in link.findall("collision"):
                    frame, local = _pose(collision)
                    there = placement * (scope.place(frame, collision) if frame else at) * local
                    self._add_collision(scope.file, collision, f"{name}::{name_of(collision)}", there, (*owners, name))
            placed = [
                (name, placement * scope.place(to, model.element) * at, model) for name, to, at, model in scope.models
            ]
        for name, at, model in placed:
            self._add(model, f"{prefix}{name}::", at, (*owners, f"{prefix}{name}"))

    def _add_collision(self, file: Path, collision: Element, name: str, at: Any, owners: tuple[str, ...]) -> None:
        where = f"line {collision.sourceline}: "
        for shape in (one for geometry in collision.findall("geometry") for one in geometry):
            if shape.tag == "mesh":
                self._builder.add(Mesh, name, at, owners, where, **self._mesh(shape, file))
            elif shape.tag == "plane":
                normal = np.array(_numbers(shape, "normal", 3, [0.0, 0.0, 1.0]))
                if (length := float(np.linalg.norm(normal))) < 1e-9:
                    raise fault(shape, "the <normal> of a <plane> must not be zero")
                turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), normal / length)
                self._builder.add(HalfSpace, name, at * pin.SE3(turn.matrix(), np.zeros(3)), owners, where)
            elif shape.tag in SHAPES:
                kind, counts = SHAPES[shape.tag]
                numbers = {one: _numbers(shape, one, count) for one, count in counts.items()}
                sizes = {one: values if counts[one] > 1 else values[0] for one, values in numbers.items()}
                self._builder.add(kind, name, at, owners, where, **sizes)
            elif shape.tag != "empty":
                judged = ", ".join((*SHAPES, "plane", "mesh"))
                what = f"the <{shape.tag}> of collision {name!r} can't be judged; shapes are {judged}"
                raise fault(shape, f"{what}: export it as a mesh, or leave it out by its name")

    def _mesh(self, mesh: Element, file: Path) -> dict[str, np.ndarray]:
        path = self._resolve(_text(mesh, "uri"), file, mesh)
        scale = np.array(_numbers(mesh, "scale", 3, [1.0, 1.0, 1.0]))
        submesh = mesh.find("submesh")
        try:
            if submesh is None:
                found = read_mesh(path, scale)
                return {"vertices": found.vertices, "triangles": found.triangles}
            objects, name = read_objects(path, scale), _text(submesh, "name")
        except MeshFault as error:
            raise fault(mesh, f"mesh {path.name!r} {error}") from None
        chosen = next((one for named, one in objects if named == name), None)
        if chosen is None:
            known = list_choices([named for named, _ in objects])
            raise fault(submesh, f"mesh {path.name!r} has no <submesh> {name!r}; it has {known}")
        middle = 0.5 * (chosen.vertices.min(axis=0) + chosen.vertices.max(axis=0))
        is_centred = submesh.findtext("center", "false").strip() in ("true", "1")
        return {"vertices": chosen.vertices - middle if is_centred else chosen.vertices, "triangles": chosen.triangles}


SHAPES: dict[str, tuple[Kind, dict[str, int]]] = {
    "box": (Box, {"size": 3}),
    "sphere": (Sphere, {"radius": 1}),
    "cylinder": (Cylinder, {"radius": 1, "length": 1}),
    "capsule": (Capsule, {"radius": 1, "length": 1}),
    "cone": (cone, {"radius": 1, "length": 1}),
    "ellipsoid": (ellipsoid, {"radii": 3}),
}
"""Kind of each shape that has sizes alone, and how many numbers each of these has."""


def read_root(path: Path, warnings: list[str]) -> Element:
    """Return the root element of an SDF file; raises RobotInvalid if it isn't one."""
    root = root_of(read_xml(path), "SDF", warnings)
    if root.tag not in ROOTS:
        raise fault(root, f"the root element of an SDF file must be <sdf>, it is <{root.tag}>")
    return root


def _pose(element: Element, default: str = "") -> tuple[str, Any]:
    """Return the frame that the <pose> of an element is relative to, and its placement there, pinocchio.SE3."""
    pose = element.find("pose")
    relative_to = default if pose is None else pose.get("relative_to") or default
    if pose is None or not (pose.text or "").strip():
        return relative_to, pin.SE3.Identity()
    form = pose.get("rotation_format", "euler_rpy")
    if form not in ("euler_rpy", "quat_xyzw"):
        raise fault(pose, f"'rotation_format' must be euler_rpy or quat_xyzw, got {form!r}")
    is_quaternion = form == "quat_xyzw"
    values = _finite(pose, (pose.text or "").split(), 7 if is_quaternion else 6)
    if not is_quaternion:
        angles = np.array(values[3:])
        rotation = pin.rpy.rpyToMatrix(np.radians(angles) if pose.get("degrees") in ("true", "1") else angles)
        placement = pin.SE3(rotation, np.array(values[:3]))
    elif math.hypot(*values[3:]) < 1e-9:
        raise fault(pose, "the quaternion of <pose> must not be zero")
    else:
        placement = se3(values[:3], values[3:])
    return relative_to, placement


def _numbers(element: Element, tag: str, count: int, default: list[float] | None = None) -> list[float]:
    child = element.find(tag)
    if child is None and default is not None:
        return default
    return _finite(element if child is None else child, _text(element, tag).split(), count)


def _finite(element: Element, words: Sequence[str], count: int) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise fault(element, f"<{element.tag}> must be {count} finite numbers, got {' '.join(words)[:60]!r}")
    return values


def _text(element: Element, tag: str) -> str:
    text = str(element.findtext(tag, "")).strip()
    if not text:
        raise fault(element, f"<{element.tag}> must have <{tag}>")
    return text
