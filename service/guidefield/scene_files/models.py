"""Robot files as scenery: the links of a URDF or xacro file, and the geoms of an MJCF, where they are at rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from guidefield.errors import RobotInvalid
from guidefield.messages.requests import UrdfFile
from guidefield.messages.scene import Box, Capsule, Cylinder, HalfSpace, Mesh, Sphere
from guidefield.robot.catalog.catalog import Catalog
from guidefield.robot.mesh_files.reading import read_mesh
from guidefield.robot.mjcf.compilation import body_names, compile_file, import_mujoco, named
from guidefield.robot.mjcf.conversion import colliding, rest_configuration
from guidefield.robot.urdf.xacro_files import ArgumentValue
from guidefield.scene_files.builder import SceneBuilder, ellipsoid


def read_urdf(
    path: Path, package_dirs: Sequence[Path], xacro_args: Mapping[str, ArgumentValue], builder: SceneBuilder
) -> None:
    """Read the collision shapes of a URDF or xacro file, each named as its link.

    Raises:
        RobotInvalid: if the file can't be used, with the element at fault.
    """
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
    """Return the class and the sizes of a shape of Pinocchio's; a mesh as its file has it."""
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
    for geom in np.flatnonzero(colliding(model)).tolist():
        owners, body = list[str](), int(model.geom_bodyid[geom])
        while body:
            owners, body = [*owners, bodies[body]], int(model.body_parentid[body])
        name = names[geom] or bodies[model.geom_bodyid[geom]]
        placement = pin.SE3(data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom])
        builder.add(name=name, placement=placement, owners=owners, where=f"geom {geom}: ", **_geom(model, geom, name))


def _geom(model: Any, geom: int, name: str) -> dict[str, Any]:
    """Return the class and the sizes of a geom."""
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
