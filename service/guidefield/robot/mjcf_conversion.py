"""Convert a compiled MJCF to a URDF and the words of an SRDF, which the one loader of robots reads.

Pinocchio has a reader of MJCF, too; of 152 models that people publish it places 42 as MuJoCo does (version 4.1).
MuJoCo's own compiler is right by definition, and what it compiled is plain: a tree of bodies, joints, shapes and masks.

Pairs that `find_disabled_pairs` returns are never tested, and shapes have to contain the geoms. By `VISIBLE_GROUPS`
geoms are drawn, or refused if they can't be; with more `SUBDIVISIONS` ellipsoids, also of scene files, are tested
closer, and for longer.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.geometry.cache import keep_file
from guidefield.messages.requests import Positions
from guidefield.robot.mjcf_compilation import (
    CompiledModel,
    UniqueNames,
    add_origin,
    body_names,
    import_mujoco,
    joint_laws,
    kinematic_tree,
    named,
    placement,
    tendon_warnings,
)
from guidefield.robot.urdf.srdf import STATES, Srdf, SrdfState
from guidefield.robot.urdf.xml import Element

VISIBLE_GROUPS = 3  # muJoCo shows geoms of the groups below this one, unless somebody switches others on
SUBDIVISIONS = 3  # of the icosahedron that stands about an ellipsoid: it is at most 0.9 % larger (docs/scenes.md)

_STL = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def find_colliding(model: Any) -> Any:
    """Find the geoms that MuJoCo may test against others, (ngeom,) bool: by their masks, or because of a <pair>."""
    may = (np.asarray(model.geom_contype) != 0) | (np.asarray(model.geom_conaffinity) != 0)
    may[np.asarray(model.pair_geom1)] = True
    may[np.asarray(model.pair_geom2)] = True
    return may


class GeomWriter:
    """Writes the geoms of a model into the links of their bodies.

    Attributes:
        meshes: The files of meshes, by the URDF's names.
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

        RobotInvalid if the surface of a geom isn't known, or a file can't be written.
        """
        model, may_collide = self._model, find_colliding(self._model)
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
                "replace it by a mesh or a primitive, or set its contype and conaffinity to 0 and its group to "
                f"{VISIBLE_GROUPS}"
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
            ball = circumscribed_ball()
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
    """Write a binary STL of vertices (v, 3) in single precision, which is MuJoCo's, and triangles (t, 3)."""
    records = np.zeros(len(triangles), _STL)
    records["corners"] = np.asarray(vertices)[triangles]
    return bytes(80) + len(triangles).to_bytes(4, "little") + records.tobytes()


def circumscribed_ball() -> Any:
    """Make a polyhedron that contains the unit ball, `trimesh.Trimesh`."""
    from trimesh.creation import icosphere

    ball = icosphere(subdivisions=SUBDIVISIONS)
    ball.apply_scale(1.0 / float(np.einsum("ij,ij->i", ball.face_normals, ball.triangles[:, 0]).min()))
    return ball


AT_REFERENCE = "reference"  # the state in which every joint has its reference value


