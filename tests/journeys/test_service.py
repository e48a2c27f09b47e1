"""The service over a real session on loopback: every key, every kind of bad input, and what ends badly."""

import concurrent.futures
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from queue import Queue
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

import guidefield
from guidefield import Box, Client, NoService, Scene
from guidefield.cli.serving import free_port
from guidefield.messages.scene_changes import SceneChanged
from guidefield.system import processor_time
from tests.journeys.service import (
    ANSWERED_WITHIN,
    ENDED_WITHIN,
    LONG,
    PlainClient,
    Service,
    await_that,
    plain_client,
    running_service,
)

HOME = {"panda_joint2": -0.785398, "panda_joint4": -2.356194, "panda_joint6": 1.570796}
BALL = {"name": "ball", "obstacles": [{"type": "sphere", "name": "s", "radius": 0.1}]}
POTENTIAL = {"type": "potential", "scene": BALL, "points": [[0, 0, 1]]}
AT_WORK = 0.5  # a worker that used so much of a processor since it was given a long plan has begun with it [s]


# ---- every key, by a client that knows only the wire


def test_info(wire: PlainClient) -> None:
    info = wire.ask("guidefield/local/info")
    assert info["version"] == guidefield.__version__
    assert info["workers"] == 1
    assert set(info["schemas"]["messages"]) >= {"PlanRequest", "PlanReply", "Scene"}
    assert info["health"] == {"state": "ready", "doing": ""}
    assert info["disk"]["total"] >= info["disk"]["free"] > 0
    assert info["own_memory"] > 10 * 2**20
    assert {key["key"]: key for key in info["keys"]}["runs"]["parameters"].keys() == {
        *("status", "robot", "since", "text", "limit", "after")
    }
    assert wire.ask("guidefield/local/info?brief")["keys"] == []


def test_robots(wire: PlainClient) -> None:
    names = {robot["name"] for robot in wire.ask("guidefield/local/robots")["robots"]}
    assert {"panda", "ur5", "xarm7", "kinova"} <= names
    panda = wire.ask("guidefield/local/robots/panda")
    assert [joint["name"] for joint in panda["joints"]][:7] == [f"panda_joint{n}" for n in range(1, 8)]


def test_scenes_are_listed_stored_read_and_deleted(wire: PlainClient) -> None:
    assert "bookshelf" in wire.ask("guidefield/local/scenes")["scenes"]
    assert wire.ask("guidefield/local/scenes/bookshelf")["scene"]["name"] == "bookshelf"
    assert "stored" in wire.ask("guidefield/local/scenes/ball", BALL)["done"]
    assert wire.ask("guidefield/local/scenes/ball")["scene"]["obstacles"][0]["radius"] == 0.1
    by_name = wire.ask("guidefield/local/kinematics", {**POTENTIAL, "scene": "ball"})
    assert by_name == wire.ask("guidefield/local/kinematics", POTENTIAL)
    wire.ask("guidefield/local/scenes/ball?delete")
    assert wire.refusal("guidefield/local/scenes/ball")["name"] == "SCENE_INVALID"


def test_kinematics(wire: PlainClient) -> None:
    reply = wire.ask(
        "guidefield/local/kinematics",
        {
            "type": "forward_kinematics",
            "robot": "panda",
            "frames": ["panda_link0", "panda_hand_tcp"],
            "configurations": [HOME],
            "robot_placement": {"position": [0, 0, 1]},
        },
    )
    base, tip = reply["placements"][0]
    assert base["position"] == [0, 0, 1]
    # The Panda's data sheet: 0.3069 m before the base, 0.5903 m above it, less the 0.1034 m from flange to fingertips.
    assert tip["position"] == pytest.approx([0.3069, 0.0, 1.0 + 0.5903 - 0.1034], abs=2e-3)


def test_every_encoding_is_answered_in_itself(wire: PlainClient) -> None:
    plain = wire.ask("guidefield/local/kinematics", POTENTIAL)
    packed = wire.answer("guidefield/local/kinematics", msgspec.msgpack.encode(POTENTIAL), "application/msgpack")
    assert packed.encoding == "application/msgpack"
    assert msgspec.msgpack.decode(packed.payload) == plain
    error = wire.answer("guidefield/local/kinematics", b"\xc1", "application/msgpack")
    assert msgspec.msgpack.decode(error.payload)["name"] == "MALFORMED_REQUEST"


def test_a_payload_that_is_too_large_has_an_answer(wire: PlainClient) -> None:
    limit = wire.ask("guidefield/local/info?brief")["payload_limit"]
    for key in ("plan", "kinematics", "scenes/large", "robots/large"):
        assert wire.refusal(f"guidefield/local/{key}", b" " * (limit + 2**22))["name"] == "REQUEST_TOO_LARGE"


