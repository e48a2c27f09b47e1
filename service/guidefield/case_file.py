"""Write motions as plain files for the referee, and with their proofs (referee.md).

Fields of a case are those that `referee/loading.py` reads and service/docs/referee.md lists: a change of their meaning
needs a new `FORMAT`. Arrays of proofs are named "k/field": k is a motion's number, fields are those of `Proof` in
`referee/proof.py`, which reads them.
"""

from __future__ import annotations

import base64
import contextlib
import dataclasses
import io
import json
import lzma
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import coal
import msgspec
import numpy as np
from lxml import etree

from guidefield.collision.world import World
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.geometry.closed import boundary, compact
from guidefield.geometry.convex import convex_hull
from guidefield.geometry.mesh_surface import mesh_surface
from guidefield.memo import memoized
from guidefield.messages.conditions import AttachedObject, PathConstraint
from guidefield.messages.scene import Mesh, Polygon
from guidefield.messages.values import ORIGIN, Placement
from guidefield.planner.motion.submitted_motion import SubmittedMotion
from guidefield.prove.curve import Curve
from guidefield.prove.proof import Proof, prove
from guidefield.prove.search import SearchQuery
from guidefield.prove.verdict import Reason
from guidefield.referee.proof import FORMATS, digest
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.mesh_files.reading import companions, plain_file, read_mesh
from guidefield.robot.model.collision_shapes import hull
from guidefield.robot.model.configuration import configuration_to_wire
from guidefield.robot.model.joints import JointKind
from guidefield.robot.model.model import RobotModel, RobotSource
from guidefield.robot.urdf import xml
from guidefield.scene import obstacle
from guidefield.scene.anchor import Anchor
from guidefield.whole_file import write_whole

FORMAT = "guidefield cases 2"  # one of `FORMATS` of `referee/loading.py`


@dataclasses.dataclass(frozen=True, eq=False)
class Motion:
    """A certified motion: straight between its knots, cubic where it has velocities, of degree 5 with accelerations."""

    world: World  # the robot with its held objects, the obstacles, and the tested pairs
    placement: Placement  # of the robot's root in the world
    held: Sequence[AttachedObject]  # held objects, as declared
    times: np.ndarray | None  # of the knots, shape (k,) [s]; None for a path of straight lines in local coordinates
    positions: np.ndarray  # local coordinates, shape (k, nv) [rad or m]
    velocities: np.ndarray | None = None  # of the local coordinates, shape (k, nv); None for straight lines
    accelerations: np.ndarray | None = None  # the same; None of other motions than those of degree 5
    steps: bool = False  # whether every joint may be anywhere between two knots
    tolerance: np.ndarray | None = None  # how far each coordinate may be from that, shape (nv,); None: nothing
    jerk_limits: np.ndarray | None = None  # shape (nv,), infinite for none; None if jerk doesn't matter
    min_clearance: float = 0.0  # distance to keep from obstacles [m]
    path_constraints: Sequence[PathConstraint] = ()  # as declared
    touching: Sequence[tuple[str, str]] = ()  # pairs of names that aren't tested because they touch, and part
    limited: PlanningGroup | None = None  # the same joints with the limits that count; None: those of the world's group
    outside_proof: str = ""  # what is certified and no case or proof tells, for a warning: "the tip keeps its speed"
    anchor: Anchor | None = None  # to which its places are relative, in the case to the world; None: to the world, too


def write(path: Path, *motions: Motion) -> None:
    """Write motions to a file: JSON, compressed with xz if the name ends with it.

    Raises OSError if it can't be written, or a mesh of the robot can't be read any more.
    """
    text = json.dumps({"format": FORMAT, "cases": make_cases(*motions)}).encode()
    write_whole(path, lzma.compress(text, preset=1) if path.suffix == ".xz" else text)


def make_cases(*motions: Motion) -> list[dict[str, Any]]:
    """Return motions as plain values, as JSON has them; referee.md has the fields.

    Raises OSError if a mesh of the robot can't be read any more.
    """
    cases: list[dict[str, Any]] = []
    known: tuple[RobotSource, Placement, dict[str, Any]] | None = None
    for motion in motions:
        robot = motion.world.group.robot
        if known is None or known[:2] != (robot.source, motion.placement):
            placement = motion.placement if motion.anchor is None else motion.anchor.show_placement(motion.placement)
            known = robot.source, motion.placement, _describe_robot(robot, placement)
        cases.append(_make_case(motion, known[2]))
    return cases


