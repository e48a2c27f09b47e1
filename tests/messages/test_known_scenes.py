"""A large scene that was read before is known again while it is the same, and only then."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from guidefield.errors import MalformedRequest, RequestTooLarge
from guidefield.memory import BoundedMap, Limit
from guidefield.messages import codec
from guidefield.messages.codec import MIN_HASHED_BYTES, Encoding, read_payload, read_request
from guidefield.messages.requests import JointsGoal, PlanRequest
from guidefield.messages.scene import Box, Mesh, Obstacle, ObstacleTrajectory, Scene
from guidefield.messages.values import Placement

COUNT = 300
ASKED = {"robot": "panda", "goal": {"type": "joints", "positions": {"panda_joint1": 0.8}}}


@pytest.fixture(autouse=True)
def known(monkeypatch: pytest.MonkeyPatch) -> BoundedMap[bytes, Any]:
    """No scene is known at first."""
    scenes = BoundedMap[bytes, Any](Limit(2, 2**27))
    monkeypatch.setattr(codec, "_SCENES", scenes)
    return scenes


def crates(count: int = COUNT) -> list[Obstacle]:
    return [Box(name=f"crate {k}", size=(0.1, 0.1, 0.1), position=(0.3 * k, 0.0, 0.0)) for k in range(count)]


def sheet(count: int = COUNT) -> Mesh:
    vertices = [(0.1 * k, 0.1 * (k % 2), 0.0) for k in range(count + 2)]
    return Mesh(name="sheet", vertices=vertices, triangles=[(k, k + 1, k + 2) for k in range(count)])


def moving() -> list[Obstacle]:
    places = [Placement(), Placement((0.0, 0.1, 1.0))]
    box = Box(name="m", size=(0.1, 0.1, 0.1), trajectory=ObstacleTrajectory([0.0, 1.0], places))
    return [*crates(), box]


def asked(scene: Any, **fields: Any) -> PlanRequest:
    return PlanRequest("panda", scene, JointsGoal({"panda_joint1": 0.8}), **fields)


def read(scene: Any) -> Any:
    """The scene of a request, read; of what isn't valid, None."""
    request = {**ASKED, "scene": scene} if isinstance(scene, dict) else asked(scene)
    try:
        return read_request(request).scene
    except MalformedRequest:
        return None


@pytest.mark.parametrize("obstacles", [crates, lambda: [sheet()], lambda: [*crates(2), sheet()], moving])
def test_a_scene_in_messages_is_read_once(obstacles: Callable[[], list[Obstacle]]) -> None:
    scene = Scene("s", obstacles=obstacles())
    first, again = read_request(asked(scene)), read_request(asked(Scene("s", obstacles=obstacles()), seed=3))
    assert again.scene is first.scene is not scene
    assert (first, again) == (asked(scene), asked(scene, seed=3))


def test_any_change_of_a_scene_in_messages_is_noticed() -> None:
    mesh = sheet()
    scene = Scene("s", obstacles=[*moving(), mesh])
    first = read(scene)
    assert read(scene) is first
    changes: list[tuple[list[Any], int, Any]] = [
        (mesh.triangles, 3, (0, 1, 5)),
        (mesh.vertices, 7, (0.0, 0.0, 5e-324)),
        (scene.obstacles[-2].trajectory.placements, 1, Placement((0.0, 0.0, 2.0))),
        (scene.obstacles, 5, Box(name="other", size=(0.1, 0.1, 0.1))),
    ]
    for values, index, other in changes:
        before, values[index] = values[index], other
        assert read(scene) not in (None, first)
        values[index] = before
        assert read(scene) == first
    scene.obstacles.pop()
    assert read(scene) != first
    assert read(Scene("t", obstacles=scene.obstacles)).name == "t"


def test_whoever_changes_what_was_given_does_not_change_what_is_known() -> None:
    scene = Scene("s", obstacles=[sheet()])
    for request in (asked(scene), {**ASKED, "scene": scene}, {**ASKED, "scene": {"name": "s", "obstacles": [sheet()]}}):
        first = read_request(request).scene
        given = request["scene"] if isinstance(request, dict) else request.scene
        mesh = (given["obstacles"] if isinstance(given, dict) else given.obstacles)[0]
        kept, mesh.triangles[0] = mesh.triangles[0], (5, 6, 7)
        assert first.obstacles[0].triangles[0] == (0, 1, 2)
        mesh.triangles[0] = kept


def in_arrays(count: int = 2000) -> dict[str, Any]:
    mesh = sheet(count)
    arrays = {"vertices": np.array(mesh.vertices), "triangles": np.array(mesh.triangles, "<u4")}
    return {"name": "s", "obstacles": [{"type": "mesh", "name": "sheet", **arrays}]}


def packed(scene: dict[str, Any]) -> dict[str, Any]:
    mesh = scene["obstacles"][0]
    numbers = {
        "vertices": {"float32": mesh["vertices"].astype("<f4").tobytes()},
        "triangles": {"uint32": mesh["triangles"].tobytes()},
    }
    return {**scene, "obstacles": [mesh | numbers]}


def in_messages(scene: dict[str, Any]) -> Scene:
    mesh = scene["obstacles"][0]
    return Scene("s", obstacles=[Mesh(name="sheet", vertices=mesh["vertices"], triangles=mesh["triangles"])])


