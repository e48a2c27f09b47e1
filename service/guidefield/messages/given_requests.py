"""Requests as they are given in Python: what is large is read some at a time, with a look at the clock between.

Nobody can interrupt msgspec in the middle of a list. Long ones are taken out of a request before it is read, and put
back in when they are read themselves: what is made is the same, to the last bit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import msgspec

from guidefield.messages import codec, known_payloads, requests
from guidefield.messages.certify_request import MOST_ROWS, require_finite_rows
from guidefield.messages.checked_scenes import CheckedScenes
from guidefield.messages.conditions import MOST_HELD, MOST_PAIRS, AttachedObject
from guidefield.messages.given_lists import Long, by_name, get, listed, require, with_fields, without_structs
from guidefield.messages.given_objects import LONG, corners, objects
from guidefield.messages.goals import MOST_GOALS, require_finite_configurations
from guidefield.messages.kinematics_requests import (
    MOST_CONFIGURATIONS,
    MOST_POINTS,
    MOST_POSES,
    MOST_STARTS,
    require_finite_points,
)
from guidefield.messages.scene import MOST_OBSTACLES, MOST_PLANES, GuidePlane, Obstacle, Scene
from guidefield.messages.scene_changes import MOST_CHANGES, RequestScene
from guidefield.messages.triples import TOGETHER
from guidefield.messages.values import Look, Name, Placement, Vector3, never, require_finite

Fields = Mapping[str, "Long | Fields"]
"""What is taken out of a message, by field: lists, and those in messages in it."""


def checked(
    request: bytes | dict[str, Any] | requests.Request, look: Look = never, large: bool | None = None
) -> requests.Request:
    """As `codec.decode_request`; a Struct that was made in Python, which no decoder has seen, is checked too.

    A large scene that holds what one did that was checked before isn't checked again.

    Args:
        request: In any form.
        look: Called again and again while a large one is read that isn't JSON.
        large: Whether it `is_large`, where that is known.

    Raises:
        RequestTooLarge, MalformedRequest: as in `codec.decode`.
    """
    large = is_large(request) if large is None else large
    if type(request) is bytes:
        return known_payloads.read_new(request)
    given = get(request, "scene")
    scene = _CHECKED.of(given, look)
    if scene is None:
        made = _read(request, large, look)
        _CHECKED.keep(given, getattr(made, "scene", None), look)
        return made
    stand_in = {"name": scene.name} if isinstance(request, dict) else Scene(scene.name)
    bare = with_fields(request, {"scene": stand_in})
    made = _read(bare, is_large(bare), look)
    msgspec.structs.force_setattr(made, "scene", scene)
    return made


def _read(request: Any, large: bool, look: Look) -> requests.Request:
    """A request in Python, read anew."""
    if large:
        return _in_parts(request, look)
    return codec.decode_request(codec.without_arrays(request) if isinstance(request, msgspec.Struct) else request)


_CHECKED = CheckedScenes(4)


def is_large(request: object) -> bool:
    """Whether a request declares many obstacles, corners, triangles, points, rows and whatever else, and isn't JSON."""
    listed = [*_lists(request, _fields_of(request))]
    return (
        sum(len(given) for *_, given in listed) >= LONG
        or sum(what.inner(one) for _, what, given in listed for one in given) >= LONG
    )


def _in_parts(request: Any, look: Look) -> requests.Request:
    """Read a large request: first the rest, whose faults are told at once, and then what is large."""

    def read(bare: Any) -> requests.Request:
        return codec.decode_request(without_structs(bare))

    made: requests.Request = _whole(request, _fields_of(request), read, "$", look)
    return made


def _whole(given: Any, fields: Fields, read: Callable[[Any], Any], at: str, look: Look) -> Any:
    """A message of which what is long is read after the rest; `at` is its path."""
    taken = [*_lists(given, fields)]
    made = read(_bare(given, fields))
    look()
    holders = dict[str, Any]()
    for path, what, long in taken:
        holder, place = made, at
        for field in path[:-1]:
            holder, place = getattr(holder, field), f"{place}.{field}"
        field = path[-1]
        all_read = what.read(long, what, f"{place}.{field}", look)
        if what.require is not None:
            require(partial(what.require, field, all_read, look), place)
        msgspec.structs.force_setattr(holder, field, all_read)
        holders[place] = holder
    for place, holder in holders.items():
        if isinstance(holder, Scene | RequestScene):
            require(holder.__post_init__, place)
        elif isinstance(holder, requests.GivenTrajectory):
            require(holder.require_same_lengths, place)
    return made


