"""What holds for every test: which examples are drawn, in which order files come, and what a terminal is like."""

import os
import signal
from collections.abc import Generator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from guidefield.kernels.jit.cache import keep_kernels_of
from guidefield.memory import pause_collector

# The same few examples every time, or more of another day: `tools/test --hypothesis-profile=afresh`.
UNHURRIED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("the-same", UNHURRIED, derandomize=True, max_examples=25)
settings.register_profile("afresh", UNHURRIED, derandomize=False, print_blob=True)
settings.load_profile("the-same")

# What is printed is neither coloured nor cut, whatever the tests are started from.
for name in ("FORCE_COLOR", "GITHUB_ACTIONS", "PY_COLORS", "TERMINAL_WIDTH", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
    os.environ.pop(name, None)
os.environ["COLUMNS"] = "120"

# A shell has what it starts in the background ignore the first, `nohup` the second: tests send them to processes.
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)

# Kernels of tests: their machine code is kept by all that they depend on, as that of the package is.
keep_kernels_of("tests", Path(__file__).parent)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    with pause_collector():
        return (yield)


@pytest.hookimpl(tryfirst=True)  # before what is chosen by marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with most to say come first, those that wait for processes in turn with others: small ones fill the end."""
    for item in items:
        if "journeys" in item.path.parts:
            item.add_marker("journey")
    waiting = {item.path for item in items if "journeys" in item.path.parts or _starts_processes(item)}
    files = sorted({item.path for item in items}, key=lambda path: (-path.stat().st_size, path))
    kinds = [[path for path in files if (path in waiting) is waits] for waits in (True, False)]
    turns = {path: turn for kind in kinds for turn, path in enumerate(kind)}
    items.sort(key=lambda item: (turns[item.path], item.path not in waiting))


def _starts_processes(item: pytest.Item) -> bool:
    return hasattr(getattr(item, "module", None), "subprocess")
