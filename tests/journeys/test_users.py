"""Users who don't know each other: each on keys of its own, with a fair share, and refused beyond its quota."""

import collections
import json
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from guidefield import Client, NotAllowed, QuotaExceeded, Scene, Sphere, UnknownObject
from guidefield.messages.identities import OF_ALL, OF_USERS
from tests.journeys.service import (
    ANSWERED_WITHIN,
    CONNECTED_WITHIN,
    LONG,
    PlainClient,
    Service,
    await_that,
    plain_client,
    running_service,
)

SHORT: dict[str, Any] = {
    "robot": "xarm7",
    "scene": "table",
    "goal": {"type": "joints", "positions": {"joint1": 0.2}},
    "guide_planes": [],
    "allowed_planning_time": 60.0,
    "recording": "off",
}
RECORDED: dict[str, Any] = {**SHORT, "recording": "summary"}
QUOTAS = {"users": {"hasty": {"per_second": 2}, "patient": {"waiting": 1}, "spent": {"processor_per_minute": 0.01}}}


FLOOD = 50  # how many queries are asked at once: few enough that all of them have come before the next one is asked


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    folder = tmp_path_factory.mktemp("users")
    (folder / "quotas.json").write_text(json.dumps(QUOTAS))
    options = ("--workers", "1", "--queue", "8", "--quota", str(folder / "quotas.json"))
    with running_service(folder / "data", *options) as service:
        yield service


def _as(service: Service, user: str | None = None) -> Client:
    return Client.connect(service.endpoint, user=user, wait=CONNECTED_WITHIN)


def test_a_user_plans_and_hears_of_it_on_keys_of_its_own(service: Service) -> None:
    with _as(service, "alice") as alice:
        heard: list[object] = []
        reply = alice.plan(RECORDED, progress=heard.append)
        assert reply.status.name == "SUCCESS"
        assert heard
        assert reply.recording == f"guidefield/local/as/alice/runs/{reply.run_id}/recording"
        assert alice.recording(reply.run_id)[:3] == b"RRF"
        told = alice.info()
    assert (told.identity.user, told.identity.access_control) == ("alice", False)
    assert told.identity.quota == OF_USERS
    assert set(told.users) == {"alice"}
    assert told.users["alice"].processor > 0.0
    with _as(service) as plain:
        told = plain.info()
        assert (told.identity.user, told.identity.quota) == ("plain", OF_ALL)
        assert "alice" in told.users


def test_a_user_may_be_named_by_the_configuration(service: Service, tmp_path: Path) -> None:
    file = tmp_path / "client.json5"
    file.write_text(
        f'{{ connect: {{ endpoints: ["{service.endpoint}"] }}, metadata: {{ guidefield: {{ user: "bob" }} }} }}'
    )
    with Client.connect(config=file, wait=CONNECTED_WITHIN) as bob:
        identity = bob.info().identity
    assert identity.user == "bob"


def test_who_has_many_requests_waiting_costs_a_quiet_user_no_answer(service: Service) -> None:
    """Plans that wait, each under a client's name of its own: others were refused."""
    with plain_client(service.endpoint) as greedy, _as(service, "quiet") as quiet, ThreadPoolExecutor(40) as threads:
        payload = json.dumps({**LONG, "allowed_planning_time": 0.5}).encode()
        asked = [
            threads.submit(greedy.answer, "guidefield/local/as/greedy/plan", payload, client=f"client{number}")
            for number in range(40)
        ]
        await_that(lambda: _queue(greedy) == 8)
        for _ in range(3):
            assert quiet.plan(SHORT).status.name == "SUCCESS"
        answers = [one.result(ANSWERED_WITHIN) for one in asked]
    refused = [answer.json() for answer in answers if not answer.is_reply]
    assert len(refused) >= 20
    assert {error["name"] for error in refused} == {"SERVER_BUSY"}
    assert all(error["details"]["retry_after"] > 0.0 for error in refused)


def test_plans_of_many_seconds_of_others_hold_up_nobody(service: Service) -> None:
    """Two users have long plans waiting, and there is one worker: a quiet user waited until one of them ended."""
    patient = {**SHORT, "allowed_planning_time": ANSWERED_WITHIN}
    with (
        _as(service, "slow") as slow_one,
        _as(service, "slower") as slower_one,
        _as(service, "still") as still,
        _as(service) as operator,
        ThreadPoolExecutor(4) as threads,
    ):
        asked = [
            threads.submit(client.plan, {**LONG, "run_id": f"{name}{number}"})
            for number in range(2)
            for name, client in (("slow", slow_one), ("slower", slower_one))
        ]
        await_that(lambda: operator.info().queue >= 2)
        for _ in range(2):
            assert still.plan(patient).status.name == "SUCCESS"
        assert not any(one.done() for one in asked)
        kept = [*slow_one.runs().runs, *slower_one.runs().runs]
        assert {run.status for run in kept} <= {"RUNNING"}, "what gave way left a trace"  # it may not go on yet
        for name in ("slow", "slower"):
            for number in range(2):
                operator.cancel(f"{name}:{name}{number}")
        assert {one.result(ANSWERED_WITHIN).status.name for one in asked} == {"PREEMPTED"}


def _queue(wire: PlainClient) -> int:
    return int(wire.ask("guidefield/local/info?brief")["queue"])


