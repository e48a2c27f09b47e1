"""A scene as tables for lanes: a kernel's tables of primitives against the general ones, and boxes."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from guidefield.collision.lanes.scene_tables import lane_scene, prepare_scene
from guidefield.deadline import UNLIMITED, Deadline, DeadlineExpired
from guidefield.messages import scene as messages
from guidefield.scene.scene import Scene, build
from tests.collision.scenery import scattered
from tests.scene.solids import l_prism, mesh_message

RING = messages.Mesh(
    name="ring",
    vertices=[(0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1), (-0.1, 0.0, 0.0), (0.0, 0.02, 0.02)],
    triangles=[(0, 1, 2), (1, 3, 2), (0, 4, 1)],
    position=(0.4, 0.4, 0.4),
)
WALL = messages.Polygon(name="wall", vertices=[(0.7, -0.3, 0.2), (0.7, 0.3, 0.2), (0.6, 0.3, 0.9), (0.6, -0.3, 0.9)])
FLOOR = messages.HalfSpace(name="floor", normal=(0.1, 0.0, 1.0), offset=-0.2)
LEVEL = messages.HalfSpace(name="level", normal=(0.0, 0.0, 2.0), offset=-0.4)


def scene(seed: int, count: int) -> Scene:
    """Primitives with something else before, among and behind them."""
    obstacles = scattered(np.random.default_rng(seed), count)
    obstacles = [RING, *obstacles[: count // 2], FLOOR, WALL, LEVEL, *obstacles[count // 2 :]]
    return build(messages.Scene(name="test", obstacles=obstacles))


def test_preparing_a_scene_stops_when_time_is_up_and_goes_on_later() -> None:
    solids = [
        msgspec.structs.replace(mesh_message(*l_prism(), position=(0.41, 0.13, 0.07 + k)), name=f"m{k}")
        for k in range(3)
    ]
    made = build(messages.Scene(name="s", obstacles=solids))
    for at, left in (("m0", 1), ("m0", 1), ("m1", 2), ("m2", 2)):
        answers = iter([False] * (left - 1) + [True])
        with pytest.raises(DeadlineExpired, match=f"^obstacle {at}$"):
            prepare_scene(made, Deadline(is_cancelled=lambda answers=answers: next(answers)))
    prepare_scene(made, UNLIMITED)
    prepare_scene(made, Deadline(0.0))  # nothing is left to do
    assert len(lane_scene(made).owners) > 0