def _lists(holder: Any, fields: Fields, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Long, Any]]:
    """What is taken out of a message, of some fields: its path, what it is, and how it is given."""
    for field, what in fields.items():
        given = get(holder, field)
        if not isinstance(what, Long):
            yield from _lists(given, what, (*path, field)) if isinstance(given, dict | msgspec.Struct) else ()
        elif what.holds(given):
            yield (*path, field), what, given


def _bare(holder: Any, fields: Fields) -> Any:
    """A message with something sound in place of what is taken out of it."""
    sound = dict[str, Any]()
    for field, what in fields.items():
        given = get(holder, field)
        if isinstance(what, Long):
            if what.holds(given):
                sound[field] = what.kind(what.stand_in)
        elif isinstance(given, dict | msgspec.Struct):
            sound[field] = _bare(given, what)
    return with_fields(holder, sound) if sound else holder


def _steps(given: Sequence[Any], what: Long, at: str, look: Look) -> list[Any]:
    """Steps of a sequence, one by one."""

    def step(one: Any, index: int) -> Any:
        def read(bare: Any) -> Any:
            return codec.convert([without_structs(bare)], what.all, at, index)[0]

        return _whole(one, _OF_STEP, read, f"{at}[{index}]", look)

    return [step(one, index) for index, one in enumerate(given)]


def _parts_of_step(step: Any) -> int:
    """How many are listed in a step, with those in each of them."""
    return sum(len(given) + sum(map(what.inner, given)) for _, what, given in _lists(step, _OF_STEP))


def _fields_of(request: Any) -> Fields:
    """What is taken out of a request: of its scene what it declares, or what it changes."""
    of_scene = _OF_CHANGE if get(get(request, "scene"), "base") else _OF_SCENE
    return {**_OF_REQUEST, "scene": of_scene}


def _require_finite(field: str, numbers: Sequence[float], look: Look) -> None:
    for begin in range(0, len(numbers), TOGETHER):
        require_finite(field, numbers[begin : begin + TOGETHER], begin)
        look()


_PLANES = Long(list[GuidePlane], objects, MOST_PLANES, inner=corners)
_ROWS = Long(list[list[float]], listed, MOST_ROWS, stand_in=([0.0],), together=TOGETHER, require=require_finite_rows)
_CONFIGURATIONS = Long(list[requests.Positions], listed, MOST_CONFIGURATIONS, require=require_finite_configurations)
_OF_SCENE: Fields = {
    "obstacles": Long(list[Obstacle], objects, MOST_OBSTACLES, inner=corners),
    "guide_planes": _PLANES,
}
_OF_CHANGE: Fields = {
    "add": Long(list[Obstacle], objects, MOST_CHANGES, inner=corners),
    "move": Long(dict[Name, Placement], by_name, MOST_CHANGES, kind=dict),
}
_OF_GOAL: Fields = {"positions": dataclasses.replace(_CONFIGURATIONS, most=MOST_GOALS, stand_in=({},))}
_OF_STEP: Fields = {"guide_planes": _PLANES, "goal": _OF_GOAL}
_OF_TRAJECTORY: Fields = {
    "times": Long(list[float], listed, least=0, stand_in=(0.0,), together=TOGETHER, require=_require_finite),
    **dict.fromkeys(("positions", "velocities", "accelerations"), _ROWS),
}
_OF_REQUEST: Fields = {
    "guide_planes": _PLANES,
    "attached_objects": Long(list[AttachedObject], objects, MOST_HELD, inner=corners),
    "allowed_collisions": Long(list[tuple[Name, Name]], listed, MOST_PAIRS, together=TOGETHER),
    "steps": Long(
        list[requests.PlanStep], _steps, requests.MOST_STEPS, stand_in=({"pause": 1.0},), inner=_parts_of_step
    ),
    "goal": _OF_GOAL,
    "path": _ROWS,
    "trajectory": _OF_TRAJECTORY,
    "configurations": _CONFIGURATIONS,
    "start_configurations": dataclasses.replace(_CONFIGURATIONS, most=MOST_STARTS),
    "poses": Long(list[requests.TargetPose], listed, MOST_POSES),
    "points": Long(list[Vector3], listed, MOST_POINTS, together=TOGETHER, require=require_finite_points),
}
"""What is taken out of a request beside what is its scene's."""
