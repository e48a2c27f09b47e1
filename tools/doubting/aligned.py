"""Motions with exact symmetries: arms whose angles add up to nought, bodies that stand upright beside others that do.

An arm turns about parallel axes and one across them, by multiples of pi/2 or so that they cancel, and carries or holds
a body of any primitive. Beside it stands another body of any kind, turned alike, so that both are a chosen gap apart
along an axis; half of them are in contact from the start. The motion turns or slides about that axis or across it, so
that the gap stays or changes evenly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull
from tests.robot.odd_meshes import stl

from doubting import scenery
from doubting.loaded import Loaded, as_values
from doubting.meshes import outward, triangles_of
from doubting.robots import FOLDER, Robot
from guidefield.messages import scene as messages
from guidefield.messages.requests import AttachedObject, CertifyRequest, GivenTrajectory
from guidefield.messages.values import Placement

BODIES = ("box", "sphere", "cylinder", "capsule", "mesh")
"""Bodies of links and held objects; meshes are boxes and even prisms."""
KINDS = ("box", "sphere", "cylinder", "capsule", "mesh", "polygon", "half_space", "cloud")
"""Kinds of obstacles."""
SIZES = (0.01, 0.033, 0.05, 0.1, 0.12, 0.3)
LINK = 0.3
"""Length of a link [m]."""
STEP = 0.02
"""Length of a motion [rad or m]."""
DEPTHS = (1e-4, 5e-4, 1e-3, 3e-3, 6e-3, 1.25e-2)
"""Gaps and depths [m]."""
WITHIN = 3.1
"""Joints turn by at most this, so that they keep their limits [rad]."""
TRIES = 4

Rng = np.random.Generator


@dataclass(frozen=True, eq=False)
class Aligned:
    """A motion that is asked about.

    Attributes:
        kind: What stands beside what.
        request: The question.
    """

    kind: str
    request: CertifyRequest


def arm(rng: Rng) -> Robot:
    """An arm: one joint about the vertical, three about an axis across it, one about the last link, one that slides."""
    kind, meshes = str(rng.choice(BODIES)), {}
    shape, text = _geometry(rng, kind, meshes), '<robot name="aligned" version="1.1"><link name="w"/>'
    at_origin = rng.random() < 0.5
    x, z = (0.05 * int(one) for one in rng.integers(-2, 3, 2))
    origin = "" if at_origin else f'<origin xyz="{x} 0 {z}"/>'
    parent = "w"
    for index, (joint, axis, x) in enumerate(_JOINTS):
        last = index == len(_JOINTS) - 1
        body = f"<collision>{origin}<geometry>{shape}</geometry></collision>" if last else ""
        text += (
            f'<link name="l{index}">{body}</link><joint name="j{index}" type="{joint}"><parent link="{parent}"/>'
            f'<child link="l{index}"/><origin xyz="{x} 0 0"/><axis xyz="{axis}"/>'
            '<limit lower="-3.2" upper="3.2" velocity="2" effort="1"/></joint>'
        )
        parent = f"l{index}"
    return Robot(text=f"{text}</robot>", meshes=meshes)


_JOINTS = (
    ("revolute", "0 0 1", 0.0),
    ("revolute", "0 1 0", LINK),
    ("revolute", "0 1 0", LINK),
    ("revolute", "0 1 0", LINK),
    ("revolute", "0 0 1", 0.0),
    ("prismatic", "0 0 1", 0.0),
)


def _geometry(rng: Rng, kind: str, meshes: dict[str, bytes]) -> str:
    a, b, c = (float(rng.choice(SIZES)) for _ in range(3))
    if kind == "box":
        return f'<box size="{a} {b} {c}"/>'
    if kind == "sphere":
        return f'<sphere radius="{0.5 * a}"/>'
    if kind == "mesh":
        vertices, triangles = _solid(rng, a, b, c)
        meshes["body.stl"] = stl(triangles_of(vertices, triangles))
        return f'<mesh filename="{FOLDER}body.stl"/>'
    return f'<{kind} radius="{0.5 * a}" length="{b}"/>'


def _solid(rng: Rng, a: float, b: float, c: float) -> tuple[np.ndarray, np.ndarray]:
    """A box, or an even prism, along z."""
    count = int(rng.choice([4, 6, 12]))
    turns = 2.0 * np.pi * (np.arange(count) + 0.5) / count
    outline = np.column_stack([a * np.cos(turns), (a if count > 4 else b) * np.sin(turns)]) * 0.5
    points = np.array([[*one, z] for z in (-0.5 * c, 0.5 * c) for one in outline])
    return outward(points, ConvexHull(points).simplices)


def draw_motion(rng: Rng, loaded: Loaded) -> Aligned | None:
    """A motion of the arm beside another body; None where the gap couldn't be had."""
    start = _standing(rng)
    attached = [_held(rng)] if rng.random() < 0.35 else []
    judge = loaded.judge(frozenset(start), attached=attached)
    frame = judge.frame_at(as_values(start), "l5")
    kind = str(rng.choice(KINDS))
    gap = float(rng.choice(DEPTHS)) * float(rng.choice([1.0, -1.0]))
    side = frame.rotation[:, rng.integers(3)] * rng.choice([-1.0, 1.0])
    one = _beside(rng, kind, frame, side)
    for _ in range(TRIES):
        among = loaded.judge(frozenset(start), obstacles=[one], attached=attached)
        margin, away, pair = scenery.find_closest(among, as_values(start))
        if pair < 0 or not np.isfinite(margin) or not np.isfinite(away).all():
            return None
        if abs(margin - gap) < 1e-9:
            break
        if margin <= 0.0 and not away.any():
            return None
        length = float(np.linalg.norm(away))
        one = scenery.shift(one, _snapped(away / max(length, 1e-9), frame.rotation) * (margin - gap))
    request = _motion(rng, loaded, start, one, attached)
    return Aligned(f"{kind}{' held' if attached else ''}", request)