def test_what_is_beyond_a_quota_is_refused_with_when_to_ask_again(service: Service) -> None:
    with _as(service, "hasty") as hasty:
        with ThreadPoolExecutor(20) as threads:
            asked = [threads.submit(hasty.scenes) for _ in range(100)]
        errors = [error for one in asked if (error := one.exception()) is not None]
        assert len(errors) > 50
        with pytest.raises(QuotaExceeded, match="2 queries a second; ask again in") as often:
            raise errors[0]
        assert 0.0 < often.value.details["retry_after"] <= 1.0  # a list may take two seconds' worth
    with _as(service, "spent") as spent:
        assert spent.plan(SHORT).status.name == "SUCCESS"
        with pytest.raises(QuotaExceeded, match=r"0\.01 s of a processor in a minute"):
            collections.deque((spent.plan(SHORT) for _ in range(20)), 0)  # some take less than that
        assert "table" in spent.scenes()
    with plain_client(service.endpoint) as wire, ThreadPoolExecutor(2) as threads:
        for name, then in (("first", {"waiting": 0, "running": 1}), ("second", {"waiting": 1, "running": 1})):
            threads.submit(
                wire.answer, "guidefield/local/as/patient/plan", json.dumps({**LONG, "run_id": name}).encode()
            )
            await_that(lambda wanted=then: _users(wire)["patient"] == wanted)
        refused = wire.refusal("guidefield/local/as/patient/plan", json.dumps(LONG).encode())
        assert (refused["name"], refused["code"], refused["details"]["waiting"]) == ("QUOTA_EXCEEDED", -109, 1)
        assert wire.ask("guidefield/local/as/other/runs/first/cancel")["done"].startswith("no run 'first' is under way")
        for name in ("second", "first"):
            assert wire.ask(f"guidefield/local/as/patient/runs/{name}/cancel")["done"] == f"run {name!r} ends"


def _users(wire: PlainClient) -> dict[str, dict[str, int]]:
    told = wire.ask("guidefield/local/info?brief")["users"]
    return {user: {name: figures[name] for name in ("waiting", "running")} for user, figures in told.items()} | {
        "patient": {name: told.get("patient", {}).get(name, 0) for name in ("waiting", "running")}
    }


def test_a_flood_of_cheap_queries_holds_up_nobody(service: Service) -> None:
    """Queries of one link don't wait for those that came before them on another one."""
    with plain_client(service.endpoint) as greedy, plain_client(service.endpoint) as quiet:

        def overtakes() -> bool:
            answers = greedy.flood("guidefield/local/as/greedy/info", FLOOD)
            await_that(lambda: answers)
            assert quiet.ask("guidefield/local/as/quiet/info?brief")["identity"]["user"] == "quiet"
            others = len(answers)
            await_that(lambda: len(answers) == FLOOD)
            told = [json.loads(answer.payload) for answer in answers if not answer.is_reply]
            assert all(refusal["name"] == "QUOTA_EXCEEDED" and refusal["details"]["retry_after"] for refusal in told)
            return others < 3 * FLOOD // 4  # where it waits for them, nearly all are answered before

        assert any(overtakes() for _ in range(20))


def test_a_name_that_nobody_can_have_is_refused(service: Service) -> None:
    with plain_client(service.endpoint) as wire:
        for user in ("plain", ".hidden", "a:b"):
            refused = wire.refusal(f"guidefield/local/as/{user}/info")
            assert refused["name"] == "MALFORMED_REQUEST"
            assert refused["details"]["user"] == user


def test_runs_scenes_and_robots_are_their_users_own(service: Service) -> None:
    ball = Scene("ball", obstacles=[Sphere(name="s", radius=0.1)])
    with _as(service, "anna") as anna, _as(service, "ben") as ben, _as(service) as operator:
        reply = anna.plan(RECORDED)
        anna.store_scene(ball)
        for forbidden in (
            lambda: ben.run(f"anna:{reply.run_id}"),
            lambda: ben.recording(f"anna:{reply.run_id}"),
            lambda: ben.delete_run(f"anna:{reply.run_id}"),
            lambda: ben.cancel(f"anna:{reply.run_id}"),
            lambda: ben.cancel_request("anna:any"),
            lambda: ben.scene("anna:ball"),
            lambda: ben.delete_scene("anna:ball"),
            lambda: ben.share("scenes", "anna:ball"),
            lambda: ben.run(f"plain:{reply.run_id}"),
            lambda: ben.plan({**SHORT, "scene": "anna:ball"}),
        ):
            with pytest.raises(NotAllowed, match=r"belongs to user '(anna|plain)', who"):
                forbidden()
        assert "anna" not in f"{ben.runs().runs} {ben.scenes()}"
        with pytest.raises(UnknownObject):
            ben.run(reply.run_id)
        assert anna.share("scenes", "ball") == "scene 'ball' can be read by everybody, as 'anna:ball'"
        assert ben.scene("anna:ball") == ball
        assert "anna:ball" in ben.scenes()
        assert ben.plan({**SHORT, "scene": "anna:ball"}).status.name == "SUCCESS"
        with pytest.raises(NotAllowed, match="alone may change it"):
            ben.delete_scene("anna:ball")
        anna.unshare("scenes", "ball")
        with pytest.raises(NotAllowed, match="doesn't share it"):
            ben.scene("anna:ball")
        name = f"anna:{reply.run_id}"
        assert name in {run.run_id for run in operator.runs().runs}
        assert operator.run(name).reply == reply
        assert operator.recording(name)[:3] == b"RRF"
        operator.delete_run(name)
        with pytest.raises(UnknownObject):
            anna.run(reply.run_id)


def test_an_operator_ends_what_is_somebodys(service: Service) -> None:
    with _as(service, "cora") as cora, _as(service) as operator, ThreadPoolExecutor(1) as thread:
        running = thread.submit(cora.plan, {**LONG, "run_id": "long"})
        await_that(lambda: operator.info().users["cora"].running if "cora" in operator.info().users else False)
        assert operator.cancel("cora:long") == "run 'long' ends"
        assert running.result(ANSWERED_WITHIN).status.name == "PREEMPTED"