# ---- exactly one answer, always


UNSERVED = ["", "/nothing", "/plan/more", "/runs/r1/progress", "/scenes/*", "/**", "/robots?delete", "/scenes/.lock"]
NOT_THERE = ["/runs/nowhere", "/runs/nowhere/recording", "/robots/r2d2"]


@pytest.mark.parametrize("key", [*(f"guidefield/local{rest}" for rest in (*UNSERVED, *NOT_THERE)), "guidefield/**"])
def test_a_key_that_is_not_served_has_one_answer_that_says_so(key: str, wire: PlainClient) -> None:
    assert wire.refusal(key)["message"]


def test_a_wildcard_for_the_instance_is_answered_under_its_name(wire: PlainClient) -> None:
    assert wire.answer("guidefield/*/info").key == "guidefield/local/info"


def test_many_at_once_have_one_answer_each(wire: PlainClient) -> None:
    def asked(number: int) -> bool:
        points = [[0.0, 0.0, 1.0 + number]]
        reply = wire.ask("guidefield/local/kinematics", {**POTENTIAL, "points": points})
        distance = 1.0 + number
        return bool(np.isclose(reply["potential"][0], 4 * np.pi * 0.01 / (distance * (distance**2 - 0.01)), rtol=1e-9))

    with concurrent.futures.ThreadPoolExecutor(16) as threads:
        assert all(threads.map(asked, range(100)))


# ---- bad input: one clear error each, the service alive after it

PLAN = {"robot": "panda", "scene": "bookshelf", "start": HOME, "goal": {"type": "joints", "positions": {}}}


def _plan(**changes: Any) -> bytes:
    return json.dumps({**PLAN, **changes}).encode()


def _kinematics(**changes: Any) -> bytes:
    request = {"type": "clearance", "robot": "panda", "scene": "bookshelf", "configurations": [HOME]}
    return json.dumps({**request, **changes}).encode()


def _scene(*obstacles: dict[str, Any], planes: tuple[list[list[float]], ...] = ()) -> dict[str, Any]:
    planes_ = [{"name": f"GP{n}", "vertices": vertices} for n, vertices in enumerate(planes)]
    return {"name": "bad", "obstacles": list(obstacles), "guide_planes": planes_}


ELSEWHERE = {
    "type": "urdf",
    "text": '<robot name="r"><link name="a"><collision><geometry><mesh filename="file:///etc/passwd"/></geometry>'
    "</collision></link></robot>",
}
MESH = {"type": "mesh", "name": "m", "vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "triangles": [[0, 1, 7]]}
BENT = [[0, 0, 0], [1, 0, 0], [1, 1, 0.5], [0, 1, 0]]
BAD_INPUT = {
    "not JSON": ("plan", b"robot: panda", "MALFORMED_REQUEST", "not application/json"),
    "empty": ("plan", b"", "MALFORMED_REQUEST", "it is empty"),
    "NaN": ("plan", _plan(min_clearance=float("nan")), "MALFORMED_REQUEST", "not application/json"),
    "bad run id": ("plan", _plan(run_id="../r"), "MALFORMED_REQUEST", "run_id"),
    "a file": ("plan", _plan(robot={"type": "urdf_file", "path": "/etc/passwd"}), "ROBOT_INVALID", "local file"),
    "a mesh elsewhere": ("plan", _plan(robot=ELSEWHERE, start={}), "ROBOT_INVALID", "passwd"),
    "unknown scene": ("plan", _plan(scene="nowhere"), "SCENE_INVALID", "nowhere"),
    "mesh index": ("kinematics", _kinematics(scene=_scene(MESH)), "MALFORMED_REQUEST", "vertex 7"),
    "a scene under another name": ("scenes/a", json.dumps(_scene()).encode(), "MALFORMED_REQUEST", "'bad'"),
    "a packaged scene": ("scenes/bookshelf", b'{"name": "bookshelf"}', "SCENE_INVALID", "comes with the package"),
    "a scene that cannot be built": ("scenes/bad", json.dumps(_scene(planes=(BENT,))).encode(), "SCENE_INVALID", "GP0"),
    "a picture": ("plan", b"\x89PNG", "MALFORMED_REQUEST", "image/png"),
}


@pytest.fixture
def unharmed(wire: PlainClient) -> Iterator[None]:
    """No worker crashes meanwhile."""
    before = wire.ask("guidefield/local/info?brief")["counters"]["crashes"]
    yield
    assert wire.ask("guidefield/local/info?brief")["counters"]["crashes"] == before


@pytest.mark.usefixtures("unharmed")
@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_input_is_named_and_the_service_lives(case: str, wire: PlainClient) -> None:
    key, payload, name, says = BAD_INPUT[case]
    error = wire.refusal(f"guidefield/local/{key}", payload, "image/png" if case == "a picture" else "application/json")
    assert error["name"] == name, error
    assert says in error["message"], error
    assert wire.ask("guidefield/local/kinematics", POTENTIAL)["winding"] == [0.0]


@pytest.mark.usefixtures("unharmed")
@given(data=st.data())
@settings(max_examples=18, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_mutated_request_has_one_answer_and_is_no_bug_of_ours(data: st.DataObject, wire: PlainClient) -> None:
    key, valid = data.draw(st.sampled_from([("plan", _plan(goal={"type": "nothing"})), ("kinematics", _kinematics())]))
    payload = bytearray(valid)
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(payload) - 1))
        payload[at : at + data.draw(st.integers(0, 3))] = data.draw(st.binary(max_size=3) | st.just(b"9" * 30))
    for encoding in ("application/json", "application/msgpack"):
        answer = wire.answer(f"guidefield/local/{key}", bytes(payload), encoding)
        if not answer.is_reply and encoding == "application/json":
            assert answer.json()["name"] not in ("FAILURE", "CRASH"), answer.payload


