"""How late answers to large requests come that allow little time, once they were read: `tools/attack_deadlines`."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

import guidefield
from guidefield.aside import wait_for_others
from guidefield.engine import _default
from guidefield.errors import GuidefieldError
from guidefield.messages import codec
from guidefield.messages.request_reader import read_request
from guidefield.messages.scene import Scene
from guidefield.messages.values import Float32Array, Uint32Array
from tests.deadline_requests import MAKERS, Made

TIMES = (0.1, 0.3)
"""Allowed [s]."""

SLACK, SHARE = 0.05, 0.05
"""How late an answer may be [s], and by which share of what it allows."""

SMALL = {"robot": "panda", "scene": "table", "goal": {"type": "joints", "positions": {"panda_joint1": 0.4}}}


def late(kind: str, form: str, allowed: float, again: int = 0, share: float = 1.0) -> list[tuple[float, str]]:
    """How late answers to a large request come that was never seen, and again: by the processor time of this process.

    What else the machine does makes nothing late then, and threads that work beside one another count twice.

    Args:
        kind: What it has many of.
        form: How it is given.
        allowed: What each answer is allowed [s].
        again: How often it is asked for again.
        share: How large it is, of the most that there may be of a kind.

    Returns:
        Seconds of processor time after what was allowed, and how the answer ended, of each.
    """
    wait_for_others(lambda: None)  # of another kind
    guidefield.answer(SMALL)
    made, most = MAKERS[kind]
    asked = made(round(share * most))
    asked["allowed_time" if "type" in asked else "allowed_planning_time"] = allowed
    clock, time.monotonic = time.monotonic, time.process_time
    try:
        return [_late(FORMS[form](asked), allowed) for _ in range(1 + again)]
    finally:
        time.monotonic = clock


def too_late(seconds: float, allowed: float) -> bool:
    """Whether an answer that came so long after its time was up [s] came too late."""
    return seconds > SLACK + SHARE * allowed


def _late(request: Any, allowed: float) -> tuple[float, str]:
    read = read_request(request)  # at one go: who asks in Python waits for it
    began = time.process_time()
    try:
        status = getattr(_default().answer(read), "status", None)
        ended = "answered" if status is None else f"{status.name} {status.details.get('preparing', '')}".strip()
    except GuidefieldError as error:
        ended = f"{type(error).__name__}: {error.message[:80]}"
    return time.process_time() - began - allowed, ended


def _with(made: Any, change: Callable[[str, np.ndarray], Any], name: str = "") -> Any:
    """A request with its arrays as something else."""
    if isinstance(made, dict):
        return {field: _with(value, change, field) for field, value in made.items()}
    if isinstance(made, list):
        return [_with(one, change, name) for one in made]
    return change(name, made) if isinstance(made, np.ndarray) else made


def _listed(made: Made) -> Made:
    listed: Made = _with(made, lambda _, array: array.tolist())
    return listed


def _packed(made: Made) -> Made:
    """Where points and triangles may be packed they are."""

    def packed(one: Any) -> Any:
        if isinstance(one, list):
            return [packed(each) for each in one]
        if not isinstance(one, dict):
            return one
        changed = {field: packed(value) for field, value in one.items()}
        if one.get("type") in ("mesh", "point_cloud"):
            for field in {"vertices", "points"} & one.keys():
                changed[field] = Float32Array(one[field].astype("<f4").tobytes())
            if "triangles" in one:
                changed["triangles"] = Uint32Array(one["triangles"].astype("<u4").tobytes())
        return changed

    return _listed(packed(made))


def _objects(made: Made) -> Any:
    """Structs that no decoder has seen: with a scene made anew."""
    request = codec.decode_request(made)
    scene = getattr(request, "scene", None)
    if not isinstance(scene, Scene):
        return request
    others = {field: getattr(request, field) for field in request.__struct_fields__}
    others["scene"] = Scene(scene.name, obstacles=scene.obstacles, guide_planes=scene.guide_planes)
    return type(request)(**others)


FORMS: dict[str, Callable[[Made], Any]] = {
    "objects": lambda made: _objects(_listed(made)),
    "packed": lambda made: _objects(_packed(made)),
    "dicts": _listed,
    "arrays": lambda made: made,
    "json": lambda made: msgspec.json.encode(_listed(made)),
    "packed_json": lambda made: msgspec.json.encode(_packed(made)),
}
"""How a request is given: messages with lists, and with packed arrays; dicts with lists, and with NumPy's; JSON of
lists, and of packed arrays."""
