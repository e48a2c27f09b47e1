"""A machine can read every line that is logged."""

from __future__ import annotations

import json
import logging

from guidefield.logs import JsonLines


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
