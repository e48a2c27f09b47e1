"""A scene that was checked before is known again while it is the same, and only then."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from guidefield.errors import MalformedRequest, RequestTooLarge
from guidefield.messages import codec, given_requests, known_payloads
from guidefield.messages.checked_scenes import WORTH, CheckedScenes
from guidefield.messages.codec import Encoding
from guidefield.messages.requests import JointsGoal, PlanRequest, StoreScene
from guidefield.messages.scene import Box, GuidePlane, Mesh, ObstacleTrajectory, PointCloud, Scene
from guidefield.messages.scene_changes import RequestScene
from guidefield.messages.seen_payload import Payload
from guidefield.messages.seen_scene import SeenScene, parts_of
from guidefield.messages.values import Float32Array, Placement, Uint32Array


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


def moving(count: int = WORTH) -> list[Box]:
    return [
        Box(
            name=f"m{k}",
            size=(0.1, 0.1, 0.1),
            trajectory=ObstacleTrajectory([0.0, 1.0 + k], [Placement(), Placement((0.0, 0.1 * k, 1.0))]),
        )
        for k in range(count)
    ]


def test_what_moves_is_checked_once_and_a_change_of_its_way_is_noticed() -> None:
    known, made = CheckedScenes(2), Scene("s", obstacles=[*moving()])
    known.keep(made, made)
    assert known.of(Scene("s", obstacles=[*moving()])) is made
    rests = [*moving()[:-1], msgspec.structs.replace(moving()[-1], trajectory=None)]
    later = ObstacleTrajectory([0.0, 9.0], moving()[3].trajectory.placements)  # type: ignore[union-attr]
    others = [*moving()[:3], msgspec.structs.replace(moving()[3], trajectory=later), *moving()[4:]]
    for other in (rests, others, moving(WORTH + 1)[1:]):
        assert known.of(Scene("s", obstacles=[*other])) is None
    changed = [*moving()]
    known.keep(Scene("s", obstacles=changed), msgspec.convert(msgspec.to_builtins(made), Scene))
    changed[5].trajectory.placements[1] = Placement((0.0, 0.0, 2.0))  # type: ignore[union-attr]
    assert known.of(Scene("s", obstacles=changed)) is None
    changed[5].trajectory.placements[1] = Placement((0.0, 0.5, 1.0))  # type: ignore[union-attr]
    assert known.of(Scene("s", obstacles=changed)) is not None


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
    assert parts_of(scene) == WORTH + 1
    triangles = Uint32Array(np.tile(np.arange(3, dtype="<u4"), WORTH).tobytes())
    mesh = Mesh(name="m", vertices=packed, triangles=triangles)
    assert parts_of(Scene("s", obstacles=[mesh])) == 2 * WORTH + 1


def test_the_rest_of_a_request_is_checked_each_time() -> None:
    scene = Scene("s", obstacles=crates())
    given_requests.checked(asked(scene))
    with pytest.raises(MalformedRequest, match=r"seed"):
        given_requests.checked(msgspec.structs.replace(asked(scene), seed="five"))
    twin = Scene("s", obstacles=crates())
    twin.obstacles[7] = twin.obstacles[6]
    with pytest.raises(MalformedRequest, match=r"obstacles\[7\].name"):
        given_requests.checked(asked(twin))


def in_arrays(count: int = 2000) -> dict[str, Any]:
    sheet_ = sheet(count)
    arrays = {"vertices": np.array(sheet_.vertices), "triangles": np.array(sheet_.triangles, "<u4")}
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
def test_what_is_given_in_arrays_is_checked_once(form: Callable[[dict[str, Any]], Any]) -> None:
    scenes = [form(in_arrays()) for _ in range(2)]
    requests = [{"robot": "panda", "scene": scene, "goal": {"type": "joints", "positions": {}}} for scene in scenes]
    made = [given_requests.checked(request) for request in requests]
    assert made[1].scene is made[0].scene  # type: ignore[union-attr]
    scene = in_arrays()
    mesh = scene["obstacles"][0]
    numbers = {"vertices": mesh["vertices"].tolist(), "triangles": {"uint32": mesh["triangles"].tobytes()}}
    declared = requests[0] if form is packed else requests[0] | {"scene": {**scene, "obstacles": [mesh | numbers]}}
    assert made[0] == made[1] == codec.decode_request(codec.encode(codec.decode_request(declared)))


@pytest.mark.parametrize("form", [dict, in_messages])
def test_an_array_that_was_changed_since_is_noticed(form: Callable[[dict[str, Any]], Any]) -> None:
    known, arrays = CheckedScenes(2), in_arrays()
    given = form(arrays)
    vertices = arrays["obstacles"][0]["vertices"]
    known.keep(given, Scene("s", obstacles=crates()))
    assert known.of(given) is not None
    vertices[-1, 2] += 1e-9
    assert known.of(given) is None
    vertices[-1, 2] -= 1e-9
    vertices[0, 0] = -0.0
    assert known.of(given) is None


def test_arrays_of_another_kind_are_others() -> None:
    known, given = CheckedScenes(2), in_arrays()
    known.keep(given, Scene("s", obstacles=crates()))
    mesh = given["obstacles"][0]
    for other in (
        {"triangles": mesh["triangles"].view("<i4")},
        {"triangles": mesh["triangles"].reshape(-1)},
        {"triangles": mesh["triangles"].tobytes()},
        {"triangles": mesh["triangles"].tolist()},
        {"vertices": np.asfortranarray(mesh["vertices"])},
        {"vertices": mesh["vertices"].astype(object)},
        {"vertices": mesh["vertices"].astype(">f8")},
        {"name": "other"},
        {"name": np.array(["sheet"])},
        {"placement": object()},
    ):
        assert known.of({**given, "obstacles": [mesh | other]}) is None
    assert known.of(given) is not None
    assert known.of({**given, "obstacles": [mesh | {"vertices": mesh["vertices"].copy()}]}) is not None


def in_lists(count: int = WORTH) -> dict[str, Any]:
    boxes = [{"type": "box", "name": f"b{k}", "size": [0.1, 0.1, 0.1], "position": [k, 0.5, 0]} for k in range(count)]
    return {"name": "s", "obstacles": boxes, "guide_planes": []}


def test_a_scene_in_dicts_and_lists_is_checked_once_and_a_change_is_noticed() -> None:
    requests = [{"robot": "panda", "scene": in_lists(), "goal": {"type": "joints", "positions": {}}} for _ in range(2)]
    made = [given_requests.checked(request) for request in requests]
    assert made[1].scene is made[0].scene  # type: ignore[union-attr]
    assert made[0] == codec.decode_request(codec.encode(requests[0]))  # type: ignore[arg-type]
    known, given = CheckedScenes(2), in_lists()
    known.keep(given, Scene("s", obstacles=crates()))
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
        assert known.of({**given, "obstacles": [*given["obstacles"][:7], box | other, *given["obstacles"][8:]]}) is None
    assert known.of({**given, "obstacles": given["obstacles"][:-1]}) is None
    assert known.of({**given, "obstacles": [*given["obstacles"], box]}) is None
    assert (
        known.of(
            {
                **given,
                "obstacles": [
                    *given["obstacles"][:7],
                    {**box, "position": (7, np.float64(0.5), 0)},
                    *given["obstacles"][8:],
                ],
            }
        )
        is not None
    )
    box["size"][0] = 0.2
    assert known.of(given) is None


def test_a_change_of_a_stored_scene_is_never_known() -> None:
    known, given = CheckedScenes(2), in_arrays()
    known.keep(given, RequestScene(base="table", add=crates()))
    assert not known


@pytest.mark.parametrize("encoding", list(Encoding))
def test_a_scene_in_a_payload_is_read_once(encoding: Encoding, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(known_payloads, "_KNOWN", CheckedScenes(2))
    scene, goals = in_messages(in_arrays(10_000)), [{"panda_joint1": 0.8}, {"panda_joint1": 0.9}]
    plans = [PlanRequest("panda", scene, JointsGoal(goal), seed=index) for index, goal in enumerate(goals)]
    payloads = [codec.encode(plan, encoding) for plan in plans]
    assert min(map(len, payloads)) > known_payloads.FEWEST_BYTES
    read = [known_payloads.read(payload, PlanRequest, encoding) for payload in payloads]
    assert read[0].scene is read[1].scene
    assert read == [codec.decode(payload, PlanRequest, encoding) for payload in payloads]
    broken = codec.encode(msgspec.structs.replace(plans[0], seed="five"), encoding)  # type: ignore[arg-type]
    with pytest.raises(MalformedRequest, match=r"\$.seed"):
        known_payloads.read(broken, PlanRequest, encoding)
    moved = msgspec.structs.replace(plans[0], scene=in_messages(in_arrays(10_001)))
    assert known_payloads.read(codec.encode(moved, encoding), PlanRequest, encoding).scene is not read[0].scene


@pytest.mark.parametrize("seed", range(3))
def test_a_scene_is_known_wherever_it_stands_and_nowhere_else(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a decoder says of where a scene's bytes stand counts, whatever is around them."""
    monkeypatch.setattr(known_payloads, "_KNOWN", CheckedScenes(2))
    scene = codec.encode(in_messages(in_arrays(10_000)))
    other = codec.encode(in_messages(in_arrays(10_001)))
    asked = b'"robot":"panda","goal":{"type":"joints","positions":{}}'
    first = known_payloads.read_new(b'{"scene":%s,%s}' % (scene, asked)).scene  # type: ignore[union-attr]
    rng = np.random.default_rng(seed)
    for around in rng.permutation(
        [
            b'{%s,"scene":SCENE}' % asked,
            b'{"scene":OTHER,%s,"scene":SCENE}' % asked,
            b'{"scene":SCENE,"scene":OTHER,%s}' % asked,
            b'{"note":SCENE,"scene":OTHER,%s}' % asked,
            b'{"note":SCENE,"scene":SCENE,%s}' % asked,
            b'{"note":{"scene":SCENE},"scene":OTHER,%s}' % asked,
            b'{"scene":[SCENE],%s}' % asked,
            b'{"scene":SCENE 1,%s}' % asked,
            b'{"note":"SCENE","scene":OTHER,%s}' % asked,
            b'{"note":"\\"SCENE\\"",%s}' % asked,
            b"SCENE",
            b'{"scene":SCENE,%s' % asked,
        ]
    ).tolist():
        payload = around.replace(b"SCENE", scene).replace(b"OTHER", other)
        try:
            expected = msgspec.json.decode(payload, type=dict[str, msgspec.Raw]).get("scene") == msgspec.Raw(scene)
        except msgspec.DecodeError:
            expected = False
        assert known_payloads._KNOWN.of(Payload(payload, Encoding.JSON)) is (first if expected else None)


