"""A table that is updated for a changed scene is, to the last bit, the one that is made of that scene alone."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from guidefield.bounded_map import Limit
from guidefield.collision import obstacle_boxes as boxes_module
from guidefield.collision.lanes import scene_tables
from guidefield.collision.lanes.scene_tables import lane_scene
from guidefield.collision.obstacle_boxes import obstacle_boxes
from guidefield.messages import codec, scene as messages
from guidefield.messages.frozen_scenes import freeze
from guidefield.messages.scene_changes import SceneDiff, apply_change
from guidefield.messages.values import Placement
from guidefield.prove.tables import obstacle_bodies
from guidefield.scene import content, distance_tables as of_distances, incremental as room, obstacle
from guidefield.scene.built import BuiltScenes
from guidefield.scene.crop import Ball, nearest_obstacles
from guidefield.scene.distance_tables import distance_tables, moving_tables
from guidefield.scene.incremental import MANY, Rows, incremental
from guidefield.scene.scene import Scene, build, placed_rows
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
        "lanes": (lane_scene(scene).owners, lane_scene(scene).tables),
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
    decoded: messages.Scene = codec.decode(codec.encode(scene), messages.Scene)
    return decoded


@settings(deadline=None, max_examples=4)
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


def test_a_scene_of_which_the_one_before_is_gone_is_built_alone() -> None:
    kept, scene = BuiltScenes(Limit(1, 2**29)), boxes(300)
    kept.of(scene)
    kept.of(messages.Scene("other"))
    after = apply_change(scene, SceneDiff(move={"b7": Placement((1.0, 2.0, 3.0))}))
    assert bits(tables(kept.of(after))) == bits(tables(build(copied(after))))


def test_a_mesh_that_comes_is_hashed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    kept, scene, hashed = BuiltScenes(Limit(4, 2**29)), boxes(300), list[str]()
    kept.of(scene)
    real = content.content_of
    for where in (content, obstacle):
        monkeypatch.setattr(where, "content_of", lambda one, *look: hashed.append(one.name) or real(one, *look))
    after = apply_change(scene, SceneDiff(add=[mesh("m", np.random.default_rng(0))]))
    assert kept.of(after) is kept.of(after)
    assert hashed == ["m"]


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


def stood(rng: np.random.Generator, before: int, now: int) -> np.ndarray:
    """Where so many stood among so many before, -1 of others; those that stayed in their order."""
    source = np.full(now, -1)
    stayed = int(rng.integers(0, min(before, now) + 1))
    source[np.sort(rng.permutation(now)[:stayed])] = np.sort(rng.permutation(before)[:stayed])
    return source


def test_rows_are_what_their_runs_say() -> None:
    rng = np.random.default_rng(2)
    for _ in range(300):
        before, count = rng.integers(0, 9, 2).tolist()
        source = stood(rng, before, count)
        rows, new = Rows.of(source, before), 100 + np.arange((source < 0).sum())
        assert (rows.count, rows.source.tolist()) == (count, source.tolist())
        assert rows.fresh == np.flatnonzero(source < 0).tolist()
        assert rows.removed == sorted({*range(before)} - {*source.tolist()})
        values, others = np.arange(before), iter(new.tolist())
        expected = [next(others) if k < 0 else k for k in source.tolist()]
        assert rows.carry(values, new).tolist() == rows.listed(values.tolist(), new.tolist()) == expected
        assert rows.now[source[source >= 0]].tolist() == np.flatnonzero(source >= 0).tolist()
        assert rows.stayed(range(before)) == np.flatnonzero(source >= 0).tolist()
        some, now = (np.flatnonzero(rng.random(k) < 0.6) for k in (before, count))
        found = [some.tolist().index(k) if k in some else -1 for k in source[now].tolist()]
        assert rows.among(some, now).source.tolist() == found


def test_very_many_runs_are_carried_over_alike() -> None:
    source = np.where(np.arange(1000) % 5 == 0, -1, np.arange(1000))
    rows, new = Rows.of(source, 1000), -1.0 - np.arange(200)
    assert len(rows.runs) > room.MANY_RUNS
    assert rows.carry(np.arange(1000.0), new)[source >= 0].tolist() == source[source >= 0].tolist()
    assert rows.carry(np.arange(1000.0), new)[source < 0].tolist() == new.tolist()


def test_rows_of_a_change_are_those_of_what_it_does() -> None:
    rng = np.random.default_rng(3)
    for _ in range(300):
        before = int(rng.integers(0, 9))
        gone = np.flatnonzero(rng.random(before) < 0.3)
        source = np.delete(np.arange(before), gone)
        moved, added = np.flatnonzero(rng.random(len(source)) < 0.3), int(rng.integers(0, 3))
        source[moved] = -1
        source = np.append(source, np.full(added, -1))
        rows = Rows.changed(before, gone.tolist(), moved.tolist(), len(source))
        assert rows.runs == Rows.of(source, before).runs


def test_changes_one_after_the_other_are_one() -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        counts = rng.integers(0, 9, 3).tolist()
        first, second = (Rows.of(stood(rng, before, now), before) for before, now in itertools.pairwise(counts))
        both = second.after(first)
        expected = np.append(first.source, -1)[second.source]
        assert (both.before, both.source.tolist()) == (counts[0], expected.tolist())
        assert both.runs == Rows.of(expected, counts[0]).runs


def test_a_table_is_carried_over_from_the_last_scene_that_has_it_and_made_anew_where_much_changed() -> None:
    calls: list[str] = []

    def over(known: list[str], rows: Rows, _: Scene) -> list[str]:
        calls.append(f"over {len(rows.fresh)}")
        return known

    @incremental(over)
    def table(scene: Scene) -> list[str]:
        calls.append("made")
        return []

    kept, message = BuiltScenes(Limit(8, 2**29)), boxes(MANY)
    table(kept.of(message))
    for k in range(3):
        message = apply_change(message, SceneDiff(move={f"b{k}": Placement()}))
        scene = kept.of(message)
    assert table(scene) is table(scene)
    assert calls == ["made", "over 3"]
    message = apply_change(message, SceneDiff(move={f"b{k}": Placement() for k in range(MANY // 2)}))
    table(kept.of(message))
    assert calls == ["made", "over 3", "made"]
    assert room.FEW < 0.5


def test_where_one_of_many_moves_nothing_is_sorted_nor_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    kept, message = BuiltScenes(Limit(8, 2**29)), boxes(500)
    first = kept.of(message)
    before = bits(tables(first))
    moved = kept.of(apply_change(message, SceneDiff(move={"b7": Placement((0.1, 0.2, 0.3))})))
    for where in (boxes_module, of_distances):
        monkeypatch.setattr(where, "along_curve", None)
    monkeypatch.setattr(scene_tables, "primitive_tables", only_one(scene_tables.primitive_tables))
    found = obstacle_boxes(moved), distance_tables(moved), lane_scene(moved).tables
    monkeypatch.undo()
    alone = build(copied(moved.message))
    expected = obstacle_boxes(alone), distance_tables(alone), lane_scene(alone).tables
    assert bits([vars(found[0].tree), found[1:]]) == bits([vars(expected[0].tree), expected[1:]])
    assert bits(tables(moved)) == bits(tables(alone))
    assert bits(tables(first)) == before


def only_one(kernel: Callable[..., int]) -> Callable[..., int]:
    """The kernel of primitives where it is asked for one."""

    def made(placed: np.ndarray, *rest: Any) -> int:
        assert len(placed) == 12
        return kernel(placed, *rest)

    return made


def test_an_obstacle_that_leaves_the_box_about_all_is_carried_over_alike() -> None:
    kept, message = BuiltScenes(Limit(8, 2**29)), boxes(400)
    tables(kept.of(message))
    for place in ((90.0, 0.0, 0.0), (0.0, 0.0, 0.0)):
        message = apply_change(message, SceneDiff(move={"b7": Placement(place)}))
        assert bits(tables(kept.of(message))) == bits(tables(build(copied(message))))


def test_tables_of_two_versions_are_at_hand_and_those_of_an_earlier_one_are_made_again() -> None:
    made: list[Scene] = []

    @incremental(lambda known, rows, scene: [*known])
    def table(scene: Scene) -> list[str]:
        made.append(scene)
        return []

    kept, messages_ = BuiltScenes(Limit(8, 2**29)), [boxes(MANY)]
    for k in range(3):
        messages_.append(apply_change(messages_[-1], SceneDiff(move={f"b{k}": Placement()})))
    scenes = [kept.of(message) for message in messages_]
    for scene in scenes:
        table(scene)
    assert made == scenes[:1]
    assert table(scenes[2]) is table(scenes[2])
    assert made == scenes[:1]
    table(scenes[0])
    assert made == [scenes[0]] * 2


def test_nothing_of_what_is_known_of_a_scene_travels() -> None:
    scene = boxes(3)
    after = apply_change(scene, SceneDiff(remove=["b1"]))
    assert b"frozen" not in codec.encode(after)
    assert not vars(msgspec.structs.replace(after, name="t"))
    assert after == messages.Scene("s", obstacles=[scene.obstacles[0], scene.obstacles[2]])