@pytest.mark.parametrize("form", [dict, packed, in_messages])
def test_what_is_given_in_arrays_is_read_once(form: Callable[[dict[str, Any]], Any]) -> None:
    made = [read(form(in_arrays())) for _ in range(2)]
    assert made[1] is made[0]
    scene = in_arrays()
    mesh = scene["obstacles"][0]
    numbers = {"vertices": mesh["vertices"].tolist(), "triangles": {"uint32": mesh["triangles"].tobytes()}}
    declared = packed(scene) if form is packed else {**scene, "obstacles": [mesh | numbers]}
    expected = codec.decode_request(codec.encode({**ASKED, "scene": declared}))
    assert made[0] == expected.scene


@pytest.mark.parametrize("form", [dict, in_messages])
def test_an_array_that_was_changed_since_is_noticed(form: Callable[[dict[str, Any]], Any]) -> None:
    arrays = in_arrays()
    given, vertices = form(arrays), arrays["obstacles"][0]["vertices"]
    first = read(given)
    vertices[-1, 2] = 1e-9
    assert read(given) is not first
    vertices[-1, 2] = 0.0
    assert read(given) is first
    vertices[0, 0] = -0.0
    assert read(given) is not first


def in_lists(count: int = COUNT) -> dict[str, Any]:
    boxes = [{"type": "box", "name": f"b{k}", "size": [0.1, 0.1, 0.1], "position": [k, 0.5, 0]} for k in range(count)]
    return {"name": "s", "obstacles": boxes, "guide_planes": []}


def test_a_scene_in_dicts_and_lists_is_read_once_and_a_change_is_noticed() -> None:
    given = in_lists()
    first = read(given)
    assert read(in_lists()) is first
    box = given["obstacles"][7]
    for other in (
        {"position": [7.0, 0.5, 0]},
        {"position": [7, 0.5, -0.0]},
        {"position": [7, 0.5, 0, 0]},
        {"position": np.array([7, 0.5, 0])},
        {"position": [7, 0.5, 2**70]},
        {"name": "b\ud800"},
        {"name": object()},
        {"charge": 1.0},
    ):
        assert (
            read({**given, "obstacles": [*given["obstacles"][:7], box | other, *given["obstacles"][8:]]}) is not first
        )
        first = read(given)
    assert read({**given, "obstacles": given["obstacles"][:-1]}) is not first
    tuples = {**box, "position": (7, np.float64(0.5), 0)}
    first = read(given)
    assert read({**given, "obstacles": [*given["obstacles"][:7], tuples, *given["obstacles"][8:]]}) is first
    box["size"][0] = 0.2
    assert read(given).obstacles[7].size[0] == 0.2


def test_a_change_of_a_stored_scene_is_never_known(known: BoundedMap[bytes, Any]) -> None:
    read({"base": "table", "add": in_lists()["obstacles"]})
    assert not len(known)


@pytest.mark.parametrize("encoding", list(Encoding))
def test_a_scene_in_a_payload_is_read_once(encoding: Encoding) -> None:
    scene = in_messages(in_arrays())
    plans = [asked(scene, seed=1), asked(scene, seed=2)]
    payloads = [codec.encode(plan, encoding) for plan in plans]
    made = [read_payload(payload, PlanRequest, encoding) for payload in payloads]
    assert made[0].scene is made[1].scene
    assert made == [codec.decode(payload, PlanRequest, encoding) for payload in payloads]
    with pytest.raises(MalformedRequest, match=r"\$.seed"):
        read_payload(codec.encode(asked(scene, seed="five"), encoding), PlanRequest, encoding)
    moved = codec.encode(asked(in_messages(in_arrays(2001))), encoding)
    assert read_payload(moved, PlanRequest, encoding).scene is not made[0].scene


def test_a_scene_is_known_wherever_it_stands_and_nowhere_else() -> None:
    """The field of the request counts that the decoder reads, whatever is around it."""
    scene, other = (codec.encode(in_messages(in_arrays(count))) for count in (2000, 2001))
    assert len(scene) > MIN_HASHED_BYTES
    fields = codec.encode(ASKED)[1:-1]
    first = read_request(b'{"scene":%s,%s}' % (scene, fields)).scene
    for around, is_first in (
        (b'{%s,"scene":SCENE}' % fields, True),
        (b'{"scene":OTHER,%s,"scene":SCENE}' % fields, True),
        (b'{"scene":SCENE,"scene":OTHER,%s}' % fields, False),
        (b'{"note":SCENE,"scene":OTHER,%s}' % fields, False),
        (b'{"scene":[SCENE],%s}' % fields, False),
        (b'{"scene":SCENE 1,%s}' % fields, False),
        (b'{"note":"SCENE","scene":OTHER,%s}' % fields, False),
        (b'{"scene":SCENE,%s' % fields, False),
        (b'{"scene":SCENE,%s}}' % fields, False),
        (b"SCENE", False),
    ):
        payload = around.replace(b"SCENE", scene).replace(b"OTHER", other)
        try:
            assert (read_request(payload).scene is first) == is_first
        except MalformedRequest:
            assert not is_first


def test_a_payload_that_is_too_large_is_refused_whatever_it_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = codec.encode(asked(in_messages(in_arrays())))
    read_request(whole)
    monkeypatch.setattr(codec, "MAX_REQUEST_BYTES", len(whole) - 1)
    with pytest.raises(RequestTooLarge):
        read_request(whole)
