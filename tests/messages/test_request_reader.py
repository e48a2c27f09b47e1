"""Requests in every form are read alike, and their faults told alike."""

from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest

from guidefield.errors import MalformedRequest
from guidefield.messages import codec
from guidefield.messages.codec import read_request
from guidefield.messages.requests import PlanRequest
from guidefield.messages.scene import Box, Scene
from guidefield.messages.values import Float32Array, Uint32Array
from guidefield.scene.obstacle_message import corners_in

COUNT = 2500


def boxes(count: int = COUNT) -> list[dict[str, Any]]:
    return [{"type": "box", "name": f"b{k}", "size": [0.1, 0.2, 0.3], "position": [k, 0.5, 0]} for k in range(count)]


def mesh(count: int = COUNT, **fields: Any) -> dict[str, Any]:
    vertices = [[0.1 * k, k % 7, 0.5] for k in range(count)]
    return {"type": "mesh", "name": "m", "vertices": vertices, "triangles": triangles(count), **fields}


def triangles(count: int = COUNT) -> list[list[int]]:
    return [[k, (k + 1) % count, (k + 2) % count] for k in range(count)]


def cloud(count: int = COUNT, **fields: Any) -> dict[str, Any]:
    return {"type": "point_cloud", "name": "c", "points": [[k, 0.5, 1] for k in range(count)], "radius": 0.1, **fields}


def moving(count: int = COUNT) -> dict[str, Any]:
    places = [{"position": [0.1 * k, 0, 0]} for k in range(count)]
    return {
        **boxes(1)[0],
        "name": "mover",
        "trajectory": {"times": [0.5 * k for k in range(count)], "placements": places},
    }


def plane(name: str, count: int) -> dict[str, Any]:
    return {"name": name, "vertices": [[float(k), k % 2, 1.0] for k in range(count)]}


def asked(*obstacles: dict[str, Any], **fields: Any) -> dict[str, Any]:
    goal = {"type": "joints", "positions": {"panda_joint1": 0.8}}
    return {"robot": "panda", "scene": {"name": "s", "obstacles": [*obstacles]}, "goal": goal, **fields}


def held(obstacle: dict[str, Any]) -> dict[str, Any]:
    return {"obstacle": obstacle, "link": "panda_hand"}


def configurations(count: int = COUNT) -> list[dict[str, Any]]:
    return [{"panda_joint1": 1e-4 * k, "panda_joint2": -0.5} for k in range(count)]


def rows(count: int = COUNT) -> list[list[float]]:
    return [[1e-4 * k, 0.5] for k in range(count)]


def judged(**fields: Any) -> dict[str, Any]:
    return {"type": "certify", "robot": "panda", "scene": "table", **fields}


def work(kind: str, **fields: Any) -> dict[str, Any]:
    return {"type": kind, "robot": "panda", "scene": "table", **fields}


def in_steps(*steps: dict[str, Any]) -> dict[str, Any]:
    return {"robot": "panda", "scene": "table", "steps": [*steps]}


GOALS = {"type": "joint_set", "positions": configurations()}
TRAJECTORY = {
    "positions": rows(),
    "velocities": rows(),
    "accelerations": rows(),
    "times": [0.1 * k for k in range(COUNT)],
}

