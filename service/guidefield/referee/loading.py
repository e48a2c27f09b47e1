"""Load cases from files, with the fields of docs/referee.md, which `case_file.py` writes.

Pinocchio, Coal and Assimp read what a file declares: the referee takes no number of the certificate's. A new or changed
field needs a new number: in `FORMATS` here and in proof.py, `FORMAT` of case_file.py, on the page; earlier ones are
still read.
"""

from __future__ import annotations

import base64
import io
import itertools
import json
import lzma
import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from guidefield.referee.case import Body, Case, Constraint, Screw
from guidefield.referee.shapes import (
    NO_TRIANGLES,
    Shape,
    UnreadableMesh,
    hull,
    placement_of,
    points_of,
    read_mesh_file,
    shape,
    shape_of,
    snap_to_corners,
    surface,
)

FORMATS = ("guidefield cases 2", "guidefield cases 1")
"""Formats that are read; the first one is written. In the second motions have neither accelerations nor tolerances."""

ROOTS = {"fixed": None, "planar": pin.JointModelPlanar, "free": pin.JointModelFreeFlyer}

LARGEST = 2**29  # the largest packed file that is read, unpacked [bytes], as the page says: a kB may hold gigabytes
MOMENT = 1e-9  # duration of a motion of a single position [s], as in case_file.py

Fields = Mapping[str, Any]  # a part of a file, as JSON has it

Meshes = dict[tuple[str, tuple[tuple[str, bytes], ...]], np.ndarray]
"""Triangles (t, 3, 3) of mesh files that were read, by the file's name and the contents of all it may refer to."""


class UnusableFile(ValueError):
    """The file isn't one of this format, or something in it contradicts something else."""


def load(path: Path) -> list[Case]:
    """Read cases from a file of JSON, or of JSON packed with xz.

    Raises:
        UnusableFile: if it can't be used, with what is wrong.
        OSError: if it can't be read.
    """
    packed = path.read_bytes()
    try:
        content = json.loads(_unpack(packed) if packed[:6] == b"\xfd7zXZ\x00" else packed)
    except UnusableFile as error:
        raise UnusableFile(f"{path.name} {error}") from None
    except (ValueError, EOFError, RecursionError, lzma.LZMAError) as error:
        raise UnusableFile(f"{path.name} isn't JSON: {error}") from None
    if (
        not isinstance(content, dict)
        or content.get("format") not in FORMATS
        or not isinstance(content.get("cases"), list)
    ):
        raise UnusableFile(f"{path.name} must have `format` {FORMATS[0]!r} and a list of `cases`")
    meshes: Meshes = {}
    return [case_of(one, meshes) for one in content["cases"]]


def _unpack(packed: bytes) -> bytes:
    with lzma.open(io.BytesIO(packed)) as file:
        unpacked = file.read(LARGEST + 1)
    if len(unpacked) > LARGEST:
        raise UnusableFile(f"has more than {LARGEST} bytes unpacked: unpack it first, if you trust it")
    return unpacked


def case_of(fields: Fields, meshes: Meshes | None = None) -> Case:
    """Make the case that a file describes.

    Args:
        fields: The fields of the case.
        meshes: Those that other cases of the file have read; what this one reads is added.

    Raises:
        UnusableFile: if something is missing or contradicts something else.
    """
    try:
        return _case(fields, {} if meshes is None else meshes)
    except KeyError as error:
        raise UnusableFile(f"{error.args[0]!r} is missing") from None
    except (TypeError, AttributeError, IndexError, RuntimeError, ValueError, ElementTree.ParseError) as error:
        raise UnusableFile(f"it can't be used: {error}") from None


def _case(fields: Fields, meshes: Meshes) -> Case:
    if any(fields.get("anchor", ())):
        fields = _move_to_anchor(fields, np.array(fields["anchor"], float))
    model, geometry, laws = _robot(fields["robot"], meshes)
    spread, offset, turning, turned, columns = _local(model, fields, laws)
    motion = _motion(fields["motion"], len(columns))
    lower, upper, unlimited = _position_limits(model, spread, fields.get("without_limits", ()))
    unknown = ["obstacles that move, along a path without times"] if motion["times"] is None and _moves(fields) else []
    bodies = [*_links(model, geometry, fields["parts"]), *_objects(model, fields, unknown)]
    return Case(
        model=model,
        spread=spread,
        offset=offset,
        turning=turning,
        turned=turned,
        bodies=bodies,
        constraints=[*_constraints(model, fields.get("path_constraints", ()), unknown)],
        rows=[model.names[i] for i in range(1, model.njoints) for _ in range(model.joints[i].nv)],
        columns=columns,
        **motion,
        lower=lower,
        upper=upper,
        rates=_rates(columns, fields["limits"]),
        clearance=float(fields["min_clearance"]),
        left_out=[*_left_out(fields["left_out"], bodies), *unlimited],
        unknown=unknown,
    )