def _standing(rng: Rng) -> dict[str, float]:
    """Angles that cancel, or multiples of pi/2; the wrist's sum is what turns the body upright, or on its side."""
    a, b = rng.uniform(-0.6, 0.6, 2)
    total = float(rng.choice([0.0, 0.0, 0.0, 0.5, -0.5])) * np.pi
    first = float(rng.choice([0.0, 0.5, -0.5])) * np.pi if rng.random() < 0.4 else float(rng.uniform(-3.0, 3.0))
    roll = float(rng.choice([0.0, 0.0, 0.5, -0.5])) * np.pi
    if rng.random() < 0.2:
        a, b = (float(rng.choice([0.0, 0.5, -0.5])) * np.pi for _ in range(2))
    found = {"j0": first, "j1": float(a), "j2": float(b), "j3": float(total - a - b), "j4": roll, "j5": 0.0}
    return found if abs(found["j3"]) < WITHIN else _standing(rng)


def _held(rng: Rng) -> AttachedObject:
    """Something that the last link holds, turned by multiples of pi/2 or as it comes out of an inverse matrix."""
    kind = str(rng.choice(BODIES))
    turn = pin.rpy.rpyToMatrix(*(rng.integers(-2, 3, 3) * (np.pi / 2.0)))
    quaternion = pin.Quaternion(turn).coeffs() if rng.random() < 0.5 else np.array([0.0, 0.0, 0.0, 1.0])
    place = Placement((0.0, 0.0, 0.1), tuple(quaternion.tolist()))
    return AttachedObject(obstacle=_plain(rng, kind, "held", np.zeros(3)), link="l5", placement=place)


def _plain(rng: Rng, kind: str, name: str, at: np.ndarray, quaternion: Sequence[float] = (0.0, 0.0, 0.0, 1.0)) -> Any:
    """A body of even sizes about a place [m, world]."""
    a, b, c = (float(rng.choice(SIZES)) for _ in range(3))
    place: dict[str, Any] = {"name": name, "position": tuple(at.tolist()), "quaternion_xyzw": tuple(quaternion)}
    if kind == "mesh":
        vertices, triangles = _solid(rng, 3.0 * a, 3.0 * b, c)
        return messages.Mesh(
            vertices=[tuple(v) for v in vertices.tolist()], triangles=[tuple(t) for t in triangles.tolist()], **place
        )
    size = (a if kind == "sphere" else 4.0 * a, 4.0 * b, c)
    return scenery.primitive(kind, size, a, b, **place)


