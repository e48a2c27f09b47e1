"""A machine can read every line that is logged."""

from __future__ import annotations

import json
import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest

from guidefield.logs import Journal, JsonLines


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
    script = "import logging; from guidefield import logs; logs.configure(20, json=False); logging.warning('so')"
    with (tmp_path / "log").open("w") as log:
        there = os.fstat(log.fileno())
        stream = {"JOURNAL_STREAM": f"{there.st_dev}:{there.st_ino}"} if told else {}
        subprocess.run([sys.executable, "-c", script], check=True, stderr=log, env={**os.environ, **stream})
    line = (tmp_path / "log").read_text()
    assert line == "<4>WARNING root: so\n" if told else line.startswith("20")