def _move_to_anchor(fields: Fields, anchor: np.ndarray) -> Fields:
    """Return a case relative to a point of the world (3,) [m], because far from the origin rounding would count."""

    def nearer(one: Fields) -> Fields:
        if moves := one.get("trajectory"):
            return {**one, "trajectory": {**moves, "placements": [*map(nearer, moves["placements"])]}}
        kind = one.get("type", "")
        if kind == "half_space":
            return {**one, "offset": one["offset"] - np.array(one["normal"], float) @ anchor}
        own = "point" if "point" in one else "position"
        field = {"polygon": "vertices", "point_cloud": "points"}.get(kind, own)
        points = points_of(one.get(field, (0.0, 0.0, 0.0))) - anchor
        return {**one, field: points if kind in ("polygon", "point_cloud") else points[0]}

    moved = {key: [*map(nearer, fields.get(key, ()))] for key in ("obstacles", "path_constraints")}
    return {**fields, **moved, "robot": {**fields["robot"], "placement": nearer(fields["robot"].get("placement", {}))}}


def _robot(fields: Fields, read_meshes: Meshes) -> tuple[Any, Any, dict[str, tuple[str, float, float]]]:
    """Return Pinocchio's model and collision geometry; of each mimic joint its source, multiplier and offset."""
    root = ElementTree.fromstring(fields["urdf"])  # noqa: S314 - who judges a file has chosen it
    laws = {
        joint.get("name", ""): (law.get("joint", ""), float(law.get("multiplier", 1)), float(law.get("offset", 0)))
        for joint in root.findall("joint")
        for law in joint.findall("mimic")[:1]
        if joint.get("type") != "fixed"
    }
    normals = {
        joint.get("name", ""): np.array((axis.get("xyz", "") if axis is not None else "1 0 0").split(), float)
        for joint in root.findall("joint")
        for axis in (joint.find("axis"),)
        if joint.get("type") == "planar"
    }
    meshes = _meshes(root, fields.get("mesh_files", {}), read_meshes)
    own_names = _rename(root)
    text, joint = ElementTree.tostring(root, "unicode"), ROOTS[fields.get("root_joint", "fixed")]
    model = pin.buildModelFromXML(text) if joint is None else pin.buildModelFromXML(text, joint())
    geometry = pin.GeometryModel()
    pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION, geometry, [])
    for index in range(1, model.njoints):
        model.names[index] = own_names.get(model.names[index], model.names[index])
        if model.names[index] in normals and model.joints[index].nq == 4:
            _tilt(model, geometry, index, normals[model.names[index]])
    for frame in model.frames:
        frame.name = own_names.get(frame.name, frame.name)
    for one in geometry.geometryObjects:
        link, _, number = one.name.rpartition("_")
        one.name = f"{own_names[link]}_{number}"
        if one.name in meshes:
            corners = meshes[one.name].reshape(-1, 3)
            one.geometry = surface(corners, np.arange(len(corners)).reshape(-1, 3))
    base = placement_of(fields.get("placement", {}))
    for i in range(1, model.njoints):
        if model.parents[i] == 0:
            model.jointPlacements[i] = base * model.jointPlacements[i]
    for one in (*list(model.frames)[1:], *geometry.geometryObjects):
        if one.parentJoint == 0:
            one.placement = base * one.placement
    return model, geometry, laws


def _meshes(root: Any, files: Fields, known: Meshes) -> dict[str, np.ndarray]:
    """Return triangles (t, 3, 3) [m] of each collision mesh, by the shape's name; in the URDF a ball replaces it."""
    contents, found = {name: base64.b64decode(content) for name, content in files.items()}, {}
    for link in root.iter("link"):
        for number, collision in enumerate(link.findall("collision")):
            geometry = collision.find("geometry")
            for mesh in [] if geometry is None else geometry.findall("mesh"):
                name = mesh.get("filename", "")
                if name not in files:
                    raise UnusableFile(f"`mesh_files` has no {name!r}")
                found[f"{link.get('name')}_{number}"] = name, np.array(mesh.get("scale", "1 1 1").split(), float)
                geometry.remove(mesh)
                ElementTree.SubElement(geometry, "sphere", radius="1")

    def read_one(name: str) -> np.ndarray:
        folder = name.partition("/")[0] + "/"
        key = name, tuple(one for one in contents.items() if one[0] == name or one[0].startswith(folder))
        if key not in known:
            known[key] = _triangles(*key)
        return known[key]

    names = list(dict.fromkeys(name for name, _ in found.values()))
    with ThreadPoolExecutor(os.cpu_count()) as pool:  # each waits for a process
        triangles = dict(zip(names, pool.map(read_one, names), strict=True))
    turned = {name: triangles[name][:, ::-1] for name in names}
    return {one: scale * (turned if scale.prod() < 0.0 else triangles)[name] for one, (name, scale) in found.items()}