def _beside(rng: Rng, kind: str, frame: Any, side: np.ndarray) -> Any:
    """An obstacle of a kind beside a frame, its axes along the frame's."""
    at = frame.translation + 0.3 * side + float(rng.choice([0.0, 0.01])) * frame.rotation @ rng.choice([0.0, 1.0], 3)
    if kind == "half_space":
        return messages.HalfSpace(name="o", normal=tuple((-side).tolist()), offset=float(-side @ at))
    axes = frame.rotation @ pin.rpy.rpyToMatrix(*(rng.integers(-2, 3, 3) * (np.pi / 2.0)))
    if kind == "polygon":
        first = frame.rotation[:, int(np.argmin(np.abs(frame.rotation.T @ side)))]
        across = np.cross(side, first)
        signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
        corners = [at + 0.2 * (s * first + t * across) for s, t in signs]
        return messages.Polygon(name="o", vertices=[tuple(one.tolist()) for one in corners])
    if kind == "cloud":
        first = frame.rotation[:, int(np.argmin(np.abs(frame.rotation.T @ side)))]
        points = [at + 0.02 * k * first for k in range(-2, 3)]
        return messages.PointCloud(name="o", points=[tuple(one.tolist()) for one in points], radius=0.01)
    return _plain(rng, kind, "o", at, pin.Quaternion(axes).coeffs().tolist())


def _snapped(away: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """A direction, along an axis where it nearly is: what Coal tells is so up to rounding alone."""
    along = axes.T @ away
    k = int(np.argmax(np.abs(along)))
    return np.sign(along[k]) * axes[:, k] if abs(along[k]) > 1.0 - 1e-9 else away


def _motion(
    rng: Rng, loaded: Loaded, start: dict[str, float], one: Any, attached: list[AttachedObject]
) -> CertifyRequest:
    """A short motion of one joint, or two that cancel; at times in time beside what moves along."""
    rows = [dict(start), dict(start)]
    which = str(rng.choice(["j0", "j4", "j5", "j1", "cancel"]))
    step = STEP * float(rng.choice([1.0, -1.0, 0.05]))
    for joint, by in {"cancel": {"j1": step, "j3": -step}}.get(which, {which: step}).items():
        rows[1][joint] = rows[0][joint] + by
    names = sorted({name for name in start if rows[0][name] != rows[1][name]})
    positions = [[row[name] for name in names] for row in rows]
    more: dict[str, Any] = {"path": positions}
    rests = isinstance(one, messages.HalfSpace | messages.Polygon | messages.PointCloud)
    if not rests and rng.random() < 0.15:
        by = float(rng.choice([0.0, 1e-3])) * rng.choice([-1.0, 0.0, 1.0], 3)
        turned = getattr(one, "quaternion_xyzw", (0.0, 0.0, 0.0, 1.0))
        ends = [Placement(one.position, turned), Placement(tuple((np.array(one.position) + by).tolist()), turned)]
        plain = {"position": (0.0, 0.0, 0.0), "quaternion_xyzw": (0.0, 0.0, 0.0, 1.0)}
        own = {name: value for name, value in plain.items() if hasattr(one, name)}
        one = msgspec.structs.replace(one, trajectory=messages.ObstacleTrajectory([0.0, 1.0], ends), **own)
        more = {"trajectory": GivenTrajectory(positions, [0.0, 1.0])}
    return CertifyRequest(
        loaded.reference,
        messages.Scene(name="aligned", obstacles=[one]),
        start=start,
        position_names=names,
        attached_objects=attached,
        min_clearance=float(rng.choice([0.0, 0.0, 0.0, 1e-3])),
        recording="off",
        **more,
    )
