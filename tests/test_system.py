"""Files and the system: whole files or none, processes by the ways of Linux and others, log lines for machines."""

import io
import json
import logging
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from guidefield import system
from guidefield.system import Journal, JsonLines
from guidefield.whole_file import write_whole

GONE = 2**22 + 1  # no process has that id: it is above Linux's largest
ENDS_AFTER = (
    "import time; from guidefield.pool.process import end_after; end_after(0); print(flush=True); time.sleep(300)"
)


def test_resident_memory_is_what_linux_counts() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    assert system.resident(os.getpid()) == pytest.approx(pages * resource.getpagesize(), rel=0.05)
    assert system.resident(GONE) == 0


def test_the_time_of_processors_is_the_same_by_both_ways() -> None:
    until = time.process_time() + 0.05
    while time.process_time() < until:
        pass
    precise, told = system.processor_time(os.getpid()), system.psutil_processor_time(os.getpid())
    assert precise == pytest.approx(time.process_time(), abs=0.05)
    assert told == pytest.approx(precise, abs=0.05)
    assert system.processor_time(GONE) == system.psutil_processor_time(GONE) == 0.0


def test_a_worker_ends_with_its_parent_where_the_system_does_not_see_to_it() -> None:
    with subprocess.Popen([sys.executable, "-c", ENDS_AFTER], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as child:
        assert child.stdout.readline() == b"\n"
        assert child.poll() is None
        child.stdin.close()
        assert child.wait(60.0) == -signal.SIGKILL


def test_a_line_is_one_object_whatever_is_said() -> None:
    try:
        raise ValueError("with\na line break")
    except ValueError as error:
        trace = (type(error), error, error.__traceback__)
    record = logging.LogRecord("guidefield.pool", logging.ERROR, __file__, 1, 'run %s: "é"\n', ("r1",), trace)
    line = JsonLines().format(record)
    assert "\n" not in line
    told = json.loads(line)
    assert (told["level"], told["logger"], told["message"]) == ("ERROR", "guidefield.pool", 'run r1: "é"\n')
    assert "ValueError: with" in told["trace"]


@pytest.mark.parametrize(
    ("level", "number"), [(logging.DEBUG, 7), (logging.INFO, 6), (logging.WARNING, 4), (logging.ERROR, 3), (50, 2)]
)
def test_a_line_in_the_journal_begins_with_its_level(level: int, number: int) -> None:
    record = logging.LogRecord("guidefield", level, __file__, 1, "one\ntwo", (), None)
    assert Journal(logging.Formatter("%(message)s")).format(record) == f"<{number}>one\n<{number}>two"


@pytest.mark.parametrize("told", [True, False])
def test_a_process_whose_errors_go_to_the_journal_logs_for_it(tmp_path: Path, told: bool) -> None:
    script = (
        "import logging; from guidefield.system import configure_logging\n"
        "configure_logging(20, json=False); logging.warning('so')"
    )
    with (tmp_path / "log").open("w") as log:
        there = os.fstat(log.fileno())
        stream = {"JOURNAL_STREAM": f"{there.st_dev}:{there.st_ino}"} if told else {}
        subprocess.run([sys.executable, "-c", script], check=True, stderr=log, env={**os.environ, **stream})
    line = (tmp_path / "log").read_text()
    assert line == "<4>WARNING root: so\n" if told else line.startswith("20")


def test_a_file_is_written_and_replaced(tmp_path: Path) -> None:
    for durable, data in ((True, b"old"), (False, b"new"), (True, b"")):
        write_whole(tmp_path / "reply.json", data, durable=durable)
        assert (tmp_path / "reply.json").read_bytes() == data
    assert list(tmp_path.iterdir()) == [tmp_path / "reply.json"]


@pytest.mark.parametrize("durable", [True, False])
def test_a_write_that_fails_leaves_the_old_contents_and_nothing_else(tmp_path, monkeypatch, durable):
    path = tmp_path / "reply.json"
    write_whole(path, b"old")

    class FullDisk(io.FileIO):
        def write(self, data: object) -> int:
            super().write(b"n")
            raise OSError(28, "No space left on device")

    def opened(file: Path, mode: str) -> FullDisk:
        return FullDisk(file, mode)

    monkeypatch.setattr(Path, "open", opened)
    with pytest.raises(OSError, match="No space left"):
        write_whole(path, b"new", durable=durable)
    monkeypatch.undo()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_flush_that_fails_leaves_the_old_contents(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "reply.json"
    write_whole(path, b"old")

    def no_space_left(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", no_space_left)
    with pytest.raises(OSError, match="No space left"):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
