"""Scenes that are kept: by content, some of them, and fewer where they take much memory."""

from __future__ import annotations

import numpy as np
import pytest

from guidefield.deadline import Deadline, DeadlineExpired
from guidefield.memory import BYTES_PER_FACE, BoundedMap, Limit
from guidefield.messages import scene as messages
from guidefield.messages.scene_changes import SceneDiff, apply_change, freeze
from guidefield.messages.values import Float32Array, Placement
from guidefield.scene import obstacle, scene as scenes
from guidefield.scene.scene import BuiltScenes


def scan(name: str, count: int) -> messages.Scene:
    points = Float32Array(np.random.default_rng(count).uniform(size=(count, 3)).astype("<f4").tobytes())
    return messages.Scene(name=name, obstacles=[messages.PointCloud(name=name, points=points, radius=0.01)])


def test_the_last_scenes_are_kept_by_content() -> None:
    kept = BuiltScenes(Limit(2, 2**29))
    first = kept.of(messages.Scene(name="a"))
    assert kept.of(messages.Scene(name="a")) is first
    kept.of(messages.Scene(name="b"))
    kept.of(messages.Scene(name="a"))
    kept.of(messages.Scene(name="c"))
    assert kept.of(messages.Scene(name="a")) is first


def test_a_scene_of_very_many_changes_is_built_though_all_before_are_held() -> None:
    """Each was found from the one before it: of 1000 that somebody held that was too deep."""
    kept, held = (
        BuiltScenes(Limit(2, 2**29)),
        [freeze(messages.Scene(name="a", obstacles=[messages.Sphere(name="b", radius=0.5)]))],
    )
    kept.of(held[0])
    for k in range(1, 3001):
        held.append(apply_change(held[-1], SceneDiff(move={"b": Placement((float(k), 0.0, 0.0))})))
    assert kept.of(held[-1]).obstacles[0].placement.translation.tolist() == [3000.0, 0.0, 0.0]
    assert kept.of(held[-1]) is kept.of(held[-1])


def test_large_clouds_are_kept_only_as_long_as_memory_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    memory = 1000 * BYTES_PER_FACE
    monkeypatch.setattr(obstacle, "_KNOWN", BoundedMap(Limit(512, memory)))
    kept = BuiltScenes(Limit(16, memory))
    small, large = kept.of(scan("small", 300)), kept.of(scan("large", 600))
    assert kept.of(scan("small", 300)) is small
    assert kept.of(scan("larger", 650)) is not None  # no room for the one that was asked for least
    assert kept.of(scan("small", 300)) is small
    assert kept.of(scan("large", 600)) is not large
    assert 0 < obstacle._KNOWN.size <= memory
    assert kept.of(scan("huge", 5000)) is kept.of(scan("huge", 5000))  # one at least


def test_a_large_scene_whose_time_is_up_is_not_even_hashed(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [(float(i), 0.0, 0.0) for i in range(1000)]
    cloud = messages.PointCloud(name="cloud", points=points, radius=0.1)
    monkeypatch.setattr(scenes, "scene_content", lambda *_: pytest.fail("there is no time"))
    with pytest.raises(DeadlineExpired, match="scene large"):
        BuiltScenes(Limit(2, 2**29)).of(messages.Scene(name="large", obstacles=[cloud]), Deadline(0.0))