def count_items(motion: Motion) -> int:
    """Return the number of obstacles, held objects, their triangles or points, and knots that a case has."""
    held = [obstacle.build(one.obstacle, index).faces for index, one in enumerate(motion.held)]
    scene = motion.world.scene
    return len(scene.obstacles) + scene.faces + len(held) + sum(held) + len(motion.positions)


def _make_case(motion: Motion, robot_fields: dict[str, Any]) -> dict[str, Any]:
    group, scene = motion.world.group, motion.world.scene
    robot = group.robot
    reference = configuration_to_wire(robot.joints, group.q_reference)
    obstacles, constraints, anchor = list(scene.message.obstacles), list(motion.path_constraints), motion.anchor
    if anchor is not None:
        obstacles, constraints = [*map(anchor.show, obstacles)], [*map(anchor.outward, constraints)]
    return {
        "format": FORMAT,
        "anchor": ORIGIN if anchor is None else anchor.place,
        "robot": robot_fields,
        "held": _to_plain(motion.held),
        "obstacles": _to_plain(obstacles),
        "reference": reference,
        "motion": {
            "joints": [joint.name for joint in group.joints],
            "times": None if motion.times is None else motion.times.tolist(),
            "positions": motion.positions.tolist(),
            "velocities": None if motion.velocities is None else motion.velocities.tolist(),
            "accelerations": None if motion.accelerations is None else motion.accelerations.tolist(),
            "steps": motion.steps,
            "tolerance": None if motion.tolerance is None else motion.tolerance.tolist(),
        },
        "limits": _list_limits(motion),
        "without_limits": _list_unlimited_joints(robot),
        "min_clearance": motion.min_clearance,
        "path_constraints": _to_plain(constraints),
        "left_out": _list_left_out_pairs(motion),
        "parts": {"links": _describe_links(robot), "objects": _describe_objects(motion)},
    }


def _to_plain(messages: Any) -> Any:
    return msgspec.json.decode(msgspec.json.encode(messages, enc_hook=np.generic.tolist))


def _describe_robot(robot: RobotModel, placement: Placement) -> dict[str, Any]:
    root, files = xml.parse(robot.source.urdf_text), {}
    for visual in list(root.iter("visual")):
        visual.getparent().remove(visual)
    names = {joint.get("name") for joint in root.iter("joint")}
    followed = {joint.name: joint.mimic for joint in robot.joints}
    for joint in root.findall("joint"):
        for mimic in joint.findall("mimic"):
            meant = followed.get(joint.get("name"))
            if meant is not None and mimic.get("joint") not in names:  # it lacks a prefix
                law = {"joint": meant.source, "multiplier": str(meant.multiplier), "offset": str(meant.offset)}
                mimic.attrib.update(law)
    folders: dict[str, str] = {}
    for mesh in root.iter("mesh"):
        path = Path(mesh.get("filename"))
        folder = folders.setdefault(str(path), f"{len(folders)}")
        own, content = plain_file(path)  # other readers go by the ending
        for name, data in ((own, content), *((name, (path.parent / name).read_bytes()) for name in companions(path))):
            files[f"{folder}/{name}"] = base64.b64encode(data).decode()
        mesh.set("filename", f"{folder}/{own}")
    return {
        "urdf": etree.tostring(root, encoding="unicode"),
        "root_joint": robot.source.root_joint,
        "placement": _to_plain(placement),
        "ball_joints": [joint.name for joint in robot.joints if joint.kind is JointKind.SPHERICAL],
        "mesh_files": files,
    }


