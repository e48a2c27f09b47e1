"""The examples of a secured service, as they are, with certificates of our own: who gets in, and who may do what."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
import trustme

from guidefield import Box, Client, NoService, Potential, Scene
from guidefield.cli.loopback import free_port
from tests.journeys.service import Service, running_service

EXAMPLES = Path(__file__).resolve().parent.parent.parent / "tools" / "examples" / "secured"
NEAR_A_BOX = Potential(scene=Scene("s", obstacles=[Box(name="b", size=(1.0, 1.0, 1.0))]), points=[(2.0, 0.0, 0.0)])
BRIEF = 1.0
"""How long somebody tries who won't get in [s]."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Both examples, and the files that they say lie beside them."""
    folder = tmp_path_factory.mktemp("secured")
    for example in EXAMPLES.glob("*.json5"):
        shutil.copy(example, folder)
    authority = trustme.CA()
    authority.cert_pem.write_to_path(folder / "ca.pem")
    certificate = authority.issue_cert("localhost", "127.0.0.1")
    certificate.private_key_pem.write_to_path(folder / "service.key")
    for blob in certificate.cert_chain_pems:
        blob.write_to_path(folder / "service.pem", append=True)
    (folder / "users.txt").write_text("cell:change me\nvisitor:just looking\n")
    trustme.CA().cert_pem.write_to_path(folder / "other.pem")
    return folder


@pytest.fixture(scope="module")
def service(folder: Path) -> Iterator[Service]:
    with (
        contextlib.chdir(folder),
        running_service(folder / "data", "--workers", "1", "--config", "service.json5", at="tls/localhost") as service,
    ):
        yield service


def _as(folder: Path, service: Service, *changes: tuple[str, str]) -> Client:
    text = (folder / "client.json5").read_text().replace("ca.pem", str(folder / "ca.pem"))
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "changed.json5").write_text(text)
    return Client.connect(service.endpoint, config=folder / "changed.json5", wait=BRIEF if changes else 20.0)


def test_an_operator_may_do_everything(folder: Path, service: Service) -> None:
    with _as(folder, service) as client:
        assert client.kinematics(NEAR_A_BOX)
        heard: list[object] = []
        reply = client.plan(
            {
                **{"robot": "panda", "scene": "table", "goal": {"type": "joints", "positions": {}}},
                **{"guide_planes": [], "allowed_planning_time": 60.0},
            },
            progress=heard.append,
        )
        assert reply.status.name == "SUCCESS"
        assert heard
        assert client.recording(reply.run_id)[:3] == b"RRF"
        client.delete_run(reply.run_id)


def test_an_onlooker_may_look_on(folder: Path, service: Service) -> None:
    with _as(folder, service, ('"cell"', '"visitor"'), ("change me", "just looking")) as client:
        assert client.info().workers == 1
        assert client.runs().runs is not None
        for forbidden in (
            lambda: client.kinematics(NEAR_A_BOX),
            lambda: client.delete_run("any"),
            lambda: client.store_scene(Scene("mine")),
            lambda: client.cancel("any"),
        ):
            with pytest.raises(NoService, match="this user may have no right to ask"):
                forbidden()


@pytest.mark.parametrize(
    "changes",
    [
        (("change me", "a guess"),),
        (('user: "cell"', 'user: "nobody"'),),
        (("ca.pem", "other.pem"),),
        (('auth: { usrpwd: { user: "cell", password: "change me" } },', ""),),
    ],
    ids=["wrong password", "unknown user", "a certificate of somebody else", "no user"],
)
def test_nobody_else_gets_in(changes: tuple[tuple[str, str], ...], folder: Path, service: Service) -> None:
    with pytest.raises(NoService, match=r"listens, but doesn't let this client in: look at user, password") as refused:
        _as(folder, service, *changes)
    assert refused.value.details["endpoints"] == [service.endpoint]


def test_nobody_gets_in_by_two_doors_either(folder: Path, service: Service) -> None:
    text = (folder / "client.json5").read_text().replace("ca.pem", str(folder / "ca.pem"))
    (folder / "guessed.json5").write_text(text.replace("change me", "a guess"))
    with free_port() as port, pytest.raises(NoService, match="doesn't let this client in"):
        Client.connect(f"tls/localhost:{port}", service.endpoint, config=folder / "guessed.json5", wait=BRIEF)


def test_nobody_gets_in_without_encryption(service: Service) -> None:
    with pytest.raises(NoService, match="doesn't let this client in"):
        Client.connect(service.endpoint.replace("tls/", "tcp/"), wait=BRIEF)