LARGE: dict[str, dict[str, Any]] = {
    "boxes": asked(*boxes()),
    "all kinds": asked(mesh(), *boxes(600), cloud(), moving(), {**plane("p", 1200), "type": "polygon"}),
    "many small meshes": asked(*(mesh(99, name=f"m{k}") for k in range(30))),
    "few corners": asked(mesh(vertices=[[0.0, 0.0, 0.0]] * 3, triangles=[[0, 1, 2]] * COUNT)),
    "few triangles": asked(mesh(triangles=[[0, 1, COUNT - 1]])),
    "planes": asked(guide_planes=[plane(f"p{k}", 100) for k in range(30)]),
    "planes of the scene": {**asked(), "scene": {"name": "s", "guide_planes": [plane(f"p{k}", 300) for k in range(9)]}},
    "held": asked(*boxes(3), attached_objects=[held(mesh()), held(boxes(1)[0]), held(cloud(name="d"))]),
    "change": {**asked(), "scene": {"base": "b", "add": [*boxes(), mesh()], "remove": ["a"]}},
    "moves": {**asked(), "scene": {"base": "b", "move": {f"b{k}": {"position": [k, 0, 0]} for k in range(COUNT)}}},
    "clearance": {
        "type": "clearance",
        "robot": "panda",
        "scene": {"name": "s", "obstacles": boxes()},
        "configurations": [],
    },
    "goals": asked(goal=GOALS),
    "steps": in_steps({"goal": GOALS}, {"pause": 1.0}, {"goal": GOALS, "guide_planes": [plane("p", 900)]}),
    "planes of a step": in_steps({"pause": 1.0, "guide_planes": [plane(f"p{k}", 300) for k in range(9)]}),
    "pairs": asked(allowed_collisions=[["panda_hand", f"b{k}"] for k in range(COUNT)]),
    "path": judged(path=rows()),
    "trajectory": judged(trajectory=TRAJECTORY),
    "samples": judged(trajectory={"positions": rows()}, time_step=0.1),
    "configurations": work("clearance", configurations=configurations()),
    "starts": work("inverse_kinematics", poses=[], start_configurations=configurations()),
    "poses": work(
        "inverse_kinematics", poses=[{"position": [1, 0, k], "quaternion_xyzw": [1, 0, 0, 0]} for k in range(COUNT)]
    ),
    "points": {"type": "potential", "scene": "table", "points": [[k, 0, 1] for k in range(COUNT)]},
    "stored": {"type": "store_scene", "name": "s", "scene": {"name": "s", "obstacles": [*boxes(), mesh()]}},
}


@pytest.mark.parametrize("name", LARGE)
def test_the_same_is_made_of_every_form(name: str) -> None:
    plain = LARGE[name]
    at_one_go = codec.decode_request(codec.encode(plain))
    for given in (plain, at_one_go, {**plain, "scene": at_one_go.scene}):
        made = read_request(given)
        assert type(made) is type(at_one_go)
        assert type(made.scene) is type(at_one_go.scene)
        assert codec.encode(made) == codec.encode(at_one_go)
        assert made == at_one_go
    assert codec.decode_request(codec.encode(plain)) == at_one_go, "what was given is as it was"


@pytest.mark.parametrize("kind", [np.float64, np.float32])
def test_arrays_may_stand_for_lists(kind: Any) -> None:
    """What is large and may be packed without a loss is packed."""
    vertices, corners = np.array(mesh()["vertices"], kind), np.array(triangles(), np.int32)
    given = asked(mesh(vertices=vertices, triangles=corners), cloud(points=[*vertices]), *boxes(2))
    packed = Float32Array(vertices.tobytes()) if kind is np.float32 else vertices.tolist()
    declared = asked(
        mesh(vertices=packed, triangles=Uint32Array(corners.tobytes())), cloud(points=vertices.tolist()), *boxes(2)
    )
    assert read_request(given) == codec.decode_request(codec.encode(declared))


@pytest.mark.parametrize("kind", ["<i4", ">i4", "<i8", "<u4", "<u8", "<i2"])
def test_arrays_of_triangles_name_the_same_corners(kind: str) -> None:
    corners = np.array(triangles()).astype(kind)
    made = read_request(asked(mesh(triangles=corners)))
    assert (corners_in(made.scene.obstacles[0].triangles) == corners).all()


@pytest.mark.parametrize("wrong", [-1, COUNT, 2**32, 2**40])
def test_a_corner_that_there_is_not_is_named_whatever_the_array(wrong: int) -> None:
    corners = np.array(triangles(), np.int64)
    corners[7, 1] = wrong
    with pytest.raises(MalformedRequest, match=rf"`triangles\[7\]` names vertex {wrong}, but there are {COUNT}"):
        read_request(asked(mesh(triangles=corners)))


def test_packed_and_listed_ones_may_stand_beside_each_other() -> None:
    corners = Float32Array(np.array(mesh()["vertices"], "<f4").tobytes())
    packed = Uint32Array(np.array(triangles(), "<u4").tobytes())
    for fields in ({"vertices": corners}, {"triangles": packed}):
        given = asked(mesh(**fields))
        expected = codec.decode_request(codec.encode(given))
        assert read_request(given) == expected
        assert read_request(expected) == expected


