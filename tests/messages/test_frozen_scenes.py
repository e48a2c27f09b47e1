"""Where obstacles stand by their names, through changes and in versions that are changed apart from each other."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from guidefield.messages import scene_changes
from guidefield.messages.scene import Scene, Sphere
from guidefield.messages.scene_changes import SceneDiff, apply_change, freeze, name_index
from guidefield.messages.values import Placement

NAMES = [f"o{k}" for k in range(14)]


def spheres(*names: str) -> Scene:
    return freeze(Scene("s", obstacles=[Sphere(name=name, radius=0.1) for name in names]))


def diff(rng: np.random.Generator, scene: Scene) -> SceneDiff:
    """Something that fits a scene; names that went come again."""
    there = [one.name for one in scene.obstacles]
    gone = [name for name in there if rng.random() < 0.2]
    left = [name for name in there if name not in gone]
    absent = rng.permutation([name for name in NAMES if name not in left])
    come = absent[: int(rng.integers(0, min(4, len(absent) + 1)))].tolist()
    moved = [name for name in left if rng.random() < 0.2]
    return SceneDiff(
        add=[Sphere(name=name, radius=0.2) for name in come],
        move={name: Placement((1.0, 2.0, float(rng.random()))) for name in moved},
        remove=gone,
    )


@given(st.integers(0, 10**6))
def test_names_are_found_in_all_versions_whatever_became_of_others(seed: int) -> None:
    rng = np.random.default_rng(seed)
    versions = [spheres(*NAMES[:7])]
    for _ in range(12):
        scene = versions[int(rng.integers(len(versions)))]
        versions.append(apply_change(scene, diff(rng, scene)))
        for version in rng.permutation(len(versions))[:3].tolist():
            _require_all_found(versions[version])
    for scene in versions:
        _require_all_found(scene)


def _require_all_found(scene: Scene) -> None:
    expected = {one.name: index for index, one in enumerate(scene.obstacles)}
    assert {name: name_index(scene).of(name) for name in NAMES} == {name: expected.get(name) for name in NAMES}


def test_where_very_many_are_gone_the_others_are_numbered_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene_changes, "MAX_GONE_NUMBERS", 2)
    scene = spheres(*NAMES)
    for name in NAMES[:6]:
        scene = apply_change(scene, SceneDiff(remove=[name]))
        _require_all_found(scene)