# ---- the Python client


def test_the_client_has_typed_replies(client: Client) -> None:
    assert client.info().workers == 1
    assert client.robot("panda").tip == "panda_hand_tcp"
    assert "bookshelf" in client.scenes()
    scene = Scene("stored by the client".replace(" ", "-"), obstacles=[Box(name="b", size=(0.1, 0.1, 0.1))])
    client.store_scene(scene)
    assert client.scene(scene.name) == scene
    client.delete_scene(scene.name)
    reply = client.kinematics(guidefield.Potential(scene=scene, points=[(1.0, 0.0, 0.0)]))
    assert reply == guidefield.answer(guidefield.Potential(scene=scene, points=[(1.0, 0.0, 0.0)]))


def test_a_scene_that_changes_is_planned_in_as_it_is_by_then(client: Client) -> None:
    def potential(scene: Any) -> float:
        return client.kinematics(guidefield.Potential(scene=scene, points=[(1.0, 0.0, 0.0)])).potential[0]

    ball = guidefield.Sphere(name="ball", radius=0.1)
    near = guidefield.Sphere(name="ball", radius=0.1, position=(0.5, 0.0, 0.0))
    heard: Queue[SceneChanged] = Queue()
    client.store_scene(Scene("living", obstacles=[ball]))
    with client.watching_scene("living", heard.put):
        assert client.change_scene("living", move={"ball": {"position": [0.5, 0.0, 0.0]}}) == 2
        assert client.change_scene("living", add=[Box(name="b", size=(1, 1, 1))], remove=["ball"], version=2) == 3
        with pytest.raises(guidefield.SceneInvalid, match="has version 3, and version 2 was to be changed"):
            client.change_scene("living", remove=["b"], version=2)
        with pytest.raises(guidefield.SceneInvalid, match="no obstacle 'ball'"):
            client.change_scene("living", remove=["ball"])
        client.store_scene(Scene("living", obstacles=[near]))
        told = [heard.get(timeout=ANSWERED_WITHIN) for _ in range(3)]
    assert [(one.name, one.version) for one in told] == [("living", 2), ("living", 3), ("living", 4)]
    assert told[0].diff.move["ball"].position == (0.5, 0.0, 0.0)
    assert told[2].diff is None
    assert client.scene_version("living") == 4
    assert client.scene("living", version=2).obstacles == client.scene("living").obstacles == [near]
    assert potential({"base": "living", "version": 1}) == potential(Scene("s", obstacles=[ball]))
    moved = {"base": "living", "version": 1, "move": {"ball": {"position": [0.5, 0.0, 0.0]}}}
    assert potential(moved) == potential("living") == potential(Scene("s", obstacles=[near]))
    for ask in (lambda: client.scene("living", version=9), lambda: potential({"base": "living", "version": 9})):
        with pytest.raises(guidefield.SceneInvalid, match="no version 9; the last 4 are kept, 1 to 4"):
            ask()
    with client.watching_scene("living", heard.put):
        client.delete_scene("living")
        assert heard.get(timeout=ANSWERED_WITHIN).version is None


def test_the_client_raises_what_the_service_means(client: Client) -> None:
    with pytest.raises(guidefield.RobotInvalid, match="r2d2") as unknown:
        client.robot("r2d2")
    assert "panda" in unknown.value.details["available"]
    with pytest.raises(guidefield.SceneInvalid):
        client.scene("nowhere")
    with pytest.raises(guidefield.UnknownObject):
        client.recording("nowhere")
    with pytest.raises(guidefield.UnknownObject):
        client.delete_run("nowhere")
    with pytest.raises(guidefield.MalformedRequest):
        client.robot("a//b")
    with pytest.raises(guidefield.MalformedRequest, match="PlanRequest"):
        client.plan({"type": "info"})


