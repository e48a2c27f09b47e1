"""Read an obstacle's message: its numbers, listed or packed, its hashes and its motion; put the obstacle elsewhere.

Built obstacles, scenes and files on disk are found again by these hashes. A kind of obstacle that may have very many
numbers belongs in `_GEOMETRY` (and in `_count_parts`), so that they are hashed only once; one that isn't
`messages.Placed` needs a function in `_POSED`. A motion has placements at times, with a screw from each to the next,
and rests before and after. Proofs bound distances by its speeds, so these may be larger, never smaller; the referee has
this motion, too, by code of its own.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import msgspec
import numpy as np
import pinocchio as pin

from guidefield.geometry.surfaces import se3, transform_points
from guidefield.memory import content_key
from guidefield.messages import scene as messages
from guidefield.messages.scene import Points, Triangles
from guidefield.messages.scene_changes import Derivation
from guidefield.messages.values import Float32Array, Uint32Array


def points_in(points: Points) -> np.ndarray:
    """Return the points of a message, shape (n, 3) [m]."""
    if isinstance(points, Float32Array):
        return np.frombuffer(points.float32, "<f4").reshape(-1, 3).astype(float)
    return _read_triples(points, float)


def corners_in(triangles: Triangles) -> np.ndarray:
    """Return the indices of triangles' corners in a message, shape (t, 3)."""
    if isinstance(triangles, Uint32Array):
        return np.frombuffer(triangles.uint32, "<u4").reshape(-1, 3).astype(np.int64)
    return _read_triples(triangles, np.int64)


def _read_triples(listed: list[Any], kind: type) -> np.ndarray:
    flat = itertools.chain.from_iterable(listed)  # NumPy reads it in a third of the time
    return np.fromiter(flat, kind, 3 * len(listed)).reshape(-1, 3)


def count_of(some: Points | Triangles) -> int:
    """Return the number of points or triangles in a message."""
    match some:
        case Float32Array():
            return len(some.float32) // 12
        case Uint32Array():
            return len(some.uint32) // 12
    return len(some)


def are_many(declared: Sequence[messages.Obstacle | messages.GuidePlane], most: int) -> bool:
    """Return whether obstacles or guide planes with their corners, triangles, points and places are at least `most`."""
    return len(declared) >= most or len(declared) + sum(map(_count_parts, declared)) >= most


def _count_parts(declared: messages.Obstacle | messages.GuidePlane) -> int:
    """Count the corners, triangles, points and places of a declaration; 0 for a primitive at rest."""
    match declared:
        case messages.GuidePlane():
            return len(declared.vertices)
        case messages.Polygon():
            parts = len(declared.vertices)
        case messages.Mesh():
            parts = count_of(declared.triangles) + count_of(declared.vertices)
        case messages.PointCloud():
            parts = count_of(declared.points)
        case _:
            parts = 0
    return parts if declared.trajectory is None else parts + len(declared.trajectory.times)


class Content(NamedTuple):
    """Hashes of a declared obstacle: of all, and of its points and triangles alone if its kind has them."""

    all: bytes
    geometry: bytes = b""


_GEOMETRY: dict[type[messages.Obstacle], tuple[str, ...]] = {
    messages.Mesh: ("vertices", "triangles"),
    messages.PointCloud: ("points",),
}
"""Fields that may hold a million numbers, by kind."""


def content_of(message: messages.Obstacle) -> Content:
    """Hash a declared obstacle."""
    fields = _GEOMETRY.get(type(message))
    if fields is None:
        return Content(_hash(message))
    geometry = _hash([getattr(message, field) for field in fields])
    rest = {name: value for name, value in msgspec.structs.asdict(message).items() if name not in fields}
    return Content(_hash([type(message).__name__, rest, geometry]), geometry)


def scene_content(message: messages.Scene) -> tuple[bytes, dict[int, Content]]:
    """Hash all that is declared of a scene; return also the hashes of its meshes and clouds, by index."""
    many = {index: content_of(one) for index, one in enumerate(message.obstacles) if type(one) in _GEOMETRY}
    obstacles = [many[index].all if index in many else one for index, one in enumerate(message.obstacles)]
    return _hash(msgspec.structs.asdict(message) | {"obstacles": obstacles}), many


def change_content(before: bytes, change: Derivation, message: messages.Scene) -> tuple[bytes, dict[int, Content]]:
    """Hash a changed scene from the hash before and the change; return also hashes of new obstacles, by index."""
    others = [*change.moved, *range(len(message.obstacles) - change.added, len(message.obstacles))]
    fresh = {index: content_of(message.obstacles[index]) for index in others}
    return _hash([before, message.name, change.removed, others, [one.all for one in fresh.values()]]), fresh


_ENCODER = msgspec.msgpack.Encoder(enc_hook=np.generic.tolist)


def _hash(declared: object) -> bytes:
    return content_key(_ENCODER.encode(declared))