def _triangles(name: str, files: tuple[tuple[str, bytes], ...]) -> np.ndarray:
    """Read triangles (t, 3, 3) of a mesh file, among files that it may refer to, with their contents."""
    with tempfile.TemporaryDirectory() as folder:
        for path, content in ((Path(folder, one), content) for one, content in files):
            if not path.resolve().is_relative_to(Path(folder).resolve()):
                raise UnusableFile(f"`mesh_files` has {path.name!r} outside its folder")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        try:
            return read_mesh_file(Path(folder, name))
        except UnreadableMesh as error:
            raise UnusableFile(f"mesh {name!r}: {error}") from None


def _rename(root: ElementTree.Element) -> dict[str, str]:
    """Number links and joints, in the order of their names: Pinocchio mistakes some names for its own.

    Returns:
        The name that each had, by the one that it has now.
    """
    names: dict[str, dict[str, str]] = {}
    for kind in ("link", "joint"):
        said = sorted((one.get("name", "") for one in root.findall(kind)), key=str.encode)
        names[kind] = {name: f"{kind}:{number:06}" for number, name in enumerate(said)}
        for one in root.findall(kind):
            one.set("name", names[kind][one.get("name", "")])
    for joint in root.findall("joint"):
        for end in (*joint.findall("parent"), *joint.findall("child")):
            end.set("link", names["link"][end.get("link", "")])
        for law in joint.findall("mimic"):
            joint.remove(law)  # they are kept by `laws`
    return {number: name for named in names.values() for name, number in named.items()}


def _tilt(model: Any, geometry: Any, index: int, normal: np.ndarray) -> None:
    """Have a planar joint slide across a normal and turn about it; Pinocchio's does so with z, whatever the URDF says.

    The first direction is x less its part along the normal, that of y where the normal has more than 0.9 of x.
    """
    z = normal / np.linalg.norm(normal)
    x = np.array([1.0, 0, 0]) if abs(z[0]) <= 0.9 else np.array([0, 1.0, 0])
    x = _unit(x - np.dot(x, z) * z)
    tilt = pin.SE3(np.array([x, np.cross(z, x), z]).T, np.zeros(3))
    model.jointPlacements[index] = model.jointPlacements[index] * tilt
    for child in range(1, model.njoints):
        if model.parents[child] == index:
            model.jointPlacements[child] = tilt.inverse() * model.jointPlacements[child]
    for one in (*model.frames, *geometry.geometryObjects):
        if one.parentJoint == index:
            one.placement = tilt.inverse() * one.placement


def _local(model: Any, fields: Fields, laws: Mapping[str, tuple[str, float, float]]) -> tuple[Any, ...]:
    """Return `spread`, `offset`, `turning`, `turned` and `columns` of a case."""
    balls, planned, reference = fields["robot"].get("ball_joints", ()), fields["motion"]["joints"], fields["reference"]
    joints = {name: model.joints[i] for i, name in enumerate(model.names) if i}
    free = {name: [*range(3 if name in balls else 0, joint.nv)] for name, joint in joints.items()}
    columns = [name for name in planned for _ in free[name]]
    spread, offset = np.zeros((model.nv, len(columns))), np.zeros(model.nv)
    turning, turned, column = np.zeros(model.nv, bool), np.zeros(model.nv), 0
    for name, joint in joints.items():
        rows = joint.idx_v + np.arange(joint.nv)
        value = np.array(reference.get(name, 0.0), float).reshape(-1)
        if joint.nv == 6:
            turning[rows[3:]], offset[rows[:3]] = True, 0.0 if name in balls else value[:3]
            turned[rows[3:]] = pin.log3(pin.Quaternion(value[-4:]).normalized().matrix())
        elif name not in laws:
            turning[rows[2:]], offset[rows] = True, value
    for name in planned:
        rows = joints[name].idx_v + np.array(free[name])
        spread[rows, column : column + len(rows)], offset[rows] = np.eye(len(rows)), 0.0
        column += len(rows)
    for name in laws:
        source, multiplier, shift = laws[name]
        followed = {name}
        while source in laws:
            if source in followed:
                raise UnusableFile(f"joint {name!r} follows {source!r}, which follows itself")
            followed.add(source)
            source, other, more = laws[source]
            multiplier, shift = multiplier * other, multiplier * more + shift
        if joints[name].nv != 1 or joints[source].nv != 1:
            raise UnusableFile(f"joint {name!r} follows, or is followed, and has several freedoms")
        row, other_row = joints[name].idx_v, joints[source].idx_v
        spread[row], offset[row] = multiplier * spread[other_row], multiplier * offset[other_row] + shift
    return spread, offset, turning, turned, columns


