"""Collect the shapes of a file as the obstacles of a scene: placed, scaled, named and checked.

All readers of scene files (`reading.py`, `sdf.py`) add their shapes here; names and approximating meshes (cones and
ellipsoids, always a little larger) are in scenes that users keep.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pinocchio as pin

from guidefield.errors import RobotInvalid, SceneInvalid
from guidefield.messages.faults import list_choices, suggest
from guidefield.messages.scene import (
    MAX_VERTICES,
    MOST_OBSTACLES,
    HalfSpace,
    Mesh,
    Obstacle,
    PointCloud,
    Points,
    Scene,
    Sphere,
)
from guidefield.messages.values import LARGEST, Float32Array, Uint32Array
from guidefield.robot.mesh_files.numbers import MeshFault
from guidefield.robot.mjcf_conversion import circumscribed_ball

TO_Z_UP = {
    "x": np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "z": np.eye(3),
}
"""Rotation to z up from a frame with an axis up, by that axis; as COLLADA and glTF have it."""

Kind = type[Obstacle] | Callable[..., dict[str, np.ndarray]]
"""Class of an obstacle, or a function from the sizes of a shape to the vertices and triangles of its mesh."""

LONGEST_NAME = 256  # of an obstacle, in characters, as of `messages/values.py` `Name`


class SceneBuilder:
    """Makes a scene of the shapes of a file, without some names and all below them.

    Attributes:
        scale: Factor of all lengths.
        turn: Rotation from the file's frame to the world, shape (3, 3).
        warnings: Sentences about what is odd but harmless.
    """

    def __init__(self, scale: float, without: Collection[str]) -> None:
        self.scale, self.turn = scale, np.eye(3)
        self.warnings: list[str] = []
        self._without, self._left_out = set(without), set[str]()
        self._names: dict[str, None] = {}
        self._obstacles: list[Obstacle] = []

    def add(
        self,
        kind: Kind,
        name: str,
        placement: Any,
        owners: Collection[str] = (),
        where: str = "",
        **sizes: Any,
    ) -> None:
        """Add an obstacle.

        Args:
            kind: Its class, or what makes the mesh that represents it of its sizes.
            placement: pinocchio.SE3 of its frame in the file's; a half-space is below the frame's z = 0.
            owners: Names of all that holds it.
            where: The beginning of a message about it, such as its line.
            sizes: Fields of the class in the file's unit: numbers, vertices (v, 3), triangles (t, 3) or points (n, 3).

        Raises:
            SceneInvalid: if a size isn't positive or a number not finite, or there are too many.
        """
        if self.leaves_out(name, *owners):
            return
        if len(self._obstacles) == MOST_OBSTACLES:
            raise SceneInvalid(f"{where}it has more than {MOST_OBSTACLES} obstacles, which is the most of a scene")
        fields = {}
        for field, size in sizes.items():
            with np.errstate(over="ignore", invalid="ignore"):
                scaled = size if field == "triangles" else np.multiply(size, self.scale)
            if field in ("vertices", "points", "triangles"):
                _check_rows(scaled, f"{where}obstacle {name!r}", field)
            elif not (np.isfinite(scaled).all() and np.min(scaled) > 0.0):
                raise SceneInvalid(f"{where}obstacle {name!r}: `{field}` must be positive, got {size}")
            fields[field] = scaled
        if not isinstance(kind, type):
            fields, kind = kind(**fields), Mesh
        try:
            self._obstacles.append(kind(name=name, **self._fields_at(kind, placement, fields)))
        except ValueError as error:
            raise SceneInvalid(f"{where}obstacle {name!r}: {error}") from None

    def leaves_out(self, *names: str) -> bool:
        """Return True if one of the names is left out."""
        self._names.update(dict.fromkeys(names))
        self._left_out |= self._without.intersection(names)
        return not self._without.isdisjoint(names)

    def scene(self, name: str, prefix: str) -> Scene:
        """Return the scene; names begin with the prefix, and several that are the same are numbered: `leg/0`, `leg/1`.

        Raises:
            SceneInvalid: if there is no obstacle, a name is too long or missing, or one that is left out isn't there.
        """
        for missing in sorted(self._without - self._left_out):
            hint = suggest(missing, list(self._names)) or f"there are {list_choices(list(self._names))}"
            raise SceneInvalid(f"nothing called {missing!r} can be left out: {hint.strip()}")
        if not self._obstacles:
            raise SceneInvalid("it has no obstacle: nothing in it has a shape that is judged")
        counts = Counter(one.name for one in self._obstacles)
        taken, numbers = {name for name, count in counts.items() if count == 1}, Counter[str]()
        obstacles: list[Any] = []
        for one in self._obstacles:
            unique = one.name
            while counts[one.name] > 1 and (unique == one.name or unique in taken):
                unique, numbers[one.name] = f"{one.name}/{numbers[one.name]}", numbers[one.name] + 1
            taken.add(unique)
            called = f"{prefix}{unique}"
            if not 0 < len(called) <= LONGEST_NAME:
                raise SceneInvalid(f"a name must have 1 to {LONGEST_NAME} characters, got {called[:64]!r}")
            obstacles.append(one if called == one.name else msgspec.structs.replace(one, name=called))
        return Scene(name=name, obstacles=obstacles)

    def _fields_at(self, kind: type[Obstacle], placement: Any, fields: dict[str, Any]) -> dict[str, Any]:
        rotation, position = self.turn @ placement.rotation, self.turn @ placement.translation * self.scale
        if kind is HalfSpace:
            normal = rotation[:, 2]
            return {"normal": tuple(normal.tolist()), "offset": float(normal @ position)}
        if kind is PointCloud:
            return {"points": _pack(fields["points"] @ rotation.T + position), "radius": float(fields["radius"])}
        quaternion = tuple(pin.Quaternion(rotation).coeffs().tolist())
        placed = {"position": tuple(position.tolist())}
        if kind is not Sphere:
            placed["quaternion_xyzw"] = quaternion
        if kind is Mesh:
            triangles = Uint32Array(fields["triangles"].astype("<u4").tobytes())
            return {**placed, "vertices": _pack(fields["vertices"]), "triangles": triangles}
        plain = {field: tuple(size.tolist()) if np.ndim(size) else float(size) for field, size in fields.items()}
        return {**placed, **plain}


def ellipsoid(radii: np.ndarray) -> dict[str, np.ndarray]:
    """Return vertices (v, 3) and triangles (t, 3) that contain an ellipsoid of radii (3,), at most 0.9 % larger."""
    ball = circumscribed_ball()
    return {"vertices": ball.vertices * radii, "triangles": ball.faces}


def cone(radius: float, length: float) -> dict[str, np.ndarray]:
    """Return vertices (v, 3) and triangles (t, 3) of a pyramid that contains a cone about the origin, 0.12 % wider."""
    turns = np.arange(64) * (2.0 * np.pi / 64)
    rim = np.column_stack([np.cos(turns), np.sin(turns)]) * (radius / np.cos(np.pi / 64))
    base = np.column_stack([rim, np.full(64, -0.5 * length)])
    edge, after = np.arange(64), np.roll(np.arange(64), -1)
    sides, below = (np.column_stack([a, b, np.full(64, tip)]) for a, b, tip in ((edge, after, 64), (after, edge, 65)))
    ends = [[0.0, 0.0, 0.5 * length], [0.0, 0.0, -0.5 * length]]
    return {"vertices": np.concatenate([base, ends]), "triangles": np.concatenate([sides, below])}


def _check_rows(rows: np.ndarray, what: str, field: str) -> None:
    if not 1 <= len(rows) <= MAX_VERTICES:
        raise SceneInvalid(f"{what} has {len(rows)} {field}; 1 to {MAX_VERTICES} are read: thin them out, or divide it")
    wrong = np.flatnonzero(~(np.abs(rows) <= LARGEST).all(axis=1))
    if len(wrong):
        told = rows[wrong[0]].tolist()
        raise SceneInvalid(f"{what}: `{field}[{wrong[0]}]` must be finite, within {LARGEST:g} m, got {told}")


def _pack(points: np.ndarray) -> Points:
    """Pack points (n, 3), as float32 where they lose nothing by it."""
    with np.errstate(over="ignore", invalid="ignore"):
        single = points.astype("<f4")
    return Float32Array(single.tobytes()) if (single == points).all() else list(map(tuple, points.tolist()))


@contextlib.contextmanager
def located(path: Path) -> Iterator[None]:
    """Name a file in the message of each fault that comes up while it is read, as SceneInvalid."""
    try:
        yield
    except MeshFault as fault:
        raise SceneInvalid(f"{path.name} {fault}", path=str(path)) from None
    except (RobotInvalid, SceneInvalid) as error:
        raise SceneInvalid(f"{path.name}: {error.message}", **{**error.details, "path": str(path)}) from None
