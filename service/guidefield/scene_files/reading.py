"""Read a scene from a file of any kind, by its suffix or root element; URDF, MJCF, MoveIt's scenes and meshes here.

Behind `guidefield.Scene.read` and the command line. A further kind, but of clouds or meshes, needs a branch, and its
suffix, in lower case, in `SUFFIXES` or `XML_SUFFIXES`.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin
from lxml import etree

from guidefield.errors import MalformedRequest, RequestTooLarge, RobotInvalid, SceneInvalid
from guidefield.geometry.surfaces import se3
from guidefield.messages import codec
from guidefield.messages.requests import UrdfFile
from guidefield.messages.scene import MAX_VERTICES, Box, Capsule, Cylinder, HalfSpace, Mesh, PointCloud, Scene, Sphere
from guidefield.robot.catalog import Catalog
from guidefield.robot.mesh_files.kinds import MESH_SUFFIXES
from guidefield.robot.mesh_files.reading import content_of, find_ignored_unit, read_mesh, read_objects, up_axis
from guidefield.robot.mesh_files.xml_formats import UNITS
from guidefield.robot.mjcf_compilation import body_names, compile_file, import_mujoco, is_mjcf, named
from guidefield.robot.mjcf_conversion import find_colliding, rest_configuration
from guidefield.robot.urdf.xml import ArgumentValue, fault, is_xacro, read_xml, root_of
from guidefield.scene_files import clouds, sdf
from guidefield.scene_files.builder import TO_Z_UP, Kind, SceneBuilder, cone, ellipsoid, located

PRIMITIVES: dict[str, tuple[Kind, tuple[str, ...]]] = {
    "box": (Box, ("size",)),
    "sphere": (Sphere, ("radius",)),
    "cylinder": (Cylinder, ("radius", "length")),
    "cone": (cone, ("radius", "length")),
}
"""Class and fields of each shape that has sizes alone: a number each, but three of a box (`_add_shape`)."""


def read_moveit_scene(text: str, builder: SceneBuilder) -> None:
    """Read a scene of MoveIt, of either form; raises SceneInvalid with line and object if it can't be judged."""
    lines = _Lines(text)
    lines.next_line("the name of the scene")
    is_posed: bool | None = None
    while (marker := lines.next_line("the line '.' at the end").strip()) != ".":
        if not marker.startswith("*"):
            raise lines.fault(f"an object begins with '* NAME' and the file ends with '.', got {marker[:40]!r}")
        name = marker[1:].strip()
        if is_posed is None:  # as MoveIt tells its forms apart: what follows is a position, or a number of shapes
            is_posed = len(lines.peek().split()) > 1
        pose = _pose(lines, name) if is_posed else pin.SE3.Identity()
        for _ in range(lines.count(f"shapes of {name!r}")):
            _add_shape(lines, name, pose, builder)
        for _ in range(lines.count(f"subframes of {name!r}") if is_posed else 0):
            lines.next_line("the name of a subframe")
            _pose(lines, name)


class _Lines:
    """Lines of a text, and the numbers in them."""

    def __init__(self, text: str) -> None:
        self._lines, self._at = text.splitlines(), 0

    def fault(self, message: str) -> SceneInvalid:
        return SceneInvalid(f"line {self._at}: {message}", line=self._at)

    def peek(self) -> str:
        """Return the next line, or nothing, and stay before it."""
        return next((line for line in self._lines[self._at :] if line.strip()), "")

    def next_line(self, what: str) -> str:
        """Return the next line that isn't blank; `what` it should be is for an error."""
        while self._at < len(self._lines):
            self._at += 1
            if self._lines[self._at - 1].strip():
                return self._lines[self._at - 1]
        raise self.fault(f"the file ends before {what}: it is cut short")

    def numbers(self, count: int, what: str) -> list[float]:
        values: list[float] = []
        while len(values) < count:
            for word in self.next_line(what).split():
                try:
                    values.append(float(word))
                except ValueError:
                    raise self.fault(f"{what}: {word[:40]!r} is no number") from None
        if len(values) > count or not all(map(math.isfinite, values)):
            raise self.fault(f"{what} must be {count} finite numbers, got {values[:8]}")
        return values

    def count(self, what: str, most: int = MAX_VERTICES) -> int:
        (value,) = self.numbers(1, f"the number of {what}")
        if not (value.is_integer() and 0 <= value <= most):
            raise self.fault(f"the number of {what} must be whole and at most {most}, got {value:g}")
        return int(value)