def find_disabled_pairs(
    model: Any, geoms: Mapping[str, Sequence[int]], rest: np.ndarray, warnings: list[str]
) -> dict[frozenset[str], str]:
    """Return pairs of links that aren't tested, with reasons.

    Those that MuJoCo leaves out because of an <exclude>, or because they are parent and child, are left out here. Those
    that only contype and conaffinity keep apart are tested here all the same, except where they touch at rest: masks
    mostly spare a simulation time, and links that meet do so in reality.

    Args:
        geoms: Indices of the geoms of each link, in their order.
        rest: MuJoCo's configuration, shape (nq,), at rest.
        warnings: Gets a sentence about pairs that MuJoCo doesn't test and we do.
    """
    mujoco = import_mujoco()
    disabled: dict[frozenset[str], str] = {}
    masked: list[tuple[str, str]] = []
    bodies = {link: int(model.geom_bodyid[some[0]]) for link, some in geoms.items()}
    excluded = {frozenset(divmod(int(one), 1 << 16)) for one in model.exclude_signature}
    paired = {
        frozenset((int(model.geom_bodyid[first]), int(model.geom_bodyid[second])))
        for first, second in zip(model.pair_geom1, model.pair_geom2, strict=True)
    }
    touching = _Touching(model, rest)
    for first, second in combinations(geoms, 2):
        pair, both = frozenset((first, second)), frozenset((bodies[first], bodies[second]))
        if both in paired or model.body_weldid[bodies[first]] == model.body_weldid[bodies[second]]:
            continue
        if both in excluded:
            disabled[pair] = "<exclude>"
        elif _are_parent_and_child(model, bodies[first], bodies[second]):
            disabled[pair] = "adjacent"
        elif not _masks_meet(model, geoms[first], geoms[second]):
            masked.append((first, second))
            if touching(geoms[first], geoms[second]):
                disabled[pair] = "contype and conaffinity, and they touch at rest"
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        warnings.append('the MJCF says <flag contact="disable"/>; contacts count here all the same')
    if masked:
        left = [pair for pair in masked if frozenset(pair) in disabled]
        still = f", except {len(left)} that touch at rest ({_describe_pairs(left)})" if left else ""
        warnings.append(
            f"for contype and conaffinity MuJoCo never tests {len(masked)} pairs of links ({_describe_pairs(masked)}); "
            f"they are tested here{still}"
        )
    return disabled


def _describe_pairs(pairs: Sequence[tuple[str, str]]) -> str:
    more = f" and {len(pairs) - 1} more" if len(pairs) > 1 else ""
    return " and ".join(pairs[0]) + more


def _are_parent_and_child(model: Any, first: int, second: int) -> bool:
    """Return True if MuJoCo's filter of parents drops a pair of bodies; what is fixed to the world is no parent."""
    if model.opt.disableflags & import_mujoco().mjtDisableBit.mjDSBL_FILTERPARENT:
        return False
    welded, other = int(model.body_weldid[first]), int(model.body_weldid[second])
    if 0 in (welded, other):
        return False
    above = [int(model.body_weldid[model.body_parentid[body]]) for body in (welded, other)]
    return above[0] == other or above[1] == welded


def _masks_meet(model: Any, first: Sequence[int], second: Sequence[int]) -> bool:
    types, affinities = np.asarray(model.geom_contype), np.asarray(model.geom_conaffinity)
    one, other = np.array(first), np.array(second)
    meet = (types[one][:, None] & affinities[other]) | (types[other] & affinities[one][:, None])
    return bool(np.any(meet))


class _Touching:
    """Tests whether geoms touch at one configuration of MuJoCo's, shape (nq,), by its own distance."""

    def __init__(self, model: Any, q: np.ndarray) -> None:
        self._model, self._mujoco = model, import_mujoco()
        self._data = self._mujoco.MjData(model)
        self._data.qpos[:] = q
        self._mujoco.mj_kinematics(model, self._data)

    def __call__(self, first: Iterable[int], second: Iterable[int]) -> bool:
        second = list(second)
        return any(self._touch(one, other) for one in first for other in second)

    def _touch(self, one: int, other: int) -> bool:
        centres, radii = self._data.geom_xpos, self._model.geom_rbound
        if np.linalg.norm(centres[one] - centres[other]) > radii[one] + radii[other]:
            return False
        apart: float = self._mujoco.mj_geomDistance(self._model, self._data, one, other, 1e-3, None)
        return apart <= 0.0


def keyframe_states(model: Any) -> dict[str, np.ndarray]:
    """Return MuJoCo's configuration (nq,) of each keyframe by name, `key<index>` without one; then `reference`."""
    states = {name or f"key{index}": np.array(model.key_qpos[index]) for index, name in enumerate(named(model, "key"))}
    return {**states, AT_REFERENCE: np.array(model.qpos0)}


def rest_configuration(model: Any) -> np.ndarray:
    """Return MuJoCo's configuration (nq,) at rest: a keyframe, chosen by name as states of an SRDF are."""
    states = keyframe_states(model)
    return states[next((name for name in STATES if name in states), next(iter(states)))]


