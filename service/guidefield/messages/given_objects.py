"""Obstacles, and what holds one, as they are given in Python: those of very many corners are read some at a time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec

from guidefield.messages import codec
from guidefield.messages.conditions import AttachedObject
from guidefield.messages.given_lists import OBJECTS, Long, count, get, listed, require, with_fields
from guidefield.messages.scene import (
    LONGEST_TRAJECTORY,
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    ObstacleTrajectory,
    Sphere,
    Times,
)
from guidefield.messages.triples import MAX_VERTICES, TOGETHER, Points, Triangle, Triangles
from guidefield.messages.values import Float32Array, Look, Placement, Uint32Array, Vector3

LONG = 1000
"""Where there are more corners, triangles and points in all than this, they aren't read at one go."""


class _Rows(NamedTuple):
    """A field of a mesh or cloud that may have a million rows.

    Attributes:
        row: The type of a row.
        all: The field's type.
        stand_in: What is sound in its place.
    """

    row: Any
    all: Any
    stand_in: list[Any]


_ROWS = {
    "vertices": _Rows(Vector3, Points, [(0.0, 0.0, 0.0)]),
    "triangles": _Rows(Triangle, Triangles, [(0, 0, 0)]),
    "points": _Rows(Vector3, Points, [(0.0, 0.0, 0.0)]),
}

_PRIMITIVES = {Box, Sphere, Cylinder, Capsule, HalfSpace}

_MAY_BE_LARGE = frozenset({*_ROWS, "trajectory", "obstacle"})


_PLACES = Long(list[Placement], listed)


def objects(given: Sequence[Any], what: Long, at: str, look: Look) -> list[Any]:
    """Obstacles, guide planes or attached objects, which may be large themselves; `at` is the path of their list."""
    made = list[Any]()
    for begin in range(0, len(given), what.together):
        some = given[begin : begin + what.together]
        bare, large = zip(*map(_bared, some), strict=True)
        together = len(some) if sum(map(corners, bare)) <= LONG else 1
        for first in range(0, len(some), together):
            few = bare[first : first + together]
            plain = few if all(type(one) is dict for one in few) else codec.without_arrays(few)
            made += codec.convert(plain, what.all, at, begin + first)
            look()
        for index, parts in enumerate(large, begin):
            if parts:
                _fill(made[index], parts, f"{at}[{index}]", look)
    return made


def _bared(one: Any) -> tuple[Any, dict[str, Any]]:
    """An obstacle, or what holds one, without what is large in it; and that, by its fields."""
    if _is_small(one):
        return one, {}
    if (obstacle := get(one, "obstacle")) is not None:
        bare, large = _bared(obstacle)
        return (with_fields(one, {"obstacle": bare}), large) if large else (one, {})
    large = dict[str, Any]()
    vertices, triangles, points = (get(one, field) for field in _ROWS)
    is_mesh = vertices is not None and triangles is not None
    if is_mesh and max(count(vertices), count(triangles)) >= LONG and count(triangles) <= MAX_VERTICES:
        large = {"vertices": vertices, "triangles": triangles}
    if points is not None and count(points) >= LONG:
        large["points"] = points
    sound: dict[str, Any] = {field: _ROWS[field].stand_in for field in large}
    trajectory = get(one, "trajectory")
    places = count(get(trajectory, "placements"))
    if OBJECTS <= places <= LONGEST_TRAJECTORY and count(get(trajectory, "times")) == places:
        large["trajectory"], sound["trajectory"] = trajectory, None
    return (with_fields(one, sound), large) if large else (one, {})


def _fill(made: Any, large: dict[str, Any], at: str, look: Look) -> None:
    """Put into an obstacle, or into what holds one, what is large in it; `at` is its path."""
    if isinstance(made, AttachedObject):
        _fill(made.obstacle, large, f"{at}.obstacle", look)
        return
    for field, given in large.items():
        read = _trajectory if field == "trajectory" else _rows
        msgspec.structs.force_setattr(made, field, read(given, field, f"{at}.{field}", look))
    if _ROWS.keys() & large.keys():
        require(lambda: made.require_numbers(look), at)


def _rows(given: Any, field: str, at: str, look: Look) -> Any:
    """Points or triangles."""
    if not count(given):
        return codec.convert(given, _ROWS[field].all, at)
    packed = _packed(given, field)
    if packed is not None:
        return packed
    made = list[Any]()
    for begin in range(0, len(given), TOGETHER):
        some = given[begin : begin + TOGETHER]
        made += codec.convert(some.tolist() if hasattr(some, "tolist") else some, list[_ROWS[field].row], at, begin)
        look()
    return made


def _packed(given: Any, field: str) -> Float32Array | Uint32Array | None:
    """An array of NumPy's that holds no more than what may be packed, packed; None of all else.

    Of a million triples this takes a hundredth of the time that it takes to list them.
    """
    kind = getattr(getattr(given, "dtype", None), "str", "")[1:]
    if not kind or given.shape[1:] != (3,):
        return None
    if field != "triangles":
        return Float32Array(given.astype("<f4").tobytes()) if kind == "f4" else None
    if kind not in ("i4", "i8", "u4", "u8") or given.min() < 0 or given.max() > _LARGEST:
        return None
    return Uint32Array(given.astype("<u4").tobytes())


_LARGEST = 2**32 - 1


def _trajectory(given: Any, _field: str, at: str, look: Look) -> ObstacleTrajectory:
    bare = codec.without_arrays(with_fields(given, {"times": [0.0], "placements": [Placement()]}))
    made: ObstacleTrajectory = codec.convert(bare, ObstacleTrajectory, at)
    times = codec.convert(codec.without_arrays(get(given, "times")), Times, f"{at}.times")
    msgspec.structs.force_setattr(made, "times", times)
    placements = listed(get(given, "placements"), _PLACES, f"{at}.placements", look)
    msgspec.structs.force_setattr(made, "placements", placements)
    require(made.__post_init__, at)
    return made


def _is_small(one: Any) -> bool:
    """Whether anything is certainly no large obstacle: of thousands most are small."""
    if isinstance(one, dict):
        return _MAY_BE_LARGE.isdisjoint(one)
    if type(one) in _PRIMITIVES:
        return one.trajectory is None
    return isinstance(one, Placement) or not isinstance(one, msgspec.Struct)


def corners(one: Any) -> int:
    """How many corners, triangles, points and places of a trajectory anything has that are declared as lists."""
    if _is_small(one):
        return 0
    inner = corners(get(one, "obstacle")) + count(get(get(one, "trajectory"), "placements"))
    return inner + sum(count(get(one, field)) for field in _ROWS)
