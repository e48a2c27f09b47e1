"""A slice of `tools/bench memory`: a worker's memory levels off under requests that all differ."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HOUSE = Path(__file__).parents[1]


def test_memory_levels_off_under_requests_that_all_differ() -> None:
    """With 64 MiB for what is found once, which are full after ten requests; each made some ten megabytes of tables."""
    given = [
        "--robots",
        "panda",
        "--requests",
        "36",
        "--every",
        "5",
        "--settled",
        "16",
        "--found",
        "64",
        "--most-growth",
        "0.15",
    ]
    done = subprocess.run(
        [sys.executable, HOUSE / "tools/bench", "memory", *given], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "SUCCESS" in done.stdout
