"""Scenes that are kept: by content, some of them, and fewer where they take much memory."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from guidefield.aside import StoppedError
from guidefield.messages import given_requests, scene as messages
from guidefield.messages.own_scenes import make_own
from guidefield.messages.requests import JointsGoal, PlanRequest
from guidefield.messages.scene_changes import SceneDiff, changed
from guidefield.messages.values import Float32Array, Placement
from guidefield.scene import built, obstacle
from guidefield.scene.built import MANY, BuiltScenes


def scan(name: str, count: int) -> messages.Scene:
    points = Float32Array(np.random.default_rng(count).uniform(size=(count, 3)).astype("<f4").tobytes())
    return messages.Scene(name=name, obstacles=[messages.PointCloud(name=name, points=points, radius=0.01)])


def test_the_last_scenes_are_kept_by_content() -> None:
    kept = BuiltScenes(2)
    first = kept.of(messages.Scene(name="a"))
    assert kept.of(messages.Scene(name="a")) is first
    kept.of(messages.Scene(name="b"))
    kept.of(messages.Scene(name="a"))
    kept.of(messages.Scene(name="c"))
    assert kept.of(messages.Scene(name="a")) is first


def test_numbers_of_numpy_mean_the_same() -> None:
    kept, position = BuiltScenes(2), np.array([0.5, 0.25, 1.0])
    plain, numpys = (
        kept.of(messages.Scene(name="a", obstacles=[messages.Sphere(name="b", radius=0.5, position=given)]))
        for given in (tuple(position.tolist()), tuple(position))
    )
    assert plain is numpys


def test_a_scene_of_very_many_changes_is_built_though_all_before_are_held() -> None:
    """Each was found from the one before it: of 1000 that somebody held that was too deep."""
    kept, held = BuiltScenes(2), [make_own(messages.Scene(name="a", obstacles=[messages.Sphere(name="b", radius=0.5)]))]
    kept.of(held[0])
    for k in range(1, 3001):
        held.append(changed(held[-1], SceneDiff(move={"b": Placement((float(k), 0.0, 0.0))})))
    assert kept.of(held[-1]).obstacles[0].placement.translation.tolist() == [3000.0, 0.0, 0.0]
    assert kept.of(held[-1]) is kept.of(held[-1])


def test_large_clouds_are_kept_only_as_long_as_memory_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    for room in (built, obstacle):
        monkeypatch.setattr(room, "MOST_FACES", 1000)
    monkeypatch.setattr(obstacle, "_KNOWN", {})
    kept = BuiltScenes(16)
    small, large = kept.of(scan("small", 300)), kept.of(scan("large", 600))
    assert kept.of(scan("small", 300)) is small
    assert kept.of(scan("larger", 650)) is not None  # no room for the one that was asked for least
    assert kept.of(scan("small", 300)) is small
    assert kept.of(scan("large", 600)) is not large
    assert sum(one.faces for one in obstacle._KNOWN.values()) <= 1000
    assert kept.of(scan("huge", 5000)) is kept.of(scan("huge", 5000))  # one at least


def test_a_checked_scene_is_hashed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    kept, hashed = BuiltScenes(2), 0
    real = hashlib.sha256

    def counting(data: bytes = b"") -> object:
        nonlocal hashed
        hashed += 1
        return real(data)

    monkeypatch.setattr(hashlib, "sha256", counting)
    boxes = [messages.Box(name=f"b{k}", size=(0.1, 0.1, 0.1), position=(0.5 * k, 0.0, 0.0)) for k in range(100)]
    scene = messages.Scene(name="a", obstacles=boxes)
    asked = PlanRequest("panda", scene, JointsGoal({"panda_joint1": 0.8}))
    first, again = given_requests.checked(asked), given_requests.checked(asked)
    assert kept.of(first.scene) is kept.of(again.scene)
    assert hashed == 1
    assert kept.of(scene).obstacles == kept.of(scene).obstacles  # anybody may change this one: it is known by its hash
    assert hashed == 3
    scene.obstacles.pop()
    assert len(kept.of(given_requests.checked(asked).scene).obstacles) == 99


def test_a_large_scene_whose_time_is_up_is_not_even_hashed(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [(float(i), 0.0, 0.0) for i in range(MANY)]
    cloud = messages.PointCloud(name="cloud", points=points, radius=0.1)
    scenes = BuiltScenes(2)
    monkeypatch.setattr(hashlib, "sha256", lambda *_: pytest.fail("there is no time"))
    with pytest.raises(StoppedError, match="scene large"):
        scenes.of(messages.Scene(name="large", obstacles=[cloud]), lambda: True)
