"""A small slice of what the long tools do: a soak with killed workers, and fuzzed requests."""

import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).resolve().parent.parent.parent / "tools"


@pytest.mark.parametrize(
    "command",
    [
        ["soak", "--requests", "8", "--seconds", "2", "--workers", "1", "--patience", "120", "--disk", "256"],
        ["isolation", "--stopped", "1", "--slow", "1", "--greedy", "1", "--seconds", "0.3", "--workers", "1"],
        ["requests", "--examples", "20", "--seed", "1", "--workers", "1"],
    ],
)
def test_a_slice_of_a_long_tool(command: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, str(TOOLS / "attack"), *command], check=False, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