def test_a_payload_that_is_too_large_is_refused_whatever_it_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(known_payloads, "_KNOWN", CheckedScenes(2))
    whole = codec.encode(PlanRequest("panda", in_messages(in_arrays(10_000)), JointsGoal({"panda_joint1": 0.8})))
    known_payloads.read_new(whole)
    monkeypatch.setattr(codec, "MAX_REQUEST_BYTES", len(whole) - 1)
    with pytest.raises(RequestTooLarge):
        known_payloads.read_again(whole)


def test_a_payload_that_is_cut_off_is_told_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(known_payloads, "_KNOWN", CheckedScenes(2))
    whole = codec.encode(PlanRequest("panda", in_messages(in_arrays(10_000)), JointsGoal({"panda_joint1": 0.8})))
    first = known_payloads.read_new(whole)
    assert known_payloads.read_again(whole).scene is first.scene  # type: ignore[union-attr]
    for payload in (whole[:-1], whole + b"}", whole.replace(b'"vertices"', b'"vertexes"')):
        assert known_payloads.read_again(payload) is None
        with pytest.raises(MalformedRequest):
            known_payloads.read_new(payload)


def test_a_scene_is_stored_twice() -> None:
    store = StoreScene("s", Scene("s", obstacles=crates()))
    assert given_requests.checked(store) == given_requests.checked(store) == store