def _pose(lines: _Lines, name: str) -> Any:
    position = lines.numbers(3, f"the position of {name!r}")
    quaternion = lines.numbers(4, f"the quaternion of {name!r}")
    if math.hypot(*quaternion) < 1e-9:
        raise lines.fault(f"the quaternion of {name!r} is zero")
    return se3(position, quaternion)


def _add_shape(lines: _Lines, name: str, pose: Any, builder: SceneBuilder) -> None:
    shape = lines.next_line(f"a shape of {name!r}").strip()
    where, sizes, local = f"line {lines._at}: ", dict[str, Any](), pin.SE3.Identity()
    kind: Kind
    if shape in PRIMITIVES:
        kind, fields = PRIMITIVES[shape]
        values = lines.numbers(3 if shape == "box" else len(fields), f"the sizes of the {shape} of {name!r}")
        sizes = {"size": values} if shape == "box" else dict(zip(fields, values, strict=True))
    elif shape == "plane":
        kind = HalfSpace
        *normal, offset = lines.numbers(4, f"the plane of {name!r}")
        if (length := math.hypot(*normal)) < 1e-9:
            raise lines.fault(f"the plane of {name!r} has no normal")
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(normal) / length)
        local = pin.SE3(turn.matrix(), np.array(normal) * (-offset / length**2))
    elif shape == "mesh":
        kind = Mesh
        corners, triangles = map(int, lines.numbers(2, f"the numbers of vertices and triangles of {name!r}"))
        if not (0 < corners <= MAX_VERTICES and 0 < triangles <= MAX_VERTICES):
            raise lines.fault(f"the mesh of {name!r} must have 1 to {MAX_VERTICES} vertices and triangles")
        vertices = np.array(lines.numbers(3 * corners, f"the vertices of {name!r}")).reshape(-1, 3)
        indices = np.array(lines.numbers(3 * triangles, f"the triangles of {name!r}")).reshape(-1, 3)
        if not (indices.min() >= 0 and indices.max() < corners and (indices == np.floor(indices)).all()):
            raise lines.fault(f"the mesh of {name!r} has a triangle that names no vertex: there are {corners}")
        sizes = {"vertices": vertices, "triangles": indices}
    else:
        known = ", ".join((*PRIMITIVES, "plane", "mesh"))
        raise lines.fault(f"the shape {shape[:40]!r} of {name!r} can't be judged; shapes are {known}")
    local = _pose(lines, name) * local
    lines.numbers(4, f"the colour of {name!r}")
    builder.add(kind, name, pose * local, where=where, **sizes)


def read_urdf(
    path: Path, package_dirs: Sequence[Path], xacro_args: Mapping[str, ArgumentValue], builder: SceneBuilder
) -> None:
    """Read the collision shapes of a URDF or xacro file, named as their links; raises RobotInvalid with the element."""
    folders = [str(folder) for folder in package_dirs]
    robot = Catalog().load(UrdfFile(str(path), package_dirs=folders, xacro_args=dict(xacro_args)))
    builder.warnings += robot.warnings
    data, shapes = robot.model.createData(), robot.geometry.createData()
    pin.forwardKinematics(robot.model, data, robot.rest)
    pin.updateGeometryPlacements(robot.model, data, robot.geometry, shapes)
    for shape, placement in zip(robot.geometry.geometryObjects, shapes.oMg, strict=True):
        frames, frame = list[str](), shape.parentFrame
        while frame:
            frames, frame = [*frames, robot.model.frames[frame].name], robot.model.frames[frame].parentFrame
        builder.add(name=frames[0], placement=placement, owners=frames, **_urdf_shape(shape))


def _urdf_shape(shape: Any) -> dict[str, Any]:
    one = shape.geometry
    match type(one).__name__:
        case "Box":
            return {"kind": Box, "size": 2.0 * np.array(one.halfSide)}
        case "Sphere":
            return {"kind": Sphere, "radius": one.radius}
        case "Cylinder":
            return {"kind": Cylinder, "radius": one.radius, "length": 2.0 * one.halfLength}
        case "Capsule":
            return {"kind": Capsule, "radius": one.radius, "length": 2.0 * one.halfLength}
    mesh = read_mesh(Path(shape.meshPath), np.array(shape.meshScale))
    return {"kind": Mesh, "vertices": mesh.vertices, "triangles": mesh.triangles}


