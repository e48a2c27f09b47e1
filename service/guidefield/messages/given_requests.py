"""Requests as they are given in Python: what is large is read some at a time, with a look at the clock between.

Nobody can interrupt msgspec in the middle of a list. Long ones are taken out of a request before it is read, and put
back in when they are read themselves: what is made is the same, to the last bit.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

from guidefield.errors import MalformedRequest
from guidefield.messages import codec, requests
from guidefield.messages.checked_scenes import CheckedScenes
from guidefield.messages.conditions import AttachedObject
from guidefield.messages.scene import (
    LONGEST_TRAJECTORY,
    MOST_OBSTACLES,
    MOST_PLANES,
    Box,
    Capsule,
    Cylinder,
    GuidePlane,
    HalfSpace,
    Obstacle,
    ObstacleTrajectory,
    Scene,
    Sphere,
    Times,
)
from guidefield.messages.scene_changes import MOST_CHANGES
from guidefield.messages.triples import MAX_VERTICES, TOGETHER, Points, Triangle, Triangles
from guidefield.messages.values import Look, Name, Placement, Vector3, never

LONG = 1000
"""Where there are more obstacles, corners, triangles and points in all than this, they aren't read at one go."""

OBJECTS = 500
"""So many obstacles or placements are read at one go, in a few milliseconds."""


class _Listed(NamedTuple):
    """What is taken out of a request, or out of its scene.

    Attributes:
        field: Where it was, and belongs again.
        kind: What each is.
        most: How many there may be; of more the reader of the rest says so.
        listed: How they are given.
    """

    field: str
    kind: Any
    most: float
    listed: Any = list | tuple


_OF_REQUEST = (
    _Listed("guide_planes", GuidePlane, float("inf")),
    _Listed("attached_objects", AttachedObject, float("inf")),
)
_OF_SCENE = _Listed("obstacles", Obstacle, MOST_OBSTACLES), _Listed("guide_planes", GuidePlane, MOST_PLANES)
_OF_CHANGE = _Listed("add", Obstacle, MOST_CHANGES), _Listed("move", Placement, MOST_CHANGES, dict)


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


def checked(request: bytes | dict[str, Any] | requests.Request, look: Look = never) -> requests.Request:
    """As `codec.decode_request`; a Struct that was made in Python, which no decoder has seen, is checked too.

    A large scene that holds what one did that was checked before isn't checked again.

    Args:
        request: In any form.
        look: Called again and again while a large one is read that isn't JSON.

    Raises:
        RequestTooLarge, MalformedRequest: as in `codec.decode`.
    """
    if not isinstance(request, requests.Request):
        return _in_parts(request, look) if is_large(request) else codec.decode_request(request)
    given = getattr(request, "scene", None)
    scene = _CHECKED.of(given, look)
    if scene is None:
        made = _in_parts(request, look) if is_large(request) else codec.decode_request(codec.without_arrays(request))
        _CHECKED.keep(given, getattr(made, "scene", None), look)
        return made
    made = codec.decode_request(codec.without_arrays(_with(request, {"scene": scene.name})))
    msgspec.structs.force_setattr(made, "scene", scene)
    return made


_CHECKED = CheckedScenes(4)


def is_large(request: object) -> bool:
    """Whether a request declares many obstacles, corners, triangles and points, and isn't JSON."""
    scene = _get(request, "scene")
    lists = [_get(request, one.field) for one in _OF_REQUEST]
    lists += [_get(scene, one.field) for one in (*_OF_SCENE, *_OF_CHANGE)]
    listed = [one for one in lists if isinstance(one, list | tuple | dict)]
    return sum(map(len, listed)) >= LONG or sum(_corners(one) for some in listed for one in some) >= LONG


def _in_parts(request: Any, look: Look) -> requests.Request:
    """Read a large request: first the rest, whose faults are told at once, and then what is large."""
    scene = _get(request, "scene")
    of_scene = () if not isinstance(scene, dict | Scene) else _OF_CHANGE if _get(scene, "base") else _OF_SCENE
    taken, taken_of_scene = _lists(request, _OF_REQUEST), _lists(scene, of_scene)
    bare = _with(request, {one.field: [] for one, _ in taken})
    if taken_of_scene:
        bare = _with(bare, {"scene": _with(scene, {one.field: type(given)() for one, given in taken_of_scene})})
    made: Any = codec.decode_request(bare if isinstance(bare, dict) else codec.without_arrays(bare))
    look()
    for one, given in taken:
        msgspec.structs.force_setattr(made, one.field, _objects(given, one.kind, f"$.{one.field}", look))
    for one, given in taken_of_scene:
        read = _by_name if isinstance(given, dict) else _objects
        msgspec.structs.force_setattr(made.scene, one.field, read(given, one.kind, f"$.scene.{one.field}", look))
    if taken_of_scene:
        _require(made.scene.__post_init__, "$.scene")
    read_all: requests.Request = made
    return read_all


def _lists(holder: Any, fields: Sequence[_Listed]) -> list[tuple[_Listed, Any]]:
    """What is taken out of a request or scene, of some fields."""
    found = [(one, _get(holder, one.field)) for one in fields]
    return [(one, given) for one, given in found if isinstance(given, one.listed) and len(given) <= one.most]


