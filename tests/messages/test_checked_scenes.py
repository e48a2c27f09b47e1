"""A scene that was checked before is known again while it is the same, and only then."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from guidefield.errors import MalformedRequest
from guidefield.messages import given_requests
from guidefield.messages.checked_scenes import WORTH, CheckedScenes
from guidefield.messages.requests import JointsGoal, PlanRequest
from guidefield.messages.scene import Box, GuidePlane, Mesh, PointCloud, Scene
from guidefield.messages.seen_scene import SeenScene
from guidefield.messages.values import Float32Array, Uint32Array


def crates(count: int = WORTH) -> list[Box]:
    return [Box(name=f"crate {k}", size=(0.1, 0.1, 0.1), position=(0.3 * k, 0.0, 0.0)) for k in range(count)]


def sheet(count: int = WORTH) -> Mesh:
    vertices = [(0.1 * k, 0.1 * (k % 2), 0.0) for k in range(count + 2)]
    return Mesh(name="sheet", vertices=vertices, triangles=[(k, k + 1, k + 2) for k in range(count)])


def asked(scene: Scene) -> PlanRequest:
    return PlanRequest("panda", scene, JointsGoal({"panda_joint1": 0.8}), seed=5)


@pytest.mark.parametrize("obstacles", [crates(), [sheet()], [*crates(2), sheet()]])
def test_a_scene_is_checked_once(obstacles: list[Box | Mesh]) -> None:
    scene = Scene("s", obstacles=obstacles)
    first, again = (
        given_requests.checked(asked(scene)),
        given_requests.checked(asked(Scene("s", obstacles=list(obstacles)))),
    )
    assert isinstance(first, PlanRequest)
    assert isinstance(again, PlanRequest)
    assert again.scene is first.scene
    assert again == first == asked(scene)
    assert first.scene is not scene


def test_what_is_equal_is_known_and_what_differs_is_not() -> None:
    known = CheckedScenes(2)
    made = Scene("s", obstacles=[*crates(), sheet()], guide_planes=[])
    known.keep(made, made)
    assert known.of(Scene("s", obstacles=[*crates(), sheet()])) is made
    plane = GuidePlane("p", [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
    for other in (
        Scene("t", obstacles=[*crates(), sheet()]),
        Scene("s", obstacles=[*crates()]),
        Scene("s", obstacles=[*crates(), sheet()], guide_planes=[plane]),
        Scene("s", obstacles=[*crates()[1:], crates(99)[-1], sheet()]),
    ):
        assert known.of(other) is None
    assert known.of("bookshelf") is None


def test_a_list_that_was_changed_since_is_noticed() -> None:
    known, mesh = CheckedScenes(2), sheet()
    scene = Scene("s", obstacles=[*crates(), mesh])
    known.keep(scene, msgspec.convert(msgspec.to_builtins(scene), Scene))
    assert known.of(scene) is not None
    mesh.triangles[3] = (0, 1, 5)  # type: ignore[index]
    assert known.of(scene) is None
    mesh.triangles[3] = (3, 4, 5)  # type: ignore[index]
    assert known.of(scene) is not None
    scene.obstacles.append(crates(99)[-1])
    assert known.of(scene) is None


def test_what_could_change_unnoticed_is_not_kept() -> None:
    listed = [[0.1 * k, 0.0, 0.1 * (k % 2)] for k in range(WORTH)]
    for points in (listed, np.array(listed), [np.array(point) for point in listed]):
        cloud = PointCloud(name="c", points=points, radius=0.1)  # type: ignore[arg-type]
        with pytest.raises(TypeError):
            SeenScene(Scene("s", obstacles=[cloud]))
        known = CheckedScenes(2)
        known.keep(Scene("s", obstacles=[cloud]), Scene("s"))
        assert known.of(Scene("s", obstacles=[cloud])) is None
    boxed = [Box(name=f"b{k}", size=np.full(3, 0.1)) for k in range(WORTH)]  # type: ignore[arg-type]
    known.keep(Scene("s", obstacles=boxed), Scene("s"))
    assert known.of(Scene("s", obstacles=boxed)) is None


def test_arrays_in_a_scene_that_is_compared_are_no_fault() -> None:
    known = CheckedScenes(2)
    known.keep(Scene("s", obstacles=crates()), Scene("s"))
    boxed = [Box(name=f"crate {k}", size=np.full(3, 0.1)) for k in range(WORTH)]  # type: ignore[arg-type]
    assert known.of(Scene("s", obstacles=boxed)) is None


def test_few_scenes_are_kept_and_small_ones_never() -> None:
    known = CheckedScenes(2)
    scenes = [Scene(f"s{k}", obstacles=crates()) for k in range(3)]
    for scene in scenes:
        known.keep(scene, scene)
    assert [known.of(scene) for scene in scenes] == [None, *scenes[1:]]
    few = Scene("few", obstacles=crates(3))
    known.keep(few, few)
    assert known.of(few) is None


def test_packed_points_count() -> None:
    packed = Float32Array(np.zeros(3 * WORTH, "<f4").tobytes())
    scene = Scene("s", obstacles=[PointCloud(name="c", points=packed, radius=0.1)])
    assert SeenScene(scene).parts == WORTH + 1
    triangles = Uint32Array(np.tile(np.arange(3, dtype="<u4"), WORTH).tobytes())
    mesh = Mesh(name="m", vertices=packed, triangles=triangles)
    assert SeenScene(Scene("s", obstacles=[mesh])).parts == 2 * WORTH + 1


def test_the_rest_of_a_request_is_checked_each_time() -> None:
    scene = Scene("s", obstacles=crates())
    given_requests.checked(asked(scene))
    with pytest.raises(MalformedRequest, match=r"seed"):
        given_requests.checked(msgspec.structs.replace(asked(scene), seed="five"))
    twin = Scene("s", obstacles=crates())
    twin.obstacles[7] = twin.obstacles[6]
    with pytest.raises(MalformedRequest, match=r"obstacles\[7\].name"):
        given_requests.checked(asked(twin))
