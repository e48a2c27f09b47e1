"""What holds for every test: which examples are drawn, and what a terminal is like."""

from __future__ import annotations

import os
from pathlib import Path

from hypothesis import HealthCheck, settings

from guidefield.kernels.jit.cache import keep_kernels_of

# The same few examples every time, or more of another day: `tools/test --hypothesis-profile=afresh`.
UNHURRIED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("the-same", UNHURRIED, derandomize=True, max_examples=40)
settings.register_profile("afresh", UNHURRIED, derandomize=False, print_blob=True)
settings.load_profile("the-same")

# What is printed is neither coloured nor cut, whatever the tests are started from.
for name in ("FORCE_COLOR", "GITHUB_ACTIONS", "PY_COLORS", "TERMINAL_WIDTH", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
    os.environ.pop(name, None)
os.environ["COLUMNS"] = "120"

# Kernels of tests: their machine code is kept by all that they depend on, as that of the package is.
keep_kernels_of("tests", Path(__file__).parent)
