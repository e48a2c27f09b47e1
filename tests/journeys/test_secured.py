"""A service as `guidefield secure` sets it up: who gets in, and who may do what."""

import json
import queue
import stat
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import trustme
import zenoh
from typer.testing import CliRunner

from guidefield import Box, Client, NoService, NotAllowed, Potential, Scene, UnknownObject
from guidefield.cli import app
from guidefield.cli.serving import free_port
from guidefield.messages.replies import Progress
from tests.journeys.service import (
    ANSWERED_WITHIN,
    CONNECTED_WITHIN,
    LONG,
    PlainClient,
    Service,
    await_that,
    running_service,
)

NEAR_A_BOX = Potential(scene=Scene("s", obstacles=[Box(name="b", size=(1.0, 1.0, 1.0))]), points=[(2.0, 0.0, 0.0)])
SHORT: dict[str, Any] = {
    "robot": "xarm7",
    "scene": "table",
    "goal": {"type": "joints", "positions": {}},
    "guide_planes": [],
    "allowed_planning_time": 60.0,
    "recording": "off",
}
RECORDED: dict[str, Any] = {**SHORT, "recording": "summary"}
BRIEF = 1.0  # how long somebody tries who won't get in [s]
ROLES = {"--operator": ["cell"], "--user": ["alice", "bob"], "--onlooker": ["visitor"]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("secured") / "keys"
    names = [word for option, names in ROLES.items() for name in names for word in (option, name)]
    done = CliRunner().invoke(app, ["secure", str(folder), *names])
    assert done.exit_code == 0, done.output
    assert {Path(line).name for line in done.output.split()} == {path.name for path in folder.iterdir()}
    return folder


@pytest.fixture(scope="module")
def service(folder: Path) -> Iterator[Service]:
    options = ("--workers", "1", "--config", str(folder / "service.json5"))
    with running_service(folder / "data", *options, at="tls/localhost") as service:
        yield service


def _as(folder: Path, service: Service, name: str) -> Client:
    return Client.connect(service.endpoint, config=folder / f"{name}.json5", wait=CONNECTED_WITHIN)


def _session(folder: Path, service: Service, name: str) -> zenoh.Session:
    """A session that does what it likes."""
    config = zenoh.Config.from_file(str(folder / f"{name}.json5"))
    config.insert_json5("connect/endpoints", json.dumps([service.endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def test_what_holds_a_secret_is_for_who_wrote_it_alone(folder: Path) -> None:
    secret = {path.name for path in folder.glob("*.*") if stat.S_IMODE(path.stat().st_mode) == 0o600}
    assert secret == {"service.key", "users.txt", "cell.json5", "alice.json5", "bob.json5", "visitor.json5"}
    passwords = dict(line.split(":") for line in (folder / "users.txt").read_text().split())
    assert len(set(passwords.values())) == 4
    for path in folder.glob("*.json5"):
        assert {name for name, secret in passwords.items() if secret in path.read_text()} <= {path.stem}


def test_nothing_is_written_over_and_names_have_one_role(folder: Path, tmp_path: Path) -> None:
    for words, told in (
        ([str(folder)], "holds service.json5"),
        ([str(tmp_path), "--user", "operator"], "each name has one role"),
        ([str(tmp_path), "--user", "a/b"], "user 'a/b' must be"),
        ([str(tmp_path), "--host", "robots.example:7447"], "without protocol and port, got 'robots.example:7447'"),
    ):
        refused = CliRunner().invoke(app, ["secure", *words])
        assert told in str(refused.exception)
    assert not list(tmp_path.iterdir())


def test_an_address_with_colons_is_one_of_zenoh(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["secure", str(tmp_path), "--host", "::1"])
    assert done.exit_code == 0, done.output
    assert '"tls/[::1]:7447"' in (tmp_path / "operator.json5").read_text()


def test_an_operator_may_do_everything(folder: Path, service: Service) -> None:
    with _as(folder, service, "cell") as client:
        assert client.kinematics(NEAR_A_BOX)
        heard: list[object] = []
        reply = client.plan(RECORDED, progress=heard.append)
        assert reply.status.name == "SUCCESS"
        assert heard
        assert client.recording(reply.run_id)[:3] == b"RRF"
        client.delete_run(reply.run_id)
        identity = client.info().identity
    assert (identity.user, identity.access_control) == ("plain", True)


def test_a_stream_is_fed_and_heard_by_its_user_alone(folder: Path, service: Service) -> None:
    heard: list[zenoh.Sample] = []
    foreign = b'{"time": 9.0}'
    with (
        _as(folder, service, "alice") as alice,
        _session(folder, service, "bob") as bob,
        alice.stream(robot="ur5", scene={"name": "empty", "obstacles": []}) as stream,
    ):
        key = f"guidefield/*/as/alice/streams/{stream.stream_id}"
        with bob.declare_subscriber(f"{key}/*", heard.append):
            for cycle in range(3):
                bob.put(f"{key.replace('*', 'local')}/update", b'{"time": 9.0}')
                stream.update(time=0.02 * cycle)
                answer = stream.answer(ANSWERED_WITHIN)
                assert answer.update == 0.02 * cycle  # and isn't late
        read = stream.read()
        assert (read.updates, read.last) == (3, stream.state)
        with _as(folder, service, "cell") as operator:
            assert operator.streams() == [f"alice:{stream.stream_id}"]
    assert {sample.payload.to_bytes() for sample in heard} <= {foreign}  # what it puts it hears itself


def test_a_user_may_do_everything_on_its_own_keys_and_nothing_on_others(folder: Path, service: Service) -> None:
    with _as(folder, service, "alice") as alice:
        heard: list[object] = []
        reply = alice.plan(SHORT, progress=heard.append)
        assert reply.status.name == "SUCCESS"
        # what a busy link drops of a progress isn't sent again
        await_that(lambda: heard or alice.plan(SHORT, progress=heard.append).status.name != "SUCCESS")
        assert heard
        alice.store_scene(Scene("mine"))
        identity = alice.info().identity
        assert (identity.user, identity.access_control) == ("alice", True)
        with pytest.raises(NotAllowed):
            alice.scene("bob:any")
    with Client.connect(service.endpoint, config=folder / "alice.json5", user="bob", wait=CONNECTED_WITHIN) as masked:
        for forbidden in (lambda: masked.kinematics(NEAR_A_BOX), masked.runs, masked.info):
            with pytest.raises(NoService, match="this user may have no right to ask"):
                forbidden()
    with _as(folder, service, "cell") as operator:
        assert f"alice:{reply.run_id}" in {run.run_id for run in operator.runs().runs}
        assert "alice:mine" in operator.scenes()
        operator.delete_run(f"alice:{reply.run_id}")
    with _as(folder, service, "alice") as alice:
        with pytest.raises(UnknownObject):
            alice.run(reply.run_id)
        alice.delete_scene("mine")


def test_an_onlooker_may_look_on(folder: Path, service: Service) -> None:
    with _as(folder, service, "alice") as alice, _as(folder, service, "visitor") as visitor:
        run_id = alice.plan(RECORDED).run_id
        alice.store_scene(Scene("shown"))
        assert visitor.info().workers == 1
        assert f"alice:{run_id}" not in {run.run_id for run in visitor.runs().runs}
        with pytest.raises(NotAllowed):
            visitor.run(f"alice:{run_id}")
        alice.share("runs", run_id)
        alice.share("scenes", "shown")
        assert f"alice:{run_id}" in {run.run_id for run in visitor.runs().runs}
        assert visitor.run(f"alice:{run_id}").reply is not None
        assert visitor.recording(f"alice:{run_id}")[:3] == b"RRF"
        assert visitor.scene("alice:shown") == Scene("shown")
        for changing in (
            lambda: visitor.delete_run(f"alice:{run_id}"),
            lambda: visitor.delete_scene("alice:shown"),
            lambda: visitor.unshare("scenes", "alice:shown"),
        ):
            with pytest.raises(NotAllowed, match="alone may change it"):
                changing()
        for forbidden in (
            lambda: visitor.kinematics(NEAR_A_BOX),
            lambda: visitor.plan(SHORT),
            lambda: visitor.store_scene(Scene("mine")),
            lambda: visitor.cancel("any"),
        ):
            with pytest.raises(NoService, match="this user may have no right to ask"):
                forbidden()


def test_an_onlooker_can_store_nothing_under_its_own_name_either(folder: Path, service: Service) -> None:
    """The keys of what others share take any owner: it named itself, stored a scene there and shared it."""
    scene = b'{"name": "mine", "obstacles": []}'
    urdf = b"{\"urdf\": \"<robot name='r'><link name='a'/></robot>\"}"
    with _session(folder, service, "visitor") as session:
        wire = PlainClient(session)
        for key, payload in (
            ("scenes/visitor:mine", scene),
            ("scenes/visitor:mine?delete", None),
            ("scenes/visitor:mine?share", None),
            ("robots/visitor:mine", urdf),
            ("runs/visitor:mine?delete", None),
        ):
            assert wire.refusal(f"guidefield/local/as/visitor/{key}", payload)["name"] == "NOT_ALLOWED", key
        assert wire.refusal("guidefield/local/as/visitor/scenes/visitor:mine")["name"] == "SCENE_INVALID"


def test_everybody_hears_how_far_a_run_is_that_is_shared(folder: Path, service: Service) -> None:
    """An onlooker heard nothing of any run; of what isn't shared nobody but its user and operators hears."""
    heard: dict[str, queue.Queue[Progress]] = {name: queue.Queue() for name in ("visitor", "bob", "secret")}
    with (
        _as(folder, service, "alice") as alice,
        _as(folder, service, "visitor") as visitor,
        _as(folder, service, "bob") as bob,
        visitor.watching_run("alice:shown", heard["visitor"].put),
        bob.watching_run("alice:shown", heard["bob"].put),
        bob.watching_run("alice:secret", heard["secret"].put),
        ThreadPoolExecutor(1) as thread,
    ):
        for name in ("secret", "shown"):
            begun = threading.Event()
            asked = thread.submit(alice.plan, {**LONG, "run_id": name}, progress=lambda _, begun=begun: begun.set())
            assert begun.wait(ANSWERED_WITHIN)
            if name == "shown":
                alice.share("runs", name)
                for who in ("visitor", "bob"):
                    assert heard[who].get(timeout=ANSWERED_WITHIN).run_id == "shown"
            alice.cancel(name)
            assert asked.result(ANSWERED_WITHIN).status.name == "PREEMPTED"
    assert heard["secret"].empty()


@pytest.mark.parametrize("name", ["visitor", "bob"])
def test_nobody_but_the_service_answers_publishes_or_says_that_it_lives(name, folder, service):
    """An onlooker could do all of it."""
    own = f"guidefield/local/as/{name}"
    stolen: list[str] = []
    forged: list[str] = []
    overheard: list[str] = []
    real = threading.Event()

    def hear(sample: zenoh.Sample) -> None:
        forged.append(str(sample.key_expr)) if b"forged" in sample.payload.to_bytes() else real.set()

    def overhear(sample: zenoh.Sample) -> None:
        if b"forged" not in sample.payload.to_bytes():  # what it publishes itself stays in its session
            overheard.append(str(sample.key_expr))

    with _session(folder, service, name) as attacker, _session(folder, service, "cell") as operator:
        for key in ("guidefield/**", "guidefield/*/info", f"{own}/**", "guidefield/local/as/alice/info"):
            attacker.declare_queryable(key, lambda query: (stolen.append(str(query.key_expr)), query.drop()))
        tokens = [
            attacker.liveliness().declare_token(key)
            for key in ("guidefield/cell9/alive", "guidefield/local/as/alice/clients/x", "guidefield/local/clients/x")
        ]
        for key in ("guidefield/**", "guidefield/*/as/alice/runs/*/progress", "guidefield/*/runs/*/progress"):
            attacker.declare_subscriber(key, overhear)
        operator.declare_subscriber("guidefield/*/as/*/runs/*/progress", hear)
        for base in (own, "guidefield/local/as/alice", "guidefield/local"):
            attacker.put(f"{base}/runs/r/progress", b"forged")
        with _as(folder, service, "alice") as alice:  # what comes after has been through the same links
            assert alice.plan(SHORT).status.name == "SUCCESS"
            assert alice.info().workers == 1
        assert real.wait(CONNECTED_WITHIN)
        for key in ("guidefield/local/info", "guidefield/cell9/info", f"guidefield/cell9/as/{name}/info"):
            assert len(list(operator.get(key, timeout=10.0))) == (key == "guidefield/local/info")
        living = {str(reply.ok.key_expr) for reply in operator.liveliness().get("guidefield/**", timeout=10.0)}
        assert "guidefield/local/alive" in living
        assert not living & {str(key) for key in ("guidefield/cell9/alive", "guidefield/local/clients/x")}
        assert "guidefield/local/as/alice/clients/x" not in living
        with _session(folder, service, name) as curious:  # one with a queryable would answer itself
            for key in ("info", "as/alice/runs", "as/*/runs", "**"):
                assert list(curious.get(f"guidefield/local/{key}", timeout=10.0)) == []
        del tokens
    assert not forged
    assert not stolen
    assert not overheard


def _changed(folder: Path, changes: dict[str, str]) -> Path:
    text = (folder / "alice.json5").read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    (folder / "changed.json5").write_text(text)
    return folder / "changed.json5"


def _password(folder: Path, name: str) -> str:
    return dict(line.split(":") for line in (folder / "users.txt").read_text().split())[name]


def _other_authority(folder: Path) -> dict[str, str]:
    import base64

    found = json.loads("".join(line for line in (folder / "alice.json5").read_text().splitlines() if line[:2] != "//"))
    ours = found["transport"]["link"]["tls"]["root_ca_certificate_base64"]
    return {ours: base64.b64encode(trustme.CA().cert_pem.bytes()).decode()}


@pytest.mark.parametrize(
    "changes",
    [
        lambda folder: {_password(folder, "alice"): "a guess"},
        lambda folder: {'"user": "alice",': '"user": "nobody",'},
        lambda folder: {'"user": "alice",': '"user": "bob",'},
        _other_authority,
    ],
    ids=["wrong password", "unknown user", "another's name", "a certificate of somebody else"],
)
def test_nobody_else_gets_in(changes: Callable[[Path], dict[str, str]], folder: Path, service: Service) -> None:
    config = _changed(folder, changes(folder))
    with pytest.raises(NoService, match=r"listens, but doesn't let this client in: look at user, password") as refused:
        Client.connect(service.endpoint, config=config, wait=BRIEF)
    assert refused.value.details["endpoints"] == [service.endpoint]


def test_nobody_gets_in_by_two_doors_either(folder: Path, service: Service) -> None:
    config = _changed(folder, {_password(folder, "alice"): "a guess"})
    with free_port() as port, pytest.raises(NoService, match="doesn't let this client in"):
        Client.connect(f"tls/localhost:{port}", service.endpoint, config=config, wait=BRIEF)


def test_nobody_gets_in_without_encryption(service: Service) -> None:
    with pytest.raises(NoService, match="doesn't let this client in"):
        Client.connect(service.endpoint.replace("tls/", "tcp/"), wait=BRIEF)
