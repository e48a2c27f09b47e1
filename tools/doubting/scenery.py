"""Random obstacles of every kind about a robot, at a chosen distance from where it stands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin

from doubting.curve import Values
from doubting.judge import Judge
from doubting.loaded import Loaded
from doubting.meshes import closed, convex, dented, ground
from guidefield.messages import scene as messages
from guidefield.messages.requests import AttachedObject
from guidefield.messages.values import Placement

KINDS = ("box", "sphere", "cylinder", "capsule", "mesh", "mesh", "cracked", "open", "polygon", "half_space", "cloud")
AWAY = 0.25
"""Distance from a link at which an obstacle is put, about [m]."""
THIN, LARGE, DISTANT = 0.15, 0.1, 0.08
"""Of so many obstacles a side is much shorter, so many are much larger, so many robots stand far from the origin."""
VAST = 0.08
"""So many scenes have uneven ground of which a robot meets a part."""
TRIES = 3
"""Number of times that an obstacle which is too close is pushed away."""


def random_rotation(rng: np.random.Generator) -> tuple[float, ...]:
    q = rng.normal(size=4)
    return tuple((q / np.linalg.norm(q)).tolist())


def obstacle(rng: np.random.Generator, kind: str, name: str, at: np.ndarray, size: float) -> messages.Obstacle:
    """One of a kind about a place [m, world]."""
    if rng.random() < LARGE:
        size *= float(10.0 ** rng.uniform(-1.5, 1.5))
    place: dict[str, Any] = {"name": name, "position": tuple(at.tolist()), "quaternion_xyzw": random_rotation(rng)}
    if kind in _MAKERS:
        return _MAKERS[kind](rng, at, size, place)
    vertices, triangles = closed(rng, 0.5 * size)
    if kind == "cracked":
        vertices, triangles = crack(rng, *dented(rng, *convex(rng, 0.5 * size)))
    if kind == "open":
        triangles = triangles[: max(1, int(0.7 * len(triangles)))]
    return messages.Mesh(
        vertices=[tuple(v) for v in vertices.tolist()], triangles=[tuple(t) for t in triangles.tolist()], **place
    )


def _primitive(rng: np.random.Generator, kind: str, size: float, place: dict[str, Any]) -> messages.Obstacle:
    """A box, or a round body."""
    extents = size * rng.uniform(0.3, 1.0, 3)
    if rng.random() < THIN:
        extents[rng.integers(3)] *= 10.0 ** rng.uniform(-4.0, 0.0)
    a, b, c = extents.tolist()
    return primitive(kind, (a, b, c), 0.4 * a, b, **place)


def primitive(kind: str, size: tuple[float, ...], radius: float, length: float, **place: Any) -> messages.Obstacle:
    """A box of a size, or a cylinder or capsule of a radius and length [m]; a ball is as wide as the box."""
    if kind == "box":
        return messages.Box(size=size, **place)
    if kind == "sphere":
        place.pop("quaternion_xyzw", None)
        return messages.Sphere(radius=0.5 * size[0], **place)
    return (messages.Cylinder if kind == "cylinder" else messages.Capsule)(radius=radius, length=length, **place)


def _polygon(rng: np.random.Generator, at: np.ndarray, size: float, place: dict[str, Any]) -> messages.Obstacle:
    """A convex polygon."""
    turns = np.sort(rng.uniform(0.0, 2.0 * np.pi, int(rng.integers(3, 7))))
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    corners = at + 0.5 * size * (np.cos(turns)[:, None] * axes[0] + np.sin(turns)[:, None] * axes[1])
    return messages.Polygon(name=place["name"], vertices=[tuple(one) for one in corners.tolist()])


def _half_space(rng: np.random.Generator, at: np.ndarray, _size: float, place: dict[str, Any]) -> messages.Obstacle:
    """All that is below a plane."""
    normal = rng.normal(size=3)
    return messages.HalfSpace(name=place["name"], normal=tuple(normal.tolist()), offset=float(normal @ at))


def _cloud(rng: np.random.Generator, at: np.ndarray, size: float, place: dict[str, Any]) -> messages.Obstacle:
    """Some points."""
    points = at + 0.4 * size * rng.normal(size=(int(rng.integers(3, 15)), 3))
    return messages.PointCloud(name=place["name"], points=[tuple(p) for p in points.tolist()], radius=0.01)


def _ground(rng: np.random.Generator, _at: np.ndarray, size: float, place: dict[str, Any]) -> messages.Obstacle:
    """Uneven ground, much larger than other obstacles."""
    vertices, triangles = ground(rng, 40.0 * size)
    return messages.Mesh(
        vertices=[tuple(v) for v in vertices.tolist()], triangles=[tuple(t) for t in triangles.tolist()], **place
    )


_MAKERS: dict[str, Callable[..., messages.Obstacle]] = {
    "polygon": _polygon,
    "half_space": _half_space,
    "cloud": _cloud,
    "ground": _ground,
    **{
        kind: lambda rng, _at, size, place, kind=kind: _primitive(rng, kind, size, place)
        for kind in ("box", "sphere", "cylinder", "capsule")
    },
}
"""The makers of obstacles by kind; all others are meshes."""


def crack(rng: np.random.Generator, vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each triangle has corners of its own, up to 0.3 mm off: a mesh full of cracks that are to be closed."""
    corners = vertices[triangles].reshape(-1, 3)
    return corners + rng.uniform(-1.5e-4, 1.5e-4, corners.shape), np.arange(len(corners)).reshape(-1, 3)