def _motion(fields: Fields, columns: int) -> dict[str, Any]:
    arrays = {
        kind: None if fields.get(kind) is None else np.array(fields[kind], float)
        for kind in ("positions", "times", "velocities", "accelerations", "tolerance")
    }
    positions, times, velocities, accelerations, tolerance = arrays.values()
    if positions is None or not len(positions) or positions.shape[1:] != (columns,):
        raise UnusableFile(f"`motion.positions` needs rows of {columns} numbers, as its joints have")
    if times is not None and (times.shape != positions.shape[:1] or not (np.diff(times) > 0.0).all()):
        raise UnusableFile("`motion.times` must increase, one for each position")
    if velocities is not None and (times is None or velocities.shape != positions.shape):
        raise UnusableFile("`motion.velocities` must be as many as positions, which need times then")
    if accelerations is not None and (velocities is None or accelerations.shape != positions.shape):
        raise UnusableFile("`motion.accelerations` must be as many as positions, which need velocities then")
    if not isinstance(steps := fields.get("steps", False), bool) or (
        steps and (times is None or velocities is not None)
    ):
        raise UnusableFile("`motion.steps` must be true or false; steps need times, and have no velocities")
    if tolerance is not None and (tolerance.shape != (columns,) or (tolerance < 0.0).any()):
        raise UnusableFile(f"`motion.tolerance` needs {columns} numbers, as its joints have, none of them negative")
    if not all(np.isfinite(some).all() for some in arrays.values() if some is not None):
        raise UnusableFile("`motion` must have finite numbers")
    if len(positions) == 1:  # a motion that goes nowhere, for a moment
        positions, velocities, accelerations = np.repeat(positions, 2, axis=0), None, None
        times = None if times is None else np.array([times[0], times[0] + MOMENT])
    return {
        "times": times,
        "positions": positions,
        "velocities": velocities,
        "accelerations": accelerations,
        "steps": steps,
        "tolerance": np.zeros(columns) if tolerance is None else tolerance,
    }


def _position_limits(model: Any, spread: np.ndarray, without: Sequence[str]) -> tuple[Any, Any, list[Any]]:
    """Return the URDF's limits of joints that move, and which of them the file says aren't kept."""
    lower, upper, unlimited = np.full(model.nv, -np.inf), np.full(model.nv, np.inf), []
    for name, joint in zip(model.names[1:], list(model.joints)[1:], strict=True):
        row = joint.idx_v
        if (joint.nq, joint.nv) == (1, 1) and spread[row].any():
            if name in without:
                unlimited.append((name, "its position limits", "the file says that they aren't kept"))
            else:
                lower[row], upper[row] = model.lowerPositionLimit[joint.idx_q], model.upperPositionLimit[joint.idx_q]
    return lower, upper, unlimited


def _rates(columns: Sequence[str], limits: Fields) -> np.ndarray:
    rates = np.full((3, len(columns)), np.inf)
    for row, kind in enumerate(("velocity", "acceleration", "jerk")):
        for name in dict.fromkeys(columns):
            if (limit := limits[name][kind]) is not None:
                rates[row, [column == name for column in columns]] = limit
    return rates


def _body(name: str, joint: int, placement: Any, one: Shape, parts: Fields, *, obstacle: bool, **more: Any) -> Body:
    divided = parts.get(more.pop("key", name), {})
    shell = NO_TRIANGLES
    if "shell" in divided:
        points = np.array(divided["shell"]["vertices"], float) + 0.0
        shell = (points if obstacle else snap_to_corners(points, one.triangles))[
            np.array(divided["shell"]["triangles"], int)
        ]
    return Body(
        name=name,
        joint=joint,
        placement=placement * one.placement,
        exact=one.exact,
        rounding=one.rounding,
        corners=one.corners,
        parts=[hull(np.array(points, float)) for points in divided.get("hulls", ())],
        triangles=one.triangles,
        shell=shell,
        points=one.points,
        obstacle=obstacle,
        **more,
    )


