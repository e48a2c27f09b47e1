"""Robots that many tests use are prepared once for all processes that test: ``python -m tests.prepared_robots``."""

import sys

from guidefield.handlers.preparation import prepare
from tests.robots import ARMS, robot

if __name__ == "__main__":
    for name in ARMS:
        prepare(robot(name))
        sys.stdout.write(f"{name} is prepared\n")