def shift(one: messages.Obstacle, by: np.ndarray) -> messages.Obstacle:
    """An obstacle moved by a vector [m, world]."""
    replaced = msgspec.structs.replace
    if one.trajectory is not None:
        placements = [
            Placement(tuple((np.array(p.position) + by).tolist()), p.quaternion_xyzw) for p in one.trajectory.placements
        ]
        return replaced(one, trajectory=messages.ObstacleTrajectory(one.trajectory.times, placements))
    if isinstance(one, messages.HalfSpace):
        return replaced(one, offset=one.offset + float(np.array(one.normal) @ by))
    if isinstance(one, messages.Polygon):
        return replaced(one, vertices=[tuple((np.array(v) + by).tolist()) for v in one.vertices])
    if isinstance(one, messages.PointCloud):
        return replaced(one, points=[tuple((np.array(v) + by).tolist()) for v in one.points])
    return replaced(one, position=tuple((np.array(one.position) + by).tolist()))


def make_fly(
    rng: np.random.Generator, one: messages.Obstacle, at: np.ndarray, by: float, seconds: float
) -> messages.Obstacle:
    """An obstacle that flies by a place, turning, within about a time."""
    times = _times(rng, seconds)
    placements = [Placement(tuple((at + by * rng.normal(size=3)).tolist()), random_rotation(rng)) for _ in times]
    return msgspec.structs.replace(one, trajectory=messages.ObstacleTrajectory(times, placements))


def make_sway(
    rng: np.random.Generator, one: messages.HalfSpace, around: np.ndarray, seconds: float
) -> messages.HalfSpace:
    """A half-space through the origin that leans and comes and goes behind some places (n, 3), within about a time."""
    normal = np.array(one.normal) / np.linalg.norm(one.normal)
    behind = around.mean(axis=0) + normal * (float((around @ normal).min()) - float(around.mean(axis=0) @ normal))
    times, placements = _times(rng, seconds), []
    for _ in times:
        leaning = pin.Quaternion(pin.exp3(0.15 * rng.normal(size=3))).coeffs()
        at = behind - float(rng.uniform(0.05, 0.5)) * normal
        placements.append(Placement(tuple(at.tolist()), tuple(leaning.tolist())))
    return msgspec.structs.replace(one, trajectory=messages.ObstacleTrajectory(times, placements))


