"""systemd is told how a start goes, in the datagrams that it reads."""

import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from guidefield.cli import serving
from guidefield.cli.serving import notify_supervisor
from guidefield.endpoint.service import ServiceSettings


@pytest.fixture
def systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """What systemd listens with."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.settimeout(60.0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield listening


@pytest.mark.parametrize(
    ("sentence", "datagram"),
    [
        ("compiling kernels: 26 of 66", b"STATUS=compiling kernels: 26 of 66"),
        ("ready: it answers\nat tcp", b"STATUS=ready: it answers at tcp\nREADY=1"),
        ("stopping: what waits is refused", b"STATUS=stopping: what waits is refused\nSTOPPING=1"),
    ],
)
def test_a_sentence_is_a_datagram(systemd: socket.socket, sentence: str, datagram: bytes) -> None:
    notify_supervisor(sentence)
    assert systemd.recv(4096) == datagram


def test_a_supervisor_that_reads_nothing_keeps_nobody_waiting(systemd: socket.socket) -> None:
    for _ in range(10_000):
        notify_supervisor("x" * 1000)
    assert systemd.recv(4096).startswith(b"STATUS=xxx")


def test_what_a_service_announces_the_supervisor_hears(
    systemd: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def serve(_settings: ServiceSettings, _stop: threading.Event, announce: object) -> None:
        assert callable(announce)
        announce("ready: instance 'local' answers")

    monkeypatch.setattr(serving, "serve", serve)
    monkeypatch.setattr(serving, "end_on_signal", lambda *_: None)
    monkeypatch.setattr(serving.faulthandler, "register", lambda _: None)
    monkeypatch.setattr(serving, "configure_logging", lambda *_, **__: None)
    serving.serve_until_signal(ServiceSettings(tmp_path), print)
    assert b"READY=1" in systemd.recv(4096)
