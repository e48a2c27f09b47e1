"""What changes about a scene: a stored one, one that a request tells by its base, versions changed apart."""

import msgspec
import numpy as np
import pytest
from hypothesis import given, strategies as st

from guidefield.errors import MalformedRequest, SceneInvalid
from guidefield.messages import codec, scene_changes
from guidefield.messages.codec import Encoding
from guidefield.messages.requests import PlanRequest
from guidefield.messages.scene import Box, GuidePlane, HalfSpace, Mesh, ObstacleTrajectory, Polygon, Scene, Sphere
from guidefield.messages.scene_changes import SceneDiff, apply_change, freeze, name_index
from guidefield.messages.values import Placement

CORNERS = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]
TURNED = (0.0, 0.0, 0.6, 0.8)
HALL = Scene(
    "hall",
    obstacles=[
        Box(name="crate", size=(0.1, 0.2, 0.3)),
        Sphere(name="ball", radius=0.1),
        Mesh(name="part", vertices=CORNERS, triangles=[(0, 1, 2)]),
        HalfSpace(name="floor", normal=(0, 0, 1)),
        Polygon(name="door", vertices=CORNERS),
        Box(name="cart", size=(1, 1, 1), trajectory=ObstacleTrajectory([0.0], [Placement()])),
    ],
    guide_planes=[GuidePlane("gate", CORNERS)],
)


def names(scene: Scene) -> list[str]:
    return [one.name for one in scene.obstacles]


def test_what_goes_moves_and_comes_does_so_and_all_else_stays():
    post = Box(name="post", size=(1, 1, 1))
    diff = SceneDiff(
        add=[post], move={"crate": Placement((1, 2, 3), TURNED), "ball": Placement((4, 5, 6), TURNED)}, remove=["part"]
    )
    after = apply_change(HALL, diff)
    assert names(after) == ["crate", "ball", "floor", "door", "cart", "post"]
    assert after.obstacles[0] == Box(name="crate", size=(0.1, 0.2, 0.3), position=(1, 2, 3), quaternion_xyzw=TURNED)
    assert after.obstacles[1] == Sphere(name="ball", radius=0.1, position=(4, 5, 6))
    assert after.obstacles[2:5] == HALL.obstacles[3:]
    assert after.obstacles[5] is post
    assert (after.name, after.guide_planes) == ("hall", HALL.guide_planes)
    assert names(HALL)[2] == "part"


@pytest.mark.parametrize(
    ("diff", "fault", "obstacle", "path"),
    [
        (SceneDiff(remove=["crat"]), "no obstacle 'crat'; did you mean crate", "crat", "$.remove[0]"),
        (SceneDiff(remove=["crate", "crate"]), "no obstacle 'crate'", "crate", "$.remove[1]"),
        (
            SceneDiff(move={"nothing": Placement()}),
            "no obstacle 'nothing'; there are crate",
            "nothing",
            "$.move.nothing",
        ),
        (SceneDiff(move={"floor": Placement()}), "a half_space has no placement", "floor", "$.move.floor"),
        (SceneDiff(move={"door": Placement()}), "a polygon has no placement", "door", "$.move.door"),
        (SceneDiff(move={"cart": Placement()}), "its `trajectory` says where it is", "cart", "$.move.cart"),
        (SceneDiff(add=[Sphere(name="ball", radius=1)]), "has an obstacle 'ball' already", "ball", "$.add[0].name"),
        (SceneDiff(move={"ball": Placement()}, remove=["ball"]), "no obstacle 'ball'", "ball", "$.move.ball"),
    ],
)
def test_a_change_that_does_not_fit_is_refused_and_names_what(diff, fault, obstacle, path):
    with pytest.raises(SceneInvalid, match=fault) as refused:
        apply_change(HALL, diff)
    assert (refused.value.details["obstacle"], refused.value.details["path"]) == (obstacle, path)


@given(st.lists(st.sampled_from("abcdef"), unique=True), st.lists(st.sampled_from("abcdef"), unique=True))
def test_a_change_and_its_opposite_leave_the_same_obstacles(before, after):
    def ball(name: str) -> Sphere:
        return Sphere(name=name, radius=1.0)

    scene = Scene("s", obstacles=[ball(name) for name in before])
    add, remove = [ball(n) for n in after if n not in before], [n for n in before if n not in after]
    there = apply_change(scene, SceneDiff(add=add, remove=remove))
    assert set(names(there)) == set(after)
    back = apply_change(there, SceneDiff(add=[ball(n) for n in remove], remove=[one.name for one in add]))
    assert sorted(names(back)) == sorted(before)


PLAN = {"robot": "ur5", "goal": {"type": "joints", "positions": {}}}


@pytest.mark.parametrize("encoding", list(Encoding))
def test_a_request_tells_its_scene_whole_or_by_its_base(encoding):
    def decoded(scene):
        return codec.decode(
            codec.encode(msgspec.convert({**PLAN, "scene": scene}, dict), encoding), PlanRequest, encoding
        )

    by_base = decoded({"base": "hall", "version": 3, "remove": ["crate"]}).scene
    assert (by_base.base, by_base.version, by_base.remove, by_base.name) == ("hall", 3, ["crate"], "")
    whole = decoded(msgspec.to_builtins(HALL)).scene
    assert type(whole) is Scene
    assert whole == HALL
    sent = codec.encode(PlanRequest("ur5", whole, decoded("hall").goal), encoding)
    assert codec.decode(sent, PlanRequest, encoding).scene == HALL
    assert b"base" not in sent


@pytest.mark.parametrize(
    ("scene", "fault"),
    [
        ({}, "missing required field `name`"),
        ({"obstacles": []}, "missing required field `name`"),
        ({"name": "mine", "add": [{"type": "sphere", "name": "b", "radius": 1}]}, "`add` needs `base`"),
        ({"name": "mine", "version": 2}, "`version` needs `base`"),
        (
            {"base": "hall", "obstacles": [{"type": "sphere", "name": "b", "radius": 1}]},
            "`obstacles` can't stand beside",
        ),
        ({"base": "hall", "version": 0}, "`int` >= 1"),
        ({"base": "hall", "moves": {}}, "moves"),
        ({"base": "hall", "add": [{"type": "sphere", "name": "b", "radius": -1}]}, "radius|> 0"),
    ],
)
def test_a_scene_that_is_neither_is_refused(scene, fault):
    with pytest.raises(MalformedRequest, match=fault) as refused:
        codec.decode_request({**PLAN, "scene": scene})
    assert refused.value.details["path"].startswith("$.scene")


def test_two_of_one_name_in_a_change_are_refused_with_their_path():
    twins = [Sphere(name="a", radius=0.1), Sphere(name="a", radius=0.2)]
    with pytest.raises(SceneInvalid, match="two obstacles 'a'") as refused:
        apply_change(HALL, SceneDiff(add=twins))
    assert refused.value.details == {"obstacle": "a", "path": "$.add[1].name"}


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