def _list_limits(motion: Motion) -> dict[str, Any]:
    group = motion.world.group
    jerk = np.full(group.nv, np.inf) if motion.jerk_limits is None else motion.jerk_limits
    limits: dict[str, dict[str, Any]] = {}
    limited = motion.limited or group
    for joint in group.joints:
        at = slice(joint.idx_v, joint.idx_v + joint.nv)
        rates = {"velocity": limited.velocity_limits[at], "acceleration": limited.acceleration_limits[at]}
        rates["jerk"] = jerk[at]
        limits[joint.name] = {kind: some.tolist() if np.isfinite(some).all() else None for kind, some in rates.items()}
    return limits


def _list_unlimited_joints(robot: RobotModel) -> list[str]:
    """List the joints whose limits in the URDF aren't kept; a warning names them."""
    said = robot.model.upperPositionLimit
    return [
        joint.name
        for joint in robot.joints
        if joint.nq == 1 and np.isfinite(said[joint.idx_q]) and not np.isfinite(joint.upper[0])
    ]


def _list_left_out_pairs(motion: Motion) -> list[list[str]]:
    """List the uncertified pairs of names with reasons, except those that can't move relative to each other."""
    world, robot = motion.world, motion.world.group.robot
    names, links = world.body_names, world.pairs.links
    own, moving = set(map(tuple, world.pairs.own.tolist())), set(world.pairs.moving.tolist())
    left_out = {(body, links + obstacle) for body, obstacle in world.pairs.bodies_left_out().tolist()}
    reasons = {frozenset(one.links): one.reason for one in robot.pairs_left_out}
    for one in motion.held:
        for link in (one.link, *one.touch_links):
            reasons[frozenset((one.obstacle.name, link))] = "the link holds it, or may touch it"
    reasons |= {frozenset(pair): "they touch at the start, and part" for pair in motion.touching}
    joints = [shape.parentJoint for shape in world.group.geometry.geometryObjects]
    uncertified = {}
    for first in range(links):
        for second in range(first + 1, len(names)):
            rigid = joints[first] == (joints[second] if second < links else 0)
            pair = first, second
            if not rigid and (pair not in own if second < links else first not in moving or pair in left_out):
                uncertified[names[first], names[second]] = reasons.get(
                    frozenset((names[first], names[second])), "the request allows it"
                )
    return [[first, second, why] for (first, second), why in uncertified.items()]


@memoized
def _describe_links(robot: RobotModel) -> dict[str, Any]:
    """Describe collision shapes: the hull around a mesh, and the closed surface of an open one."""
    parts = {}
    for shape in robot.geometry.geometryObjects:
        if shape.meshPath and isinstance(shape.geometry, coal.Convex | coal.BVHModelBase):  # what is held has no path
            mesh = read_mesh(Path(shape.meshPath), shape.meshScale)
            around = hull(shape.geometry) if isinstance(shape.geometry, coal.BVHModelBase) else shape.geometry
            hulls = {} if around is None else {"hulls": [np.array(around.points()).tolist()]}
            parts[shape.name] = hulls | _describe_shell(mesh.vertices, mesh.triangles)
    return parts


def _describe_objects(motion: Motion) -> dict[str, Any]:
    held = [obstacle.build(one.obstacle, index) for index, one in enumerate(motion.held)]
    parts: dict[str, Any] = {}
    for one in (*held, *motion.world.scene.obstacles):
        if isinstance(one.message, Polygon):
            parts[one.name] = {"triangles": one.recipe.surface(one.message)[1].tolist()}
        if isinstance(one.message, Mesh):
            vertices, triangles = one.recipe.surface(one.message)
            closed = {"shell": _encode_surface(vertices, triangles)} if one.solid else {}
            with contextlib.suppress(ValueError):  # it is flat, or too fine for Coal
                around = np.array(one.shape.points()) if one.convex else convex_hull(vertices).vertices
                parts[one.name] = {"hulls": [around.tolist()]}
            parts[one.name] = parts.get(one.name, {}) | closed
    return parts


def _describe_shell(vertices: np.ndarray, triangles: np.ndarray) -> dict[str, Any]:
    """Return the closed surface of a mesh that is open, or whose triangles aren't oriented alike."""
    _, corners, _ = compact(vertices, triangles)
    if not len(boundary(corners)):
        return {}
    closed = mesh_surface(vertices, triangles)
    return {} if closed is None or not closed.solid else {"shell": _encode_surface(closed.vertices, closed.triangles)}


