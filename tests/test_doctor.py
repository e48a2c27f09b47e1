"""`guidefield doctor`: what it reads is what the system says otherwise, and each fault is told with what to do."""

import json
import sqlite3
from pathlib import Path

import pytest
from hypothesis import given, strategies as st
from typer.testing import CliRunner

from guidefield import doctor
from guidefield.cli import app
from guidefield.cli.serving import free_port
from guidefield.doctor import (
    SERVICE_TAKES,
    WORKER_TAKES,
    Finding,
    FindingState,
    disk,
    examination,
    kernels,
    memory_found,
    memory_limit,
    processor_quota,
    runs,
    session,
    vectors,
)
from guidefield.endpoint.link import NoAnswer, is_taken, measure_answer
from guidefield.first_start import SHIPPED, compiled_marker, level, processor
from guidefield.stores.run_file import FILE
from guidefield.stores.runs import RunDatabase
from tests.kept_runs import keep

GIB = 2**30


def test_every_check_finds_something_and_says_what_to_do(tmp_path: Path) -> None:
    found = list(examination(tmp_path))
    about = [finding.about for finding in found]
    assert about == ["packages", "cores", "vectors", "memory", "disk", "runs", "kernels", "clock", "zenoh", "graphics"]
    assert all((finding.state is FindingState.FINE) == (finding.advice == "") for finding in found)
    assert all(finding.found and "\n" not in finding.found + finding.advice for finding in found)


def test_the_command_tells_the_same_to_persons_and_machines(tmp_path: Path) -> None:
    person = CliRunner().invoke(app, ["doctor", "--data", str(tmp_path)])
    machine = CliRunner().invoke(app, ["doctor", "--data", str(tmp_path), "--json"])
    told = json.loads(machine.output)
    lines = person.output.splitlines()
    assert [line.split()[:2] for line in lines] == [[one["about"], one["state"]] for one in told]
    assert machine.exit_code == person.exit_code == int(any(one["state"] == "wrong" for one in told))


