"""How late answers come that allow little time for large scenes, however these are given: `tools/attack_deadlines`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import guidefield
from guidefield.messages import codec
from guidefield.messages.requests import PlanRequest
from guidefield.messages.scene import Scene
from guidefield.messages.values import Float32Array, Uint32Array

TIMES = (0.1, 0.3)
"""Allowed [s]."""

SLACK, SHARE = 0.05, 0.05
"""How late an answer may be [s], and by which share of what it allows."""

COUNT = {"boxes": 100_000, "triangles": 1_000_000, "points": 1_000_000}
"""The most that a scene, a mesh and a cloud may have."""

SMALL = {"robot": "panda", "scene": "table", "goal": {"type": "joints", "positions": {"panda_joint1": 0.4}}}

Made = dict[str, Any]


def late(kind: str, form: str, allowed: float, again: int = 0, share: float = 1.0) -> list[tuple[float, str]]:
    """How late answers come in a large scene that was never seen, and again: by the processor time of this process.

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
    guidefield.answer(SMALL)
    made = MAKERS[kind](round(share * COUNT[kind]))
    clock, time.monotonic = time.monotonic, time.process_time
    try:
        return [_late(FORMS[form](made, allowed), allowed) for _ in range(1 + again)]
    finally:
        time.monotonic = clock


def too_late(seconds: float, allowed: float) -> bool:
    """Whether an answer that came so long after its time was up [s] came too late."""
    return seconds > SLACK + SHARE * allowed


def _late(request: Any, allowed: float) -> tuple[float, str]:
    began = time.process_time()
    status = guidefield.answer(request).status
    return time.process_time() - began - allowed, f"{status.name} {status.details.get('preparing', '')}".strip()


def boxes(count: int) -> Made:
    """Small boxes, all but ten of them out of reach."""
    places = np.random.default_rng(7).uniform([2.0, -9.0, -9.0], [9.0, 9.0, 9.0], (count, 3))
    places[:10] = [[0.75 * math.cos(0.6 * k), 0.75 * math.sin(0.6 * k), 0.05] for k in range(10)]
    size = [0.05, 0.04, 0.03]
    made = [{"type": "box", "name": f"b{k}", "size": size, "position": at} for k, at in enumerate(places.tolist())]
    return {"name": "many", "obstacles": made}


def triangles(count: int) -> Made:
    """An open mesh, 6 m wide, below the robot."""
    side = max(1, math.isqrt(count // 2))
    u = np.linspace(-3.0, 3.0, side + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(u, u, indexing="ij"))
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    halves = [np.column_stack([corner, corner + side + 1, corner + 1])]
    halves.append(np.column_stack([corner + 1, corner + side + 1, corner + side + 2]))
    corners = np.column_stack([x, y, -0.25 + 0.04 * np.sin(11.0 * x) * np.cos(7.0 * y)])
    mesh = {"type": "mesh", "name": "terrain", "vertices": corners, "triangles": np.concatenate(halves)}
    return {"name": "many", "obstacles": [mesh]}


def points(count: int) -> Made:
    """A cloud over the ground."""
    rng = np.random.default_rng(7)
    spread = np.column_stack([rng.uniform(-3.0, 3.0, (count, 2)), rng.uniform(-0.25, -0.22, count)])
    return {"name": "many", "obstacles": [{"type": "point_cloud", "name": "ground", "points": spread, "radius": 0.01}]}


def _asked(scene: Any, allowed: float) -> Made:
    goal = {"type": "joints", "positions": {"panda_joint1": 0.4}}
    options = {"guide_planes": [], "allowed_planning_time": allowed, "recording": "off"}
    return {"robot": "panda", "scene": scene, "goal": goal, **options}


def _with(made: Made, change: Callable[[str, Any], Any]) -> Made:
    """A scene with its arrays as something else."""
    some = [
        {name: change(name, value) if isinstance(value, np.ndarray) else value for name, value in one.items()}
        for one in made["obstacles"]
    ]
    return {**made, "obstacles": some}


def _listed(made: Made) -> Made:
    return _with(made, lambda _, array: array.tolist())


def _packed(name: str, array: np.ndarray) -> Any:
    if name == "triangles":
        return Uint32Array(array.astype("<u4").tobytes())
    return Float32Array(array.astype("<f4").tobytes())


def _objects(made: Made, allowed: float) -> PlanRequest:
    """Structs that no decoder has seen: a scene made anew."""
    request = codec.decode_request(_asked(made, allowed))
    scene = Scene(made["name"], obstacles=request.scene.obstacles)
    return PlanRequest("panda", scene, request.goal, **_options(request))


def _options(request: PlanRequest) -> Made:
    return {name: getattr(request, name) for name in ("guide_planes", "allowed_planning_time", "recording")}


FORMS: dict[str, Callable[[Made, float], Any]] = {
    "objects": lambda made, allowed: _objects(_listed(made), allowed),
    "packed": lambda made, allowed: _objects(_with(made, _packed), allowed),
    "dicts": lambda made, allowed: _asked(_listed(made), allowed),
    "arrays": _asked,
    "json": lambda made, allowed: codec.encode(_asked(_listed(made), allowed)),
}
"""How a request is given: messages with lists, and with packed arrays; dicts with lists, and with NumPy's; JSON."""

MAKERS: dict[str, Callable[[int], Made]] = {"boxes": boxes, "triangles": triangles, "points": points}