def _objects(given: Sequence[Any], kind: Any, at: str, look: Look) -> list[Any]:
    """Obstacles, guide planes, attached objects or placements; `at` is the path of their list."""
    made = list[Any]()
    for begin in range(0, len(given), OBJECTS):
        some = given[begin : begin + OBJECTS]
        bare, large = zip(*map(_bared, some), strict=True)
        together = len(some) if sum(map(_corners, bare)) <= LONG else 1
        for first in range(0, len(some), together):
            few = bare[first : first + together]
            plain = few if all(type(one) is dict for one in few) else codec.without_arrays(few)
            made += codec.convert(plain, list[kind], at, begin + first)
            look()
        for index, parts in enumerate(large, begin):
            if parts:
                _fill(made[index], parts, f"{at}[{index}]", look)
    return made


def _by_name(given: Mapping[str, Any], kind: Any, at: str, look: Look) -> dict[str, Any]:
    """The same of what has names."""
    made, names = dict[str, Any](), [*given]
    for begin in range(0, len(names), OBJECTS):
        some = {name: given[name] for name in names[begin : begin + OBJECTS]}
        plain = codec.without_arrays(some) if any(isinstance(one, msgspec.Struct) for one in some.values()) else some
        made |= codec.convert(plain, dict[Name, kind], at)
        look()
    return made


def _bared(one: Any) -> tuple[Any, dict[str, Any]]:
    """An obstacle, or what holds one, without what is large in it; and that, by its fields."""
    if _is_small(one):
        return one, {}
    if (obstacle := _get(one, "obstacle")) is not None:
        bare, large = _bared(obstacle)
        return (_with(one, {"obstacle": bare}), large) if large else (one, {})
    large = dict[str, Any]()
    vertices, triangles, points = (_get(one, field) for field in _ROWS)
    is_mesh = vertices is not None and triangles is not None
    if is_mesh and max(_count(vertices), _count(triangles)) >= LONG and _count(triangles) <= MAX_VERTICES:
        large = {"vertices": vertices, "triangles": triangles}
    if points is not None and _count(points) >= LONG:
        large["points"] = points
    sound: dict[str, Any] = {field: _ROWS[field].stand_in for field in large}
    trajectory = _get(one, "trajectory")
    places = _count(_get(trajectory, "placements"))
    if OBJECTS <= places <= LONGEST_TRAJECTORY and _count(_get(trajectory, "times")) == places:
        large["trajectory"], sound["trajectory"] = trajectory, None
    return (_with(one, sound), large) if large else (one, {})


def _fill(made: Any, large: dict[str, Any], at: str, look: Look) -> None:
    """Put into an obstacle, or into what holds one, what is large in it; `at` is its path."""
    if isinstance(made, AttachedObject):
        _fill(made.obstacle, large, f"{at}.obstacle", look)
        return
    for field, given in large.items():
        read = _trajectory if field == "trajectory" else _rows
        msgspec.structs.force_setattr(made, field, read(given, field, f"{at}.{field}", look))
    if _ROWS.keys() & large.keys():
        _require(lambda: made.require_numbers(look), at)


def _rows(given: Any, field: str, at: str, look: Look) -> Any:
    """Points or triangles."""
    if not _count(given):
        return codec.convert(given, _ROWS[field].all, at)
    made = list[Any]()
    for begin in range(0, len(given), TOGETHER):
        some = given[begin : begin + TOGETHER]
        made += codec.convert(some.tolist() if hasattr(some, "tolist") else some, list[_ROWS[field].row], at, begin)
        look()
    return made


def _trajectory(given: Any, _field: str, at: str, look: Look) -> ObstacleTrajectory:
    bare = codec.without_arrays(_with(given, {"times": [0.0], "placements": [Placement()]}))
    made: ObstacleTrajectory = codec.convert(bare, ObstacleTrajectory, at)
    times = codec.convert(codec.without_arrays(_get(given, "times")), Times, f"{at}.times")
    msgspec.structs.force_setattr(made, "times", times)
    placements = _objects(_get(given, "placements"), Placement, f"{at}.placements", look)
    msgspec.structs.force_setattr(made, "placements", placements)
    _require(made.__post_init__, at)
    return made


def _require(check: Callable[[], object], at: str) -> None:
    """Check what was put together, which has a path, as msgspec does what it makes."""
    try:
        check()
    except ValueError as error:
        raise MalformedRequest(f"{error} (at {at})", path=at) from None


def _is_small(one: Any) -> bool:
    """Whether anything is certainly no large obstacle: of thousands most are small."""
    if isinstance(one, dict):
        return _MAY_BE_LARGE.isdisjoint(one)
    if type(one) in _PRIMITIVES:
        return one.trajectory is None
    return isinstance(one, Placement) or not isinstance(one, msgspec.Struct)


def _corners(one: Any) -> int:
    """How many corners, triangles, points and places of a trajectory anything has that are declared as lists."""
    if _is_small(one):
        return 0
    inner = _corners(_get(one, "obstacle")) + _count(_get(_get(one, "trajectory"), "placements"))
    return inner + sum(_count(_get(one, field)) for field in _ROWS)


def _count(rows: Any) -> int:
    """How many rows there are; 0 of what isn't in rows."""
    if isinstance(rows, list | tuple):
        return len(rows)
    return len(rows) if hasattr(rows, "tolist") and getattr(rows, "shape", None) else 0


def _get(holder: Any, field: str) -> Any:
    """What stands in a field of a dict or message; None if nothing does."""
    return holder.get(field) if isinstance(holder, dict) else getattr(holder, field, None)


def _with(holder: Any, fields: dict[str, Any]) -> Any:
    """A dict or message with some fields as they are given, unchecked."""
    if isinstance(holder, dict):
        return {**holder, **fields}
    other = copy.copy(holder)
    for field, value in fields.items():
        msgspec.structs.force_setattr(other, field, value)
    return other
