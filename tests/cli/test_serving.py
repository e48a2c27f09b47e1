"""A service as a process: signals end it in bounded time, systemd hears of it, quotas are read from a file."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from guidefield.cli import serving
from guidefield.cli.serving import notify_supervisor, read_quotas
from guidefield.endpoint.service import ServiceSettings
from guidefield.errors import MalformedRequest
from guidefield.messages.identities import Quota

INTERRUPTED_WHILE_IT_HOLDS_THE_EVENT = """
import os, sys
from pathlib import Path
from guidefield.cli import serving

def serve(settings, stop, announce):
    with stop._cond:  # where a thread that begins to wait is for a moment
        os.kill(os.getpid(), int(sys.argv[1]))
    assert stop.wait(200.0)
    announce("ended")
    sys.stderr.write("ended")

serving.serve = serve
serving.serve_until_signal(serving.ServiceSettings(Path("unused")), print)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_that_comes_as_a_service_begins_to_wait_ends_it(number: signal.Signals) -> None:
    command = [sys.executable, "-c", INTERRUPTED_WHILE_IT_HOLDS_THE_EVENT, str(int(number))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout == "ended\n", done.stderr
    assert done.returncode == 0


def test_a_service_says_where_its_threads_stand_and_goes_on() -> None:
    code = INTERRUPTED_WHILE_IT_HOLDS_THE_EVENT.replace(
        "assert stop", "os.kill(os.getpid(), serving.TRACE_SIGNAL); assert stop"
    )
    command = [sys.executable, "-c", code, str(int(signal.SIGTERM))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.stdout == "ended\n"
    assert "in serve" in done.stderr


def test_an_output_that_nobody_reads_does_not_hold_a_service_up() -> None:
    reading, full = full_pipe()
    command = [sys.executable, "-c", INTERRUPTED_WHILE_IT_HOLDS_THE_EVENT, str(int(signal.SIGTERM))]
    done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, timeout=300, check=False)
    assert (done.returncode, done.stderr) == (0, b"ended")
    os.close(reading)
    os.close(full)


PATIENCE = 300.0  # longer than anything here takes on a busy machine [s]

BEGINS = """
import ctypes, os, signal, sys, threading, time
from guidefield.cli import serving

def take_it():
    time.sleep(0.2)  # until the main thread waits
    signal.pthread_kill(threading.get_ident(), int(sys.argv[1]))

stop = threading.Event()
"""
IS_TOLD_IN_ANOTHER_THREAD = """
threading.Thread(target=take_it, daemon=True).start()
assert stop.wait(200.0)
print("told", flush=True)
"""
ENDS = BEGINS + "serving.end_on_signal(stop, 200.0)" + IS_TOLD_IN_ANOTHER_THREAD
SOON = "serving.DUMP_TIME_S = 2.0\n"  # where there can be no last words, they are not waited for as long as elsewhere
STAYS = BEGINS + "serving.end_on_signal(stop, 0.2)" + IS_TOLD_IN_ANOTHER_THREAD + "time.sleep(300.0)"
LINGERS = BEGINS + "serving.end_on_signal(stop, 300.0)" + IS_TOLD_IN_ANOTHER_THREAD + "time.sleep(300.0)"
KEEPS_THE_LOCK = (
    BEGINS + SOON + "serving.end_on_signal(stop, 0.2)" + IS_TOLD_IN_ANOTHER_THREAD + "ctypes.PyDLL(None).sleep(300)"
)


def _ended(program: str, number: signal.Signals = signal.SIGTERM) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", program, str(int(number))]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_that_another_thread_takes_is_heard_while_the_main_thread_waits(number: signal.Signals) -> None:
    done = _ended(ENDS, number)
    assert (done.returncode, done.stdout) == (0, "told\n"), done.stderr


def test_who_does_not_end_is_ended_by_force_and_says_where_it_stood() -> None:
    done = _ended(STAYS)
    assert done.returncode == serving.FORCED_EXIT_CODE
    assert "not ended 0.2 s after it was told to" in done.stderr
    assert "in <module>" in done.stderr


def test_who_keeps_the_interpreter_s_lock_is_ended_by_the_system() -> None:
    done = _ended(KEEPS_THE_LOCK)
    assert (done.returncode, done.stdout) == (-signal.SIGALRM, "told\n")


def test_who_is_stuck_and_can_not_say_so_is_ended_by_the_system() -> None:
    reading, full = full_pipe()
    program = STAYS.replace(BEGINS, BEGINS + SOON)
    command = [sys.executable, "-c", program, str(int(signal.SIGTERM))]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=full, timeout=PATIENCE, check=False)
    assert done.returncode == -signal.SIGALRM
    os.close(reading)
    os.close(full)


def test_a_second_signal_ends_the_process_at_once() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", LINGERS, str(int(signal.SIGTERM))], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == "told\n"
        time.sleep(0.2)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 128 + signal.SIGINT


def full_pipe() -> tuple[int, int]:
    """The two ends of a pipe that takes not one byte more."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    for size in (1 << 16, 1):
        try:
            while True:
                os.write(writing, b"x" * size)
        except BlockingIOError:
            pass
    os.set_blocking(writing, True)
    return reading, writing


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


def test_what_a_service_announces_the_supervisor_hears(systemd, tmp_path, monkeypatch):
    def serve(_settings: ServiceSettings, _stop: threading.Event, announce: object) -> None:
        assert callable(announce)
        announce("ready: instance 'local' answers")

    monkeypatch.setattr(serving, "serve", serve)
    monkeypatch.setattr(serving, "end_on_signal", lambda *_: None)
    monkeypatch.setattr(serving.faulthandler, "register", lambda _: None)
    monkeypatch.setattr(serving, "configure_logging", lambda *_, **__: None)
    serving.serve_until_signal(ServiceSettings(tmp_path), print)
    assert b"READY=1" in systemd.recv(4096)


def test_what_it_says_holds_for_whom_it_names(tmp_path: Path) -> None:
    file = tmp_path / "quotas.json"
    file.write_text(
        '{"plain": {"waiting": 8}, "default": {"per_second": 20}, "users": {"alice": {"processor_per_minute": 30}}}'
    )
    quotas = read_quotas(file)
    assert quotas.of("plain") == Quota(waiting=8)
    assert quotas.of("alice") == Quota(processor_per_minute=30.0)
    assert quotas.of("bob") == Quota(per_second=20.0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "quotas.json"),
        ('{"user": {}}', "did you mean `users`"),
        ('{"plain": {"waiting": 0}}', "plain.waiting"),
        ('{"default": {"per_second": -1}}', "default.per_second"),
        ('{"default": {"bytes": 0}}', "default.bytes"),
        ('{"users": {"plain": {}}}', "user 'plain' must be"),
        ('{"users": {"a/b": {}}}', "user 'a/b' must be"),
    ],
)
def test_a_mistake_in_it_is_told_with_its_place(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "quotas.json"
    file.write_text(text)
    with pytest.raises(MalformedRequest, match=says):
        read_quotas(file)
