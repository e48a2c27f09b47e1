"""Geoms of a compiled MJCF as <collision> and <visual> of a URDF; their meshes as STL files in the user's cache."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.geometry.cache import keep_file
from guidefield.robot.mjcf.compilation import import_mujoco
from guidefield.robot.mjcf.kinematic_tree import add_origin, placement
from guidefield.robot.mjcf.names import UniqueNames, named
from guidefield.robot.urdf.xml import Element

VISIBLE_GROUPS = 3
"""MuJoCo shows geoms of the groups below this one, unless somebody switches others on."""

SUBDIVISIONS = 3
"""Of the icosahedron that stands about an ellipsoid: it is at most 0.9 % larger."""

_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def colliding(model: Any) -> Any:
    """Which geoms MuJoCo may test against others, shape (ngeom,) bool: by their masks, or because a <pair> says so."""
    may = (np.asarray(model.geom_contype) != 0) | (np.asarray(model.geom_conaffinity) != 0)
    may[np.asarray(model.pair_geom1)] = True
    may[np.asarray(model.pair_geom2)] = True
    return may


class GeomWriter:
    """Writes the geoms of a model into the links of their bodies.

    Args:
        model: `mujoco.MjModel`.
        links: <link> of each body.

    Attributes:
        meshes: The files of meshes, by what the URDF calls them.
        collisions: Index of the geom behind each <collision>, by link, in their order.
        scenery: Names of planes and height fields that collide: no part of a robot, and left out.
    """

    def __init__(self, model: Any, links: Sequence[Element]) -> None:
        self._model, self._links = model, links
        self._kinds = import_mujoco().mjtGeom
        self._names = [name or f"number {index}" for index, name in enumerate(named(model, "geom"))]
        self._mesh_names, self._unique = named(model, "mesh"), UniqueNames(())
        self._uris: dict[object, str] = {}
        self.meshes: dict[str, Path] = {}
        self.collisions: dict[str, list[int]] = {}
        self.scenery: list[str] = []

    def write(self, world: bool) -> None:
        """Write every geom; those of the world's body only where they are part of the robot.

        Raises:
            RobotInvalid: if the surface of a geom isn't known, or a file can't be written.
        """
        model, may_collide = self._model, colliding(self._model)
        shown = np.asarray(model.geom_group) < VISIBLE_GROUPS
        for body in range(0 if world else 1, model.nbody):
            geoms = range(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
            solid = [geom for geom in geoms if self._is_bounded(geom, bool(may_collide[geom]))]
            visible = [geom for geom in solid if shown[geom]]
            for geom in visible or [geom for geom in solid if may_collide[geom]]:
                self._add(geom, "visual")
            for geom in solid:
                if may_collide[geom]:
                    self._add(geom, "collision")
                    self.collisions.setdefault(self._links[body].get("name"), []).append(geom)

    def _is_bounded(self, geom: int, collides: bool) -> bool:
        if int(self._model.geom_type[geom]) not in (self._kinds.mjGEOM_PLANE, self._kinds.mjGEOM_HFIELD):
            return True
        if collides:
            self.scenery.append(self._names[geom])
        return False

    def _add(self, geom: int, tag: str) -> None:
        model = self._model
        element = etree.SubElement(self._links[model.geom_bodyid[geom]], tag)
        add_origin(element, placement(model.geom_pos[geom], model.geom_quat[geom]))
        shape, attributes = self._shape(geom)
        etree.SubElement(etree.SubElement(element, "geometry"), shape, attributes)
        if tag == "visual":
            material = model.geom_matid[geom]
            color = " ".join(f"{c:g}" for c in (model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]))
            etree.SubElement(etree.SubElement(element, "material", name=color), "color", rgba=color)

    def _shape(self, geom: int) -> tuple[str, dict[str, str]]:
        """URDF's word for a geom's shape, and its attributes."""
        kinds, kind = self._kinds, int(self._model.geom_type[geom])
        a, b, c = self._model.geom_size[geom].tolist()
        if kind == kinds.mjGEOM_SPHERE:
            return "sphere", {"radius": repr(a)}
        if kind == kinds.mjGEOM_CAPSULE:
            return "capsule", {"radius": repr(a), "length": repr(2.0 * b)}
        if kind == kinds.mjGEOM_CYLINDER:
            return "cylinder", {"radius": repr(a), "length": repr(2.0 * b)}
        if kind == kinds.mjGEOM_BOX:
            return "box", {"size": f"{2.0 * a!r} {2.0 * b!r} {2.0 * c!r}"}
        if kind == kinds.mjGEOM_ELLIPSOID:
            return "mesh", {"filename": self._ellipsoid(a, b, c)}
        mesh = int(self._model.geom_dataid[geom])
        if mesh < 0 or self._model.geom_plugin[geom] >= 0:
            kind_name = kinds(kind).name.removeprefix("mjGEOM_").lower()
            raise RobotInvalid(
                f"MJCF: geom {self._names[geom]!r} is of type {kind_name}, whose surface only its plugin knows; "
                "replace it by a mesh or a primitive, or set its contype and conaffinity to 0 and its group to 3"
            )
        return "mesh", {"filename": self._mesh(mesh)}

    def _mesh(self, mesh: int) -> str:
        if mesh not in self._uris:
            model = self._model
            vertices, faces = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
            corners = np.asarray(model.mesh_vert[vertices : vertices + model.mesh_vertnum[mesh]])
            triangles = np.asarray(model.mesh_face[faces : faces + model.mesh_facenum[mesh]])
            self._uris[mesh] = self._keep(self._mesh_names[mesh] or f"mesh{mesh}", corners, triangles)
        return self._uris[mesh]

    def _ellipsoid(self, *semi_axes: float) -> str:
        if semi_axes not in self._uris:
            ball = _circumscribed()
            vertices = ball.vertices * np.array(semi_axes)
            name = "ellipsoid " + " ".join(f"{one:g}" for one in semi_axes)
            self._uris[semi_axes] = self._keep(name, vertices, ball.faces)
        return self._uris[semi_axes]

    def _keep(self, name: str, vertices: np.ndarray, triangles: np.ndarray) -> str:
        content = stl(vertices, triangles)
        uri = self._unique.make(f"{name}.stl")
        try:
            self.meshes[uri] = keep_file(f"{hashlib.sha256(content).hexdigest()}.stl", content)
        except OSError as error:
            raise RobotInvalid(f"mesh {name!r} of the MJCF can't be written for the loader: {error}") from None
        return uri


def stl(vertices: np.ndarray, triangles: np.ndarray) -> bytes:
    """A binary STL of vertices (v, 3) in single precision, which is MuJoCo's, and triangles (t, 3)."""
    records = np.zeros(len(triangles), _STL)
    records["corners"] = np.asarray(vertices)[triangles]
    return bytes(80) + len(triangles).to_bytes(4, "little") + records.tobytes()


def _circumscribed() -> Any:
    """A polyhedron about the unit ball, as trimesh has it."""
    from trimesh.creation import icosphere

    ball = icosphere(subdivisions=SUBDIVISIONS)
    ball.apply_scale(1.0 / float(np.einsum("ij,ij->i", ball.face_normals, ball.triangles[:, 0]).min()))
    return ball