def _encode_surface(vertices: np.ndarray, triangles: np.ndarray) -> dict[str, Any]:
    return {"vertices": vertices.tolist(), "triangles": triangles.tolist()}


MOMENT = 1e-9  # time that a motion of one position takes [s]; must be that of `referee/loading.py`
SAMPLES = 33
"""Samples with which the search for the smallest distance along a motion begins.

Another number changes the time and the bits of proofs, not their truth.
"""
WRITING_S_PER_ITEM = 1.2e-5
"""Longest time to write an obstacle, triangle, point or knot [s]; measured: 11 us a box of 100,000, 2 us a triangle or
point of a million. A proof isn't begun to be written unless the remaining time is enough by it."""


class UnprovedError(Exception):
    """A motion has no proof, in words."""


def write_proof(path: Path, *motions: Motion) -> None:
    """Prove motions and write their proofs to a file.

    Raises:
        UnprovedError: if one isn't free.
        OSError: if it can't be written, or a mesh of the robot can't be read any more.
    """
    write_whole(path, proof_of(motions))


def proof_of(motions: Sequence[Motion], deadline: Deadline = UNLIMITED) -> bytes:
    """Prove motions; return the proofs as the content of a file.

    Nothing can interrupt the writing: where it would outlast the deadline, it isn't begun; raises UnprovedError if one
    isn't free, or the deadline is too early; raises OSError if a mesh of the robot can't be read any more.
    """
    writing, arrays = WRITING_S_PER_ITEM * sum(map(count_items, motions)), dict[str, np.ndarray]()
    for k, part in enumerate(motions):
        curve = curve_of(part)
        found, proof = prove(part.world, curve, _goal_of(part, curve), deadline)
        if found.verdict.reason is Reason.STOPPED or deadline.expired():
            raise UnprovedError("time was up before it was written down")
        if deadline.remaining() < writing:
            raise UnprovedError(f"to write it down takes about {writing:.2g} s, and time would be up before that")
        if proof is None:
            pair = "" if found.verdict.pair is None else f": {' and '.join(found.verdict.pair)}"
            raise UnprovedError(f"the motion isn't free{pair}")
        arrays |= {f"{k}/{name}": array for name, array in arrays_of(proof).items()}
    cases = make_cases(*motions)
    for one in cases[1:]:  # the referee takes a field that is left out from the first case
        for name in [name for name, value in one.items() if value == cases[0][name]]:
            del one[name]
    arrays["cases"] = np.frombuffer(msgspec.json.encode(cases), np.uint8)
    return pack_arrays(arrays)


def _goal_of(part: Motion, curve: Curve) -> SearchQuery:
    """Return the goal of a proof's search: smallest distances, too, unless the robot may be beside the curve."""
    if curve.tube is not None:
        return SearchQuery(part.min_clearance)
    span = float(curve.times[0]), float(curve.times[-1])
    return SearchQuery(part.min_clearance, spans=[span], samples=np.linspace(*span, SAMPLES))


def arrays_of(proof: Proof) -> dict[str, np.ndarray]:
    """Return the arrays of a proof by their names, of the shapes that `Proof` tells."""
    return {field.name: getattr(proof, field.name) for field in fields(proof)}


def pack_arrays(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Return the content of a proof file: arrays of any shape, its format and a digest of them all."""
    content = io.BytesIO()
    named: dict[str, Any] = {"format": np.array(FORMATS[0]), "digest": np.array(digest(arrays)), **arrays}
    np.savez_compressed(content, **named)
    return content.getvalue()


def curve_of(motion: Motion) -> Curve:
    """Return the curve through a motion's knots, with the tube about it that the robot may be in."""
    count = len(motion.positions)
    times = np.arange(float(count)) if motion.times is None else np.asarray(motion.times, float)
    rates = motion.velocities, motion.accelerations
    drawn = SubmittedMotion.through(times, motion.positions, *rates, motion.tolerance, steps=motion.steps)
    if count == 1:  # as the referee reads it
        times = np.append(times, times[0] + (1.0 if motion.times is None else MOMENT))
    return Curve(drawn.pieces, times, drawn.tube)