def _links(model: Any, geometry: Any, parts: Fields) -> Iterator[Body]:
    for one in geometry.geometryObjects:
        link, own = model.frames[one.parentFrame].name, shape(one.geometry, pin.SE3.Identity())
        yield _body(link, one.parentJoint, one.placement, own, parts["links"], key=one.name, obstacle=False)


def _moves(fields: Fields) -> bool:
    return any(one.get("trajectory") for one in fields["obstacles"])


def _objects(model: Any, fields: Fields, unknown: list[str]) -> Iterator[Body]:
    parts = fields["parts"]["objects"]
    for held in fields.get("held", ()):
        divided = parts.get(held["obstacle"]["name"], {}).get("triangles")
        one, frame = shape_of(held["obstacle"], divided), model.frames[_body_frame(model, held["link"])]
        if one is None:
            unknown.append(f"held {held['obstacle']['name']!r} of type {held['obstacle']['type']!r}")
        else:
            placement = frame.placement * placement_of(held.get("placement", {}))
            yield _body(held["obstacle"]["name"], frame.parentJoint, placement, one, parts, obstacle=False)
    for obstacle in fields["obstacles"]:
        one = shape_of(obstacle, parts.get(obstacle["name"], {}).get("triangles"))
        moves = obstacle.get("trajectory")
        if one is None:
            unknown.append(f"obstacle {obstacle['name']!r} of type {obstacle['type']!r}, as it is declared")
            continue
        screw = _screw(moves) if moves else None  # its placements take the place of its own
        own = pin.SE3.Identity() if screw is None else one.placement.inverse()
        yield _body(obstacle["name"], 0, own, one, parts, obstacle=True, screw=screw)


def _screw(trajectory: Fields) -> Screw:
    """Build the motion of placements at times; a single one counts twice."""
    stops, times = [placement_of(stop) for stop in trajectory["placements"]], list(map(float, trajectory["times"]))
    if len(times) == 1:
        stops, times = stops * 2, [times[0], times[0] + 1.0]
    if len(stops) != len(times) or min(np.diff(times)) <= 0.0:
        raise UnusableFile("a `trajectory` needs as many placements as times, which must increase")
    steps = [pin.log6(a.actInv(b)).vector for a, b in itertools.pairwise(stops)]
    return Screw(np.array(times), stops, np.array(steps) / np.diff(times)[:, None])


def _body_frame(model: Any, link: str) -> int:
    index: int = model.getFrameId(link, pin.FrameType.BODY)
    if index >= model.nframes:
        raise UnusableFile(f"the robot has no link {link!r}")
    return index


def _constraints(model: Any, declarations: Sequence[Fields], unknown: list[str]) -> Iterator[Constraint]:
    for one in declarations:
        kind, name = one["type"], one["frame"]
        if kind not in ("orientation_cone", "plane", "line"):
            unknown.append(f"a path constraint of type {kind!r}")
            continue
        named = [k for k in range(1, model.nframes) if model.frames[k].name == name]
        index = next((k for k in named if model.frames[k].type == pin.FrameType.BODY), named[0] if named else None)
        if index is None:
            raise UnusableFile(f"the robot has no frame {name!r}")
        nothing, across = np.zeros(3), np.empty((0, 3))
        if kind == "plane":
            across = _unit(one["normal"])[None]
        if kind == "line":
            across = np.linalg.svd(_unit(one["direction"])[None])[2][1:]
        cone = not len(across)
        yield Constraint(
            name=f"{kind} of {name}",
            joint=model.frames[index].parentJoint,
            placement=model.frames[index].placement,
            limit=float(one["half_angle" if cone else "tolerance"]),
            axis=_unit(one["axis"]) if cone else nothing,
            target=_unit(one["target_axis"]) if cone else nothing,
            point=nothing if cone else np.array(one["point"], float),
            across=across,
            corners=np.zeros((8, 3)),
        )


def _unit(vector: Sequence[float]) -> np.ndarray:
    unit: np.ndarray = np.array(vector, float) / np.linalg.norm(vector)
    return unit


def _left_out(pairs: Sequence[Sequence[str]], bodies: Sequence[Body]) -> list[tuple[str, str, str]]:
    names = {body.name for body in bodies}
    for first, second, _ in pairs:
        for name in (first, second):
            if name not in names:
                raise UnusableFile(f"`left_out` names {name!r}, which has no body")
    return [(first, second, why) for first, second, why in pairs]
