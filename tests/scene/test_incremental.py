"""A table that is updated for a changed scene is, to the last bit, the one that is made of that scene alone."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.collision.batch.scene_tables import batch_scene
from guidefield.collision.obstacle_boxes import obstacle_boxes
from guidefield.memory import Limit
from guidefield.messages import codec, scene as messages
from guidefield.messages.scene_changes import SceneDiff, apply_change, freeze
from guidefield.messages.values import Placement
from guidefield.prove.tables import obstacle_bodies
from guidefield.scene import obstacle
from guidefield.scene.crop import Ball, nearest_obstacles
from guidefield.scene.distance_tables import distance_tables, moving_tables
from guidefield.scene.scene import BuiltScenes, Scene, build, placed_rows
from tests.scene.solids import l_prism

BALL = Ball(0.1, 0.2, 0.3, 0.9)
TETRAHEDRON = [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1)]
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]


def turned(rng: np.random.Generator) -> Any:
    q = rng.normal(size=4)
    return tuple((q / np.linalg.norm(q)).tolist())


def at(rng: np.random.Generator) -> Any:
    return tuple(np.round(rng.normal(scale=2.0, size=3), rng.choice([1, 9])).tolist())


def size(rng: np.random.Generator, count: int = 1) -> Any:
    drawn = tuple(rng.uniform(0.02, 0.3, count).tolist())
    return drawn if count > 1 else drawn[0]


PLACED: list[Callable[[str, np.random.Generator], messages.Obstacle]] = [
    *[lambda n, r: messages.Box(name=n, size=size(r, 3), position=at(r), quaternion_xyzw=turned(r))] * 4,
    lambda n, r: messages.Sphere(name=n, radius=size(r), position=at(r)),
    lambda n, r: messages.Cylinder(name=n, radius=size(r), length=size(r), position=at(r), quaternion_xyzw=turned(r)),
    lambda n, r: messages.Capsule(name=n, radius=size(r), length=size(r), position=at(r), quaternion_xyzw=turned(r)),
]


def mesh(name: str, rng: np.random.Generator) -> messages.Obstacle:
    vertices, triangles = l_prism()
    corners, faces = [*map(tuple, vertices.tolist())], [*map(tuple, triangles.tolist())]
    corners, faces = (corners, faces) if rng.random() < 0.5 else (TETRAHEDRON, FACES)
    return messages.Mesh(name=name, vertices=corners, triangles=faces, position=at(rng), quaternion_xyzw=turned(rng))


def moving(name: str, rng: np.random.Generator) -> messages.Obstacle:
    trajectory = messages.ObstacleTrajectory([0.0, 1.0], [Placement(at(rng)), Placement(at(rng), turned(rng))])
    return messages.Box(name=name, size=size(rng, 3), trajectory=trajectory)


OTHERS: list[Callable[[str, np.random.Generator], messages.Obstacle]] = [
    lambda n, r: messages.HalfSpace(name=n, normal=tuple(r.normal(size=3).tolist()), offset=-3.0 * r.random()),
    lambda n, r: messages.PointCloud(name=n, points=[at(r) for _ in range(5)], radius=0.02),
    lambda n, r: messages.Polygon(name=n, vertices=TETRAHEDRON[:3]),
    mesh,
]


def some(rng: np.random.Generator, name: str, *, odd: float, moves: bool) -> messages.Obstacle:
    kinds = [*OTHERS, moving] if moves else OTHERS
    kinds = kinds if rng.random() < odd else PLACED
    return kinds[int(rng.integers(len(kinds)))](name, rng)


def diff(rng: np.random.Generator, scene: messages.Scene, new: str, **kinds: Any) -> SceneDiff:
    """Something that fits a scene: few or many move, some come, some go, some are replaced."""
    movable = (messages.Box, messages.Sphere, messages.Cylinder, messages.Capsule, messages.Mesh)
    names = [one.name for one in scene.obstacles if isinstance(one, movable) and one.trajectory is None]
    chosen = rng.permutation(names)[: int(rng.choice([1, 1, 3, 40]))].tolist() if names else []
    others = [one.name for one in scene.obstacles if one.name not in chosen]
    gone = rng.permutation(others)[: int(rng.choice([0, 0, 1, 3]))].tolist()
    again = [name for name in gone if rng.random() < 0.3]
    come = [f"{new}{k}" for k in range(int(rng.choice([0, 0, 1, 4])))]
    add = [some(rng, name, **kinds) for name in (*again, *come)]
    return SceneDiff(add=add, move={name: Placement(at(rng), turned(rng)) for name in chosen}, remove=gone)


def tables(scene: Scene) -> dict[str, Any]:
    """All that is made of a scene."""
    boxes = obstacle_boxes(scene)
    made = {
        "obstacles": [(one.message, one.placed, one.warnings) for one in scene.obstacles],
        "known": (scene.names, scene.others, scene.moves, scene.end, scene.convex, scene.faces, scene.most_faces),
        "warnings": scene.warnings,
        "placed": placed_rows(scene),
        "boxes": (
            boxes.axes,
            boxes.centres,
            boxes.halves,
            boxes.endless,
            boxes.bounded,
            boxes.tree.along,
            boxes.tree.nodes,
        ),
        "distances": distance_tables(scene),
        "batch": (batch_scene(scene).owners, batch_scene(scene).tables),
        "moving": moving_tables(scene),
        "field": scene.tables,
    }
    return made if scene.moves else made | {"proved": obstacle_bodies(scene, timed=False)}


def bits(value: Any) -> Any:
    """Something that is equal where all numbers are, to the last bit."""
    if isinstance(value, np.ndarray):
        return str(value.dtype), value.shape, value.tobytes()
    if isinstance(value, tuple | list):
        return [bits(one) for one in value]
    return {key: bits(one) for key, one in value.items()} if isinstance(value, dict) else value


def copied(scene: messages.Scene) -> messages.Scene:
    """The same scene as nobody has seen it."""
    return codec.decode(codec.encode(scene), messages.Scene)


def test_many_scattered_changes_and_another_count_change_tables_row_by_row():
    rng, kept = np.random.default_rng(0), BuiltScenes(Limit(16, 2**29))
    message = freeze(messages.Scene("s", obstacles=[PLACED[k % len(PLACED)](f"o{k}", rng) for k in range(400)]))
    made = [bits(tables(kept.of(message)))]
    # what stands outermost stays, so that the order of the others is kept
    inner = rng.permutation([one.name for one in message.obstacles if max(map(abs, one.position)) < 2.0])[:60]
    moved = {name: Placement(tuple(rng.uniform(-1.0, 1.0, 3).tolist()), turned(rng)) for name in inner.tolist()}
    new = messages.Box(name="new", size=(0.1, 0.1, 0.1), position=(0.5, 0.5, 0.5))
    changed = apply_change(message, SceneDiff(add=[new], move=moved))
    made.append(bits(tables(kept.of(changed))))
    assert made[1] == bits(tables(build(copied(changed)))) != made[0]


@settings(max_examples=4)
@given(st.integers(0, 10**6), st.sampled_from([40, 280]), st.sampled_from([0.0, 0.05, 0.4]), st.booleans())
def test_tables_of_a_changed_scene_are_those_of_the_same_scene_alone(seed, count, odd, moves):
    rng, kept = np.random.default_rng(seed), BuiltScenes(Limit(16, 2**29))
    kinds = {"odd": odd, "moves": moves}
    message = freeze(messages.Scene("s", obstacles=[some(rng, f"o{k}", **kinds) for k in range(count)]))
    versions, seen = [message], [kept.of(message)]
    before = [bits(tables(seen[0]))]
    for k in range(3):
        versions.append(apply_change(versions[-1], diff(rng, versions[-1], f"n{k}_", **kinds)))
        if rng.random() < 0.3:
            continue  # a version that nobody asks for
        scene = kept.of(versions[-1])
        nearest_obstacles(seen[-1], BALL)
        seen.append(scene)
        before.append(bits(tables(scene)))
        alone = build(copied(versions[-1]))
        assert before[-1] == bits(tables(alone))
        near, expected = nearest_obstacles(scene, BALL), nearest_obstacles(alone, BALL)
        assert bits(near[:3]) == bits(expected[:3])
        assert bits(tables(near.of(scene))) == bits(tables(expected.of(alone)))
    assert [bits(tables(scene)) for scene in seen] == before, "what an earlier version was it is still"


def boxes(count: int) -> messages.Scene:
    rng = np.random.default_rng(count)
    return freeze(messages.Scene("s", obstacles=[PLACED[0](f"b{k}", rng) for k in range(count)]))


def test_only_what_is_another_is_built(monkeypatch: pytest.MonkeyPatch) -> None:
    kept, scene = BuiltScenes(Limit(4, 2**29)), boxes(500)
    first = kept.of(scene)
    built: list[str] = []
    make = obstacle.build
    monkeypatch.setattr(obstacle, "build", lambda one, *rest: built.append(one.name) or make(one, *rest))
    after = apply_change(scene, SceneDiff(move={"b7": Placement((1.0, 2.0, 3.0))}))
    second = kept.of(after)
    assert built == ["b7"]
    assert [k for k in range(500) if second.obstacles[k] is not first.obstacles[k]] == [7]
    assert second.obstacles[7].message.position == (1.0, 2.0, 3.0)
    assert first.obstacles[7].message == scene.obstacles[7]
    assert kept.of(scene) is first
    assert kept.of(apply_change(scene, SceneDiff(move={"b7": Placement((1.0, 2.0, 3.0))}))) is second, (
        "the same change again"
    )


def test_scenes_that_others_may_change_are_known_by_all_that_is_in_them() -> None:
    kept, scene = BuiltScenes(Limit(4, 2**29)), messages.Scene("s", obstacles=[*boxes(300).obstacles])
    first = kept.of(scene)
    scene.obstacles[3] = messages.Sphere(name="b3", radius=0.5)
    assert kept.of(scene) is not first
    after = apply_change(scene, SceneDiff(remove=["b0"]))
    seen = kept.of(after)
    after.obstacles[2] = messages.Sphere(name="b3", radius=0.25)
    assert seen is not kept.of(after)
    assert kept.of(after).obstacles[2].message == after.obstacles[2]