@dataclass(frozen=True, eq=False)
class ObstacleMotion:
    """Placements of an obstacle's frame in time."""

    times: np.ndarray  # increasing, shape (k,) [s]
    placements: tuple[Any, ...]  # of the obstacle's frame in the world then, pinocchio.SE3
    twists: np.ndarray  # velocity from each to the next, in the frame itself, linear part first, shape (k - 1, 6)

    @classmethod
    def of(cls, message: messages.ObstacleTrajectory) -> ObstacleMotion:
        """Build it from its declaration."""
        times = np.array(message.times, float)
        placements = tuple(se3(placement.position, placement.quaternion_xyzw) for placement in message.placements)
        steps = [pin.log6(a.actInv(b)).vector for a, b in pairwise(placements)]
        twists = np.array(steps).reshape(-1, 6) / np.diff(times)[:, None]
        times.setflags(write=False)
        twists.setflags(write=False)
        return cls(times, placements, twists)

    @property
    def end(self) -> float:
        """Time at which it comes to rest [s]."""
        return float(self.times[-1])

    def at(self, time: float) -> Any:
        """Return the frame's placement at a time [s]: T_i exp(s log(T_i^-1 T_{i+1})) between two that are given."""
        piece = int(np.searchsorted(self.times, time, side="right")) - 1
        if piece < 0:
            return self.placements[0].copy()
        if piece >= len(self.twists):
            return self.placements[-1].copy()
        return self.placements[piece] * pin.exp6(pin.Motion((time - self.times[piece]) * self.twists[piece]))

    def speed(self, start: float, end: float, centre: np.ndarray, radius: float) -> float:
        """Return the largest speed between two times [s] of any point of a ball in the obstacle's frame [m/s].

        On a screw every point keeps its speed |v + omega x c|, and none of the ball is faster than that and |omega|
        radius. The centre is of shape (3,).
        """
        moving = (self.times[1:] > start) & (self.times[:-1] < end)
        return float(ball_rates(self.twists[moving], centre, radius)[0].max(initial=0.0))

    def rates(self, centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the largest speeds and accelerations of a ball's points: before, between any two times, and after.

        A point's acceleration on a screw is omega x (v + omega x c). Shapes (k + 1,) [m/s and m/s^2]; 0 at the ends.
        """
        speeds, accelerations = ball_rates(self.twists, centre, radius)
        return np.r_[0.0, speeds, 0.0], np.r_[0.0, accelerations, 0.0]

    def passing(self, centre: np.ndarray, radius: float) -> np.ndarray:
        """Return the largest speeds at which the frame passes points of a ball in the world, shape (k + 1,) [m/s].

        No distance of such a point from the obstacle changes faster, however large the obstacle is: seen from its frame
        the point is on a screw, and keeps its speed. Before, between any two times, and after; 0 at the ends.
        """
        seen = np.array([placement.actInv(centre) for placement in self.placements[:-1]]).reshape(-1, 3)
        speeds: np.ndarray = np.r_[0.0, ball_rates(self.twists, seen, radius)[0], 0.0]
        return speeds


def ball_rates(twists: np.ndarray, centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest speed and acceleration of points of a ball on screws (k, 6), linear part first; both (k,).

    The centre, (3,) or (k, 3), is in the frame's coordinates [m].
    """
    angular = np.linalg.norm(twists[:, 3:], axis=1)
    speeds = np.linalg.norm(twists[:, :3] + np.cross(twists[:, 3:], centre), axis=1) + radius * angular
    return speeds, angular * speeds


def put_at(message: messages.Obstacle, placement: Any) -> messages.Obstacle:
    """Return an obstacle at rest at a placement of its trajectory.

    Where the kind has a pose, it is replaced; the corners of a polygon, points of a cloud and plane of a half-space
    are moved.
    """
    pose = _place if isinstance(message, messages.Placed) else _POSED[type(message)]
    return pose(message, placement)


def _place(message: Any, placement: Any) -> messages.Obstacle:
    return _replace(
        message,
        position=tuple(placement.translation.tolist()),
        quaternion_xyzw=tuple(pin.Quaternion(placement.rotation).normalized().coeffs().tolist()),
    )


def _place_centre(message: Any, placement: Any) -> messages.Obstacle:
    return _replace(message, position=tuple(placement.translation.tolist()))


def _place_corners(message: Any, placement: Any) -> messages.Obstacle:
    corners = [tuple(placement.act(np.array(corner, float)).tolist()) for corner in message.vertices]
    return _replace(message, vertices=corners)


def _place_plane(message: Any, placement: Any) -> messages.Obstacle:
    normal = placement.rotation @ np.array(message.normal, float)
    offset = message.offset + float(normal @ placement.translation)
    return _replace(message, normal=tuple(normal.tolist()), offset=offset)


def _place_points(message: Any, placement: Any) -> messages.Obstacle:
    return _replace(message, points=transform_points(placement, points_in(message.points)).tolist())


_POSED: dict[type[messages.Obstacle], Callable[[Any, Any], messages.Obstacle]] = {
    messages.Sphere: _place_centre,
    messages.Polygon: _place_corners,
    messages.HalfSpace: _place_plane,
    messages.PointCloud: _place_points,
}
"""Functions that pose the message of each kind that isn't `Placed`."""


def _replace(message: Any, **fields: Any) -> messages.Obstacle:
    replaced: messages.Obstacle = msgspec.structs.replace(message, trajectory=None, **fields)
    return replaced