def _wrong(change: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    made = msgspec.json.decode(codec.encode(LARGE["all kinds"]))
    change(made)
    return made


FAULTS: dict[str, Callable[[dict[str, Any]], object]] = {
    "goal": lambda made: made.update(goal={"type": "joint", "positions": {}}),
    "planes": lambda made: made.update(guide_planes={"name": "p"}),
    "planes of a word": lambda made: made.update(guide_planes="automatic"),
    "field of a scene": lambda made: made["scene"].update(obstacle=[]),
    "kind": lambda made: made["scene"]["obstacles"][7].update(type="bx"),
    "size": lambda made: made["scene"]["obstacles"][577]["size"].append(1.0),
    "field": lambda made: made["scene"]["obstacles"][577].update(sise=1.0),
    "name twice": lambda made: made["scene"]["obstacles"][577].update(name="b3"),
    "no obstacle": lambda made: made["scene"]["obstacles"].insert(550, None),
    "corner": lambda made: made["scene"]["obstacles"][0]["vertices"].insert(1500, [0.0, 0.0]),
    "number": lambda made: made["scene"]["obstacles"][0]["vertices"].insert(1500, [0.0, 0.0, "a"]),
    "far": lambda made: made["scene"]["obstacles"][0]["vertices"].insert(1500, [0.0, 1e10, 0.0]),
    "triangle": lambda made: made["scene"]["obstacles"][0]["triangles"].insert(1500, [0, 1, COUNT]),
    "no triangles": lambda made: made["scene"]["obstacles"][0].update(triangles=[]),
    "triangles are left out": lambda made: made["scene"]["obstacles"][0].pop("triangles"),
    "vertices are left out": lambda made: made["scene"]["obstacles"][0].pop("vertices"),
    "vertices are none": lambda made: made["scene"]["obstacles"][0].update(vertices=None),
    "vertices are a number": lambda made: made["scene"]["obstacles"][0].update(vertices=5),
    "base64": lambda made: made["scene"]["obstacles"][0].update(vertices={"float32": "AA=="}),
    "point": lambda made: made["scene"]["obstacles"][601]["points"].insert(2400, 5.0),
    "radius": lambda made: made["scene"]["obstacles"][601].update(radius=-1.0),
    "time": lambda made: made["scene"]["obstacles"][602]["trajectory"]["times"].__setitem__(700, 0.0),
    "a time is a word": lambda made: made["scene"]["obstacles"][602]["trajectory"]["times"].__setitem__(700, "a"),
    "times are left out": lambda made: made["scene"]["obstacles"][602]["trajectory"].pop("times"),
    "a place more": lambda made: made["scene"]["obstacles"][602]["trajectory"]["placements"].append({}),
    "place": lambda made: made["scene"]["obstacles"][602]["trajectory"]["placements"][777].update(
        quaternion_xyzw=[1.0, 1.0, 0.0, 0.0]
    ),
    "field of a trajectory": lambda made: made["scene"]["obstacles"][602]["trajectory"].update(speed=1.0),
    "corner of a polygon": lambda made: made["scene"]["obstacles"][603]["vertices"].append([0.0]),
    "held": lambda made: made.update(attached_objects=[held(mesh(triangles=[[0, 1, "b"]]))]),
    "too many": lambda made: made["scene"].update(obstacles=[None] * 100_001),
    "beside a base": lambda made: made["scene"].update(base="b"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_told_as_by_the_decoder(name: str) -> None:
    made = _wrong(FAULTS[name])
    with pytest.raises(MalformedRequest) as at_one_go:
        codec.convert(made, PlanRequest)
    with pytest.raises(MalformedRequest) as found:
        read_request(made)
    assert (found.value.message, found.value.details) == (at_one_go.value.message, at_one_go.value.details)


OTHER_FAULTS: dict[str, tuple[str, Callable[[dict[str, Any]], object]]] = {
    "a row is longer": ("path", lambda made: made["path"][1700].append(0.0)),
    "a number is none": ("path", lambda made: made["path"][1700].__setitem__(1, None)),
    "a number is too large": ("path", lambda made: made["path"][1700].__setitem__(1, 1e12)),
    "no rows": ("path", lambda made: made.update(path=[])),
    "no rows of positions": ("trajectory", lambda made: made["trajectory"].update(positions=[])),
    "fewer velocities": ("trajectory", lambda made: made["trajectory"]["velocities"].pop()),
    "no velocities": ("trajectory", lambda made: made["trajectory"].update(velocities=[])),
    "a time more": ("trajectory", lambda made: made["trajectory"]["times"].append(1e3)),
    "no times": ("trajectory", lambda made: made["trajectory"].update(times=[])),
    "a time is too large": ("trajectory", lambda made: made["trajectory"]["times"].__setitem__(2100, 1e12)),
    "a time is a word": ("trajectory", lambda made: made["trajectory"]["times"].__setitem__(2100, "a")),
    "both": ("trajectory", lambda made: made.update(path=rows())),
    "a word in a goal": ("goals", lambda made: made["goal"]["positions"][2000].update(panda_joint1="a")),
    "a goal too far": ("goals", lambda made: made["goal"]["positions"][2000].update(panda_joint1=1e12)),
    "no goals": ("goals", lambda made: made["goal"].update(positions=[])),
    "a word in a step": ("steps", lambda made: made["steps"][2]["goal"]["positions"][700].update(panda_joint1="a")),
    "a field in a step": ("steps", lambda made: made["steps"][2].update(speed=1.0)),
    "a goal and steps": ("steps", lambda made: made.update(goal=GOALS)),
    "too many steps": ("steps", lambda made: made.update(steps=[{}] * 201)),
    "a corner in a step": ("planes of a step", lambda made: made["steps"][0]["guide_planes"][7]["vertices"].append([])),
    "a pair of three": ("pairs", lambda made: made["allowed_collisions"][900].append("b")),
    "a pose": ("poses", lambda made: made["poses"][900].update(quaternion_xyzw=[1.0, 1.0, 0.0, 0.0])),
    "a point": ("points", lambda made: made["points"][900].__setitem__(2, 1e12)),
    "a configuration": ("configurations", lambda made: made["configurations"][900].update(panda_joint1=[1e12])),
    "a start": ("starts", lambda made: made["start_configurations"][900].update(panda_joint1=1e12)),
}


@pytest.mark.parametrize("name", OTHER_FAULTS)
def test_a_fault_of_other_lists_is_too(name: str) -> None:
    kind, change = OTHER_FAULTS[name]
    made = msgspec.json.decode(codec.encode(LARGE[kind]))
    change(made)
    with pytest.raises(MalformedRequest) as at_one_go:
        codec.decode_request(made)
    with pytest.raises(MalformedRequest) as found:
        read_request(made)
    assert (found.value.message, found.value.details) == (at_one_go.value.message, at_one_go.value.details)


def test_arrays_may_stand_for_rows() -> None:
    arrays = {name: np.array(value) for name, value in TRAJECTORY.items()}
    assert read_request(judged(trajectory=arrays)) == codec.decode_request(judged(trajectory=TRAJECTORY))
    given = work("potential", points=np.ones((COUNT, 3), np.float32))
    del given["robot"]
    assert read_request(given).points == [(1.0, 1.0, 1.0)] * COUNT


def test_messages_in_a_dict_are_checked() -> None:
    """msgspec takes a message in a dict as it is: what is wrong in one would be found by nobody."""
    sound, box = asked(*boxes(1)), Box(name="a", size=(1.0, -1.0, 1.0))
    wrong = {
        "$.scene.name": {"scene": Scene(3)},
        "$.scene.obstacles[0].size[1]": {"scene": {"name": "s", "obstacles": [box]}},
        "$.attached_objects[0].obstacle.size[1]": {"attached_objects": [held(box)]},
    }
    for path, fields in wrong.items():
        with pytest.raises(MalformedRequest) as found:
            read_request({**sound, **fields})
        assert found.value.details["path"].startswith(path)


def test_what_newcomers_send_is_told_what_is_right() -> None:
    plan = '{"robot": "ur5", "scene": "table", "goal": {"type": "guide_plane"}}'
    assert read_request(plan) == read_request(plan.encode())
    with pytest.raises(MalformedRequest, match="the payload is not application/json"):
        read_request("request.json")
    for tagged in ({"type": "plan"}, b'{"type": "plan"}'):
        with pytest.raises(MalformedRequest, match=r"; a plan request has no `type` \(at \$\.type\)$"):
            read_request(tagged)