def read_mjcf(path: Path, builder: SceneBuilder) -> None:
    """Read the geoms of an MJCF that collide, where MuJoCo has them in the keyframe that a robot would rest in.

    A geom without a name is called as its body. A plane is a half-space, a height field a mesh.

    Raises:
        RobotInvalid: if the package `mujoco` is missing, MuJoCo refuses the file, or a geom can't be judged; names it.
    """
    mujoco, compiled = import_mujoco(), compile_file(path)
    model, data = compiled.model, mujoco.MjData(compiled.model)
    builder.warnings += compiled.warnings
    if model.nflex:
        raise RobotInvalid("a <flex> is a body that bends, which can't be judged; take it out")
    model.geom_sameframe[:] = 0  # else MuJoCo takes a geom within 1e-6 of its body's inertia for being there
    data.qpos[:] = rest_configuration(model)
    mujoco.mj_kinematics(model, data)
    names, bodies = named(model, "geom"), body_names(model)
    for geom in np.flatnonzero(find_colliding(model)).tolist():
        owners, body = list[str](), int(model.geom_bodyid[geom])
        while body:
            owners, body = [*owners, bodies[body]], int(model.body_parentid[body])
        name = names[geom] or bodies[model.geom_bodyid[geom]]
        placement = pin.SE3(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])
        builder.add(name=name, placement=placement, owners=owners, where=f"geom {geom}: ", **_geom(model, geom, name))


def _geom(model: Any, geom: int, name: str) -> dict[str, Any]:
    kinds, kind = import_mujoco().mjtGeom, int(model.geom_type[geom])
    a, b, c = model.geom_size[geom].tolist()
    index = int(model.geom_dataid[geom])
    plain: dict[int, dict[str, Any]] = {
        kinds.mjGEOM_PLANE: {"kind": HalfSpace},
        kinds.mjGEOM_SPHERE: {"kind": Sphere, "radius": a},
        kinds.mjGEOM_CAPSULE: {"kind": Capsule, "radius": a, "length": 2.0 * b},
        kinds.mjGEOM_CYLINDER: {"kind": Cylinder, "radius": a, "length": 2.0 * b},
        kinds.mjGEOM_BOX: {"kind": Box, "size": [2.0 * a, 2.0 * b, 2.0 * c]},
        kinds.mjGEOM_ELLIPSOID: {"kind": ellipsoid, "radii": [a, b, c]},
    }
    if kind in plain:
        return plain[kind]
    if kind == kinds.mjGEOM_HFIELD:
        return {"kind": Mesh, **_height_field(model, index)}
    if index < 0 or model.geom_plugin[geom] >= 0:
        shape = kinds(kind).name.removeprefix("mjGEOM_").lower()
        raise RobotInvalid(
            f"geom {name!r} is of type {shape}, whose surface only its plugin knows; replace it by a mesh"
        )
    vertices, faces = model.mesh_vertadr[index], model.mesh_faceadr[index]
    return {
        "kind": Mesh,
        "vertices": np.array(model.mesh_vert[vertices : vertices + model.mesh_vertnum[index]], np.float64),
        "triangles": np.array(model.mesh_face[faces : faces + model.mesh_facenum[index]]),
    }


def _height_field(model: Any, index: int) -> dict[str, np.ndarray]:
    """Return the closed mesh of a height field: its surface, its base and the walls between them."""
    rows, columns, first = (int(of[index]) for of in (model.hfield_nrow, model.hfield_ncol, model.hfield_adr))
    x, y, top, base = model.hfield_size[index].tolist()
    heights = top * np.array(model.hfield_data[first : first + rows * columns], np.float64)
    places = np.stack(np.meshgrid(np.linspace(-x, x, columns), np.linspace(-y, y, rows)), axis=2).reshape(-1, 2)
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (one.reshape(-1) for one in (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]))
    surface = np.concatenate([np.column_stack([a, b, c]), np.column_stack([c, b, d])])
    edge = np.concatenate([number[0, :-1], number[:-1, -1], number[-1, :0:-1], number[:0:-1, 0]])
    after, below = np.roll(edge, -1), rows * columns
    walls = [np.column_stack([edge, edge + below, after]), np.column_stack([after, edge + below, after + below])]
    low = np.full(len(places), -base)
    vertices = np.concatenate([np.column_stack([places, heights]), np.column_stack([places, low])])
    return {"vertices": vertices, "triangles": np.concatenate([surface, surface[:, ::-1] + below, *walls])}


