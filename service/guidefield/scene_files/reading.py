"""Read a scene from a file of any kind: its suffix says which, its root element where that is XML."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np
import pinocchio as pin
from lxml import etree

from guidefield.errors import MalformedRequest, RequestTooLarge, SceneInvalid
from guidefield.messages import codec
from guidefield.messages.scene import Mesh, PointCloud, Scene
from guidefield.robot.mesh_files.reading import content_of, ignored_unit, read_objects, up_axis
from guidefield.robot.mesh_files.three_mf import UNITS
from guidefield.robot.mjcf.compilation import is_mjcf
from guidefield.robot.urdf.meshes import MESH_SUFFIXES
from guidefield.robot.urdf.xacro_files import ArgumentValue, is_xacro
from guidefield.robot.urdf.xml import fault, read_xml, root_of
from guidefield.scene_files import clouds, sdf
from guidefield.scene_files.builder import TO_Z_UP, SceneBuilder, located
from guidefield.scene_files.models import read_mjcf, read_urdf
from guidefield.scene_files.moveit import read_moveit_scene

XML_SUFFIXES = (*sdf.SUFFIXES, ".urdf", ".xacro", ".xml")
SUFFIXES = (".json", ".scene", *XML_SUFFIXES, *MESH_SUFFIXES, *(one for one in clouds.READERS if one != ".ply"))
"""Suffixes of the files that are read, in lower case."""


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
    """Add the objects of a mesh file, in its unit; a single one is called as the file."""
    builder.scale *= UNITS[ignored_unit(file) or "meter"]
    objects = read_objects(file)
    for number, (name, mesh) in enumerate(objects):
        called = file.stem if len(objects) == 1 else name or f"{file.stem}/{number}"
        builder.add(Mesh, called, pin.SE3.Identity(), vertices=mesh.vertices, triangles=mesh.triangles)