def test_a_closed_client_says_so(service: Service) -> None:
    with Client.connect(service.endpoint) as client:
        assert client.alive()
    with pytest.raises(NoService, match="the client is closed"):
        client.scenes()


def test_nobody_there_is_said(service: Service) -> None:
    with free_port() as port, pytest.raises(NoService, match="nobody listens"):
        Client.connect(f"tcp/127.0.0.1:{port}", wait=0.2)
    with pytest.raises(NoService, match="no service named 'elsewhere'"):
        Client.connect(service.endpoint, instance="elsewhere", wait=0.2)
    with pytest.raises(ValueError, match="tcp/127"):
        Client.connect("127.0.0.1")


# ---- what ends badly


def test_a_killed_worker_costs_its_request_and_is_replaced(service: Service, wire: PlainClient) -> None:
    before = wire.ask("guidefield/local/info")["counters"]["crashes"]
    wire.ask("guidefield/local/kinematics", POTENTIAL)  # its worker has started: a start that fails costs no request
    (worker,) = service.workers()
    used = processor_time(worker)
    with concurrent.futures.ThreadPoolExecutor(1) as thread:
        doomed = thread.submit(wire.refusal, "guidefield/local/plan", json.dumps({**LONG, "run_id": "doomed"}).encode())
        await_that(lambda: wire.ask("guidefield/local/info?brief")["busy"])
        await_that(lambda: processor_time(worker) > used + AT_WORK)
        os.kill(worker, signal.SIGKILL)
        assert doomed.result()["name"] == "CRASH"
    assert wire.ask("guidefield/local/kinematics", POTENTIAL)["winding"] == [0.0]
    assert wire.ask("guidefield/local/info")["counters"]["crashes"] == before + 1
    assert service.workers() != [worker]


def test_a_second_service_of_the_name_is_refused(service: Service, tmp_path: Path) -> None:
    same_folder = ["--data", str(service.data)]
    connected = tmp_path / "zenoh.json5"
    connect = {"endpoints": [service.endpoint], "timeout_ms": 60_000, "exit_on_failure": True}  # before it goes on
    connected.write_text(json.dumps({"connect": connect}))
    same_network = ["--data", str(tmp_path / "data"), "--config", str(connected)]
    for options in (same_folder, same_network):
        with free_port() as port:
            second = subprocess.run(
                [sys.executable, "-m", "guidefield", "serve", "--listen", f"tcp/127.0.0.1:{port}", *options],
                check=False,
                capture_output=True,
                text=True,
                timeout=ANSWERED_WITHIN,
            )
        assert second.returncode == 2
        assert "alive" in second.stderr


def test_a_full_queue_and_a_time_that_is_up_are_answered(tmp_path: Path) -> None:
    def waiting() -> int:
        return int(wire.ask("guidefield/local/info?brief")["queue"])

    with (
        running_service(tmp_path, "--workers", "1", "--queue", "1") as service,
        plain_client(service.endpoint) as wire,
        concurrent.futures.ThreadPoolExecutor(2) as threads,
    ):
        busy = threads.submit(wire.ask, "guidefield/local/plan", {**LONG, "run_id": "busy"})
        await_that(lambda: wire.ask("guidefield/local/info?brief")["busy"])
        late = wire.ask("guidefield/local/plan", {**PLAN, "run_id": "late", "allowed_planning_time": 0.5})
        assert (late["status"]["name"], late["run_id"]) == ("TIMED_OUT", "late")
        assert late["certificate"]["collision_free"] is False
        refused = threads.submit(wire.refusal, "guidefield/local/kinematics", json.dumps(POTENTIAL).encode())
        await_that(waiting)
        assert wire.refusal("guidefield/local/kinematics", json.dumps(POTENTIAL).encode())["name"] == "SERVER_BUSY"
        assert not busy.done()
        # The end: what is being worked on may finish, but not for ever; everybody gets an answer, nothing hangs.
        service.process.send_signal(signal.SIGTERM)
        await_that(lambda: wire.ask("guidefield/local/info?brief")["health"]["state"] == "ending")
        assert wire.refusal("guidefield/local/kinematics", json.dumps(POTENTIAL).encode())["name"] == "SERVER_BUSY"
        assert service.process.wait(ENDED_WITHIN) == 0
        assert refused.result()["name"] == "SERVER_BUSY"
        assert busy.result()["status"]["name"] == "PREEMPTED"