XML_SUFFIXES = (*sdf.SUFFIXES, ".urdf", ".xacro", ".xml")
SUFFIXES = (".json", ".scene", *XML_SUFFIXES, *MESH_SUFFIXES, *(one for one in clouds.READERS if one != ".ply"))


def read_scene(
    path: str | Path,
    *,
    name: str | None = None,
    scale: float = 1.0,
    up: str | None = None,
    radius: float | None = None,
    prefix: str = "",
    package_dirs: Sequence[str | Path] = (),
    xacro_args: Mapping[str, ArgumentValue] | None = None,
    without: Collection[str] = (),
) -> Scene:
    """Read a scene; see `guidefield.Scene.read`."""
    file, builder, folders = Path(path), SceneBuilder(scale, without), [Path(folder) for folder in package_dirs]
    if not 0.0 < scale < np.inf or (radius is not None and not 0.0 < radius < np.inf):
        raise SceneInvalid(f"`scale` and `radius` must be positive, got {scale} and {radius}")
    if up is not None and up not in TO_Z_UP:
        raise SceneInvalid(f"`up` must be one of {', '.join(TO_Z_UP)}, got {up!r}")
    if (suffix := file.suffix.lower()) not in SUFFIXES:
        raise SceneInvalid(f"{file.name!r} is no scene file; one ends in {', '.join(SUFFIXES)}", path=str(file))
    with located(file):
        if file.exists() and not (file.is_file() and file.stat().st_size <= clouds.MAX_BYTES):
            raise SceneInvalid(f"only a regular file of at most {clouds.MAX_BYTES} bytes is read")
        content = content_of(file)
        if suffix == ".json":
            if scale != 1.0 or up is not None or prefix or without:
                raise SceneInvalid("a scene in JSON is read as it is: no other scale, axes, names or parts")
            return _read_json(content, name)
        builder.turn = TO_Z_UP[up or (up_axis(file) if suffix in MESH_SUFFIXES else "z")]
        if suffix in XML_SUFFIXES:
            _read_xml_scene(file, folders, xacro_args or {}, builder)
        elif suffix == ".scene":
            read_moveit_scene(content.decode(errors="replace"), builder)
        elif clouds.is_cloud(suffix, content):
            _read_cloud(file, radius, builder)
        else:
            _read_meshes(file, builder)
        scene = builder.scene(name or file.stem, prefix)
    for sentence in dict.fromkeys(builder.warnings):
        warnings.warn(f"{file.name}: {sentence}", stacklevel=3)
    return scene


def _read_json(content: bytes, name: str | None) -> Scene:
    try:
        scene: Scene = codec.decode(content, Scene)
    except (MalformedRequest, RequestTooLarge) as error:
        raise SceneInvalid(error.message, **error.details) from None
    return scene if name is None else msgspec.structs.replace(scene, name=name)


def _read_xml_scene(
    file: Path, folders: Sequence[Path], xacro_args: Mapping[str, ArgumentValue], builder: SceneBuilder
) -> None:
    root = None
    if not is_xacro(file):
        text = read_xml(file)
        if is_mjcf(text):
            read_mjcf(file, builder)
            return
        root = root_of(text, "SDF", builder.warnings)
    if root is not None and root.tag in sdf.ROOTS:
        sdf.SdfReader(builder, folders).read(file, root)
    elif root is None or etree.QName(root).localname == "robot":
        read_urdf(file, folders, xacro_args, builder)
    else:
        raise fault(root, f"the root element must be <sdf>, <robot> or <mujoco>, it is <{root.tag}>")


def _read_cloud(file: Path, radius: float | None, builder: SceneBuilder) -> None:
    if radius is None:
        raise SceneInvalid(
            "a cloud is judged as balls about its points: give their `radius` [m] (--radius), more than half of the "
            "points' spacing so that nothing slips through"
        )
    points, unmeasured = clouds.read_cloud(file)
    if unmeasured:
        builder.warnings.append(f"{unmeasured} points with coordinates that are NaN are left out: nothing was measured")
    builder.add(PointCloud, file.stem, pin.SE3.Identity(), points=points, radius=radius / builder.scale)


def _read_meshes(file: Path, builder: SceneBuilder) -> None:
    builder.scale *= UNITS[find_ignored_unit(file) or "meter"]
    objects = read_objects(file)
    for number, (name, mesh) in enumerate(objects):
        called = file.stem if len(objects) == 1 else name or f"{file.stem}/{number}"
        builder.add(Mesh, called, pin.SE3.Identity(), vertices=mesh.vertices, triangles=mesh.triangles)