def positions(model: Any, joints: Mapping[int, str], q: np.ndarray) -> Positions:
    """Return values by joint, as on the wire, of MuJoCo's configuration (nq,), whose quaternions begin with w."""
    kinds = import_mujoco().mjtJoint
    values: Positions = {}
    for joint, name in joints.items():
        address, kind = int(model.jnt_qposadr[joint]), int(model.jnt_type[joint])
        if kind == kinds.mjJNT_FREE:
            x, y, z, w, a, b, c = q[address : address + 7].tolist()
            values[name] = [x, y, z, a, b, c, w]
        elif kind == kinds.mjJNT_BALL:
            w, a, b, c = q[address : address + 4].tolist()
            values[name] = [a, b, c, w]
        else:
            values[name] = float(q[address])
    return values


@dataclass(frozen=True, eq=False)
class MjcfRobot:
    """The URDF of an MJCF."""

    urdf: str  # the URDF, with a link for each body and named site, below the link `world`
    semantics: Srdf  # pairs of links that aren't tested, and keyframes, in the words of an SRDF
    meshes: Mapping[str, Path]  # files by the names that the URDF has for them
    balls: tuple[str, ...]  # names of ball joints; the URDF calls them floating
    joints: Mapping[int, str]  # name of each joint that moves, by MuJoCo's index
    geoms: Mapping[str, Sequence[int]]  # muJoCo's indices of the geoms behind each link's <collision>, in their order
    warnings: tuple[str, ...]  # what isn't kept, or differs from what MuJoCo does


def convert(compiled: CompiledModel, name: str, root_joint: str) -> MjcfRobot:
    """Write a compiled MJCF as a URDF; RobotInvalid if it has a part that can't be tested or planned for.

    With a root joint `fixed`, bodies with free joints stand where the file has them; `free`: they move, or the whole
    robot if it has none; `planar`: the whole robot moves.
    """
    model, warnings = compiled.model, list(compiled.warnings)
    if model.nflex:
        which = ", ".join(repr(name) for name in named(model, "flex") if name)
        raise RobotInvalid(
            f"MJCF: it has a <flex>{' called ' + which if which else ''}, a body that bends, which can't be judged;"
            " take it out"
        )
    laws = joint_laws(model, warnings)
    tree = kinematic_tree(model, laws, root_joint == "free", name)
    warnings += _held_bodies(model, tree.joints)
    warnings += tendon_warnings(model)
    geoms = GeomWriter(model, tree.links)
    in_place = root_is_fixed(model, root_joint)
    geoms.write(in_place)
    if geoms.scenery:
        warnings.append(
            f"planes and height fields are no part of a robot, and left out: {', '.join(geoms.scenery)}; "
            "declare the ground as an obstacle"
        )
    if not in_place and model.body_geomnum[0]:
        warnings.append("the shapes of the world's body are left out: the root moves, and they don't")
    rest = rest_configuration(model)
    disabled = find_disabled_pairs(model, geoms.collisions, rest, warnings)
    states = [SrdfState(state, "", positions(model, tree.joints, q), 0) for state, q in keyframe_states(model).items()]
    return MjcfRobot(
        urdf=etree.tostring(tree.robot, encoding="unicode", pretty_print=True),
        semantics=Srdf(states=tuple(states), disabled=disabled, said_by="MJCF"),
        meshes=geoms.meshes,
        balls=tree.balls,
        joints=tree.joints,
        geoms=geoms.collisions,
        warnings=tuple(warnings),
    )


def root_is_fixed(model: Any, root_joint: str) -> bool:
    """Return True if the link `world` stands still: nothing but the file's own joints moves the robot."""
    return root_joint == "fixed" or (root_joint == "free" and bool(_free_joints(model)))


def _free_joints(model: Any) -> list[int]:
    free = import_mujoco().mjtJoint.mjJNT_FREE
    return [joint for joint in range(model.njnt) if model.jnt_type[joint] == free]


def _held_bodies(model: Any, moving: Collection[int]) -> list[str]:
    names = body_names(model)
    held = [names[model.jnt_bodyid[joint]] for joint in _free_joints(model) if joint not in moving]
    if not held:
        return []
    return [f'free joints stand still where the MJCF has them: {", ".join(held)}; root_joint "free" lets them move']