def _times(rng: np.random.Generator, seconds: float) -> list[float]:
    """Return when something is at its two to four places, within about a time [s]."""
    count = int(rng.integers(2, 5))
    return (np.sort(rng.uniform(0.0, seconds, count)) + 0.05 * np.arange(count)).tolist()


def find_closest(judge: Judge, values: Values, obstacles_only: bool = True) -> tuple[float, np.ndarray, int]:
    """The least margin at values of the joints [m], the unit vector (3,) from obstacle to link there, and the pair."""
    distances = judge.distances_at(values) - judge.required
    chosen = np.flatnonzero(~judge.own) if obstacles_only else np.arange(len(distances))
    if not len(chosen):
        return np.inf, np.zeros(3), -1
    pair = int(chosen[np.argmin(distances[chosen])])
    return float(distances[pair]), judge.towards_first(pair), pair


def strew(
    rng: np.random.Generator,
    loaded: Loaded,
    planned: frozenset[str],
    ends: Sequence[Values],
    between: Values,
    count: int,
    **setting: Any,
) -> list[messages.Obstacle]:
    """Obstacles near where a robot goes that leave its ends some room, or hardly any.

    Args:
        rng: Randomness.
        loaded: The robot.
        planned: Joints that move.
        ends: Values at which nothing may be closer than is required.
        between: Values near which obstacles are put.
        count: How many.
        **setting: Placement, what is held, and the clearance asked for, as `Loaded.judge` takes it.
    """
    found: list[messages.Obstacle] = []
    where = loaded.judge(planned, **setting)
    where.distances_at(between)
    moving = where.moving_centres()
    if not len(moving):
        return found
    kinds = [str(rng.choice(KINDS)) for _ in range(count)]
    if count and rng.random() < VAST:
        kinds[0] = "ground"
    for index, kind in enumerate(kinds):
        at = moving[rng.integers(len(moving))] + AWAY * rng.normal(size=3)
        one = obstacle(rng, kind, f"o{index}", at, float(rng.uniform(0.05, 0.4)))
        near = rng.random() < 0.25
        room = float(10.0 ** rng.uniform(-5.0, -2.5)) if near else float(rng.uniform(2e-3, 5e-2))
        placed = push_apart(loaded, planned, ends, one, room, near, setting)
        if placed is not None:
            found.append(placed)
    return found


def push_apart(
    loaded: Loaded,
    planned: frozenset[str],
    ends: Sequence[Values],
    one: messages.Obstacle,
    room: float,
    exactly: bool,
    setting: dict[str, Any],
) -> messages.Obstacle | None:
    """An obstacle pushed until it leaves the ends some room [m], or exactly that; None where that doesn't help."""
    for _ in range(TRIES):
        judge = loaded.judge(planned, obstacles=[one], **setting)
        margin, away, pair = min((find_closest(judge, end) for end in ends), key=lambda found: found[0])
        if pair < 0 or (margin >= room * 0.999 and not (exactly and room * 1.01 < margin < 0.3)):
            return one
        if not np.isfinite(away).all() or not away.any():
            return None
        one = shift(one, away * (margin - room))
    return None


def draw_held(rng: np.random.Generator, link: str) -> AttachedObject:
    """Something that a link holds."""
    size = float(rng.uniform(0.03, 0.12))
    kind = str(rng.choice(["box", "sphere", "cylinder", "capsule", "mesh"]))
    shape = obstacle(rng, kind, "held", np.zeros(3), size)
    offset = 0.1 * rng.normal(size=3)
    return AttachedObject(
        obstacle=shape,
        link=link,
        placement=Placement(tuple(offset.tolist()), random_rotation(rng)),
    )


def placement(rng: np.random.Generator) -> Placement:
    """Return where a robot may stand."""
    if rng.random() < 0.7:
        return Placement()
    axis = pin.exp3(rng.normal(size=3))
    away = float(10.0 ** rng.uniform(0.0, 6.6)) if rng.random() < DISTANT / 0.3 else 1.0
    return Placement(
        tuple((away * rng.normal(size=3)).tolist()),
        tuple(pin.Quaternion(axis).coeffs().tolist()),
    )