def test_what_is_wrong_is_an_exit_code(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = CliRunner().invoke(app, ["doctor", "--data", str(tmp_path / "file" / "data")])
    assert done.exit_code == 1
    assert "disk     wrong" in done.output


def test_the_vectors_are_those_that_the_compiler_knows() -> None:
    from llvmlite import binding

    features = binding.get_host_cpu_features()
    widest = next((name for name, flag in (("avx512f", "avx512f"), ("avx2", "avx2")) if features.get(flag)), None)
    if widest is not None:
        assert vectors().found.split()[0] == widest


def test_a_control_group_bounds_what_may_be_used(tmp_path: Path) -> None:
    (tmp_path / "own").write_text("0::/pod/box\n")
    group = tmp_path / "groups" / "pod" / "box"
    group.mkdir(parents=True)
    asked = tmp_path / "groups", tmp_path / "own"
    assert processor_quota(*asked) is memory_limit(*asked) is None
    (group / "cpu.max").write_text("max 100000\n")
    (group / "memory.max").write_text("max\n")
    assert processor_quota(*asked) is memory_limit(*asked) is None
    (group / "cpu.max").write_text("250000 100000\n")
    (group.parent / "cpu.max").write_text("150000 100000\n")
    (group / "memory.max").write_text(f"{4 * GIB}\n")
    assert processor_quota(*asked) == 1.5
    assert memory_limit(*asked) == 4 * GIB


@given(st.integers(0, 64 * GIB), st.integers(0, 64 * GIB), st.integers(1, 64))
def test_the_workers_that_are_advised_fit(total: int, available: int, workers: int) -> None:
    finding = memory_found(total, min(available, total), None, workers)
    free = min(available, total)
    if finding.state is FindingState.WRONG:
        assert free < SERVICE_TAKES + WORKER_TAKES
    elif "--workers" in finding.advice:
        advised = int(finding.advice.split("--workers ")[1].split(",")[0])
        assert 1 <= advised < workers
        assert SERVICE_TAKES + advised * WORKER_TAKES <= free < SERVICE_TAKES + (advised + 1) * WORKER_TAKES
    elif "--memory" in finding.advice:
        each = int(finding.advice.split("--memory ")[1].split(",")[0])
        assert SERVICE_TAKES + workers * (each << 20) <= total
        assert each << 20 >= WORKER_TAKES - (1 << 20)


def test_a_database_of_runs_is_looked_at(tmp_path: Path) -> None:
    assert runs(tmp_path / "not" / "there").state is FindingState.FINE
    (tmp_path / "runs" / "r1").mkdir(parents=True)
    assert "takes them over" in runs(tmp_path).advice
    database = RunDatabase(tmp_path)
    for number in range(300):
        keep(database, f"r{number}")
    assert "300 are kept in" in runs(tmp_path).found, "also while a service runs"
    database.close()
    assert not list(tmp_path.glob(".guidefield-*"))
    content = bytearray((tmp_path / FILE).read_bytes())
    for begin in (4096 * 8, 100):  # some rows, and where the file says what it is
        content[begin : begin + 20_000] = bytes(20_000)
        (tmp_path / FILE).write_bytes(content)
        assert runs(tmp_path).state is FindingState.WRONG
        assert ".recover" in f"{runs(tmp_path).found} {runs(tmp_path).advice}"


def test_a_folder_without_locks_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def without_locks(address: str, *arguments: object, **options: object) -> sqlite3.Connection:
        return connected(f"{address}&vfs=unix-none", *arguments, **options)

    connected = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", without_locks)
    assert runs(tmp_path).state is FindingState.WRONG
    assert "no locks or shared memory for a database; choose a data folder on a local disk" in runs(tmp_path).found


def test_kernels_are_there_once_they_are_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert kernels().state is FindingState.REMARK
    assert "compile_ahead" in kernels().advice
    compiled_marker().parent.mkdir(parents=True)
    compiled_marker().touch()
    assert kernels().state is FindingState.FINE
    assert "compiled here" in kernels().found
    assert (level() or processor()) in kernels().found
    compiled_marker().write_text(SHIPPED)
    assert kernels().found.startswith("shipped, for ")
    monkeypatch.setenv("GUIDEFIELD_PLAIN_NUMBA", "1")
    assert kernels().state is FindingState.REMARK
    (tmp_path / "file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    assert kernels().state is FindingState.WRONG


def test_a_folder_that_takes_no_file_is_told_whatever_its_rights_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """Root has every right, also where the system makes no files."""
    if not Path("/proc/self").is_dir():
        pytest.skip("this system has no such folder that is always there")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/proc/self")
    assert kernels().state is FindingState.WRONG
    assert disk(Path("/proc/self/data")).state is FindingState.WRONG


def test_a_query_on_loopback_is_answered() -> None:
    assert measure_answer() > 0.0
    assert session().state is not FindingState.WRONG


def test_a_machine_whose_sessions_get_no_answer_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def unanswered() -> float:
        raise NoAnswer("the loopback is down")

    monkeypatch.setattr(doctor, "measure_answer", unanswered)
    finding = session()
    assert finding.state is FindingState.WRONG
    assert "the loopback is down" in finding.found


def test_a_port_is_taken_where_somebody_listens(monkeypatch: pytest.MonkeyPatch) -> None:
    import socket

    with free_port() as port:
        assert not is_taken(f"tcp/127.0.0.1:{port}")
    with socket.create_server(("127.0.0.1", 0)) as server:
        held = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        assert is_taken(held)
        monkeypatch.setattr(doctor, "DEFAULT_LISTEN", held)
        assert "is taken" in session().found


def test_a_check_that_can_not_be_made_is_a_finding(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def unreadable() -> Finding:
        raise PermissionError("/proc/meminfo")

    monkeypatch.setattr("guidefield.doctor.memory", unreadable)
    (found,) = (finding for finding in examination(tmp_path) if finding.about == "memory")
    assert found.state is FindingState.WRONG
    assert "/proc/meminfo" in found.found
