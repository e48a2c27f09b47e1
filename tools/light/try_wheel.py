"""Try the light client in its own environment against a service of another one, and say how large it is.

Usage: python tools/light/try_wheel.py LIGHT_PYTHON SERVICE_PYTHON WHEELS

Exit code 1 where the wheels are larger together than they may be; an exception where something doesn't work.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import tempfile
from pathlib import Path

MOST_BYTES = 30 * 10**6
"""Largest size of the client's wheel with those that it needs [bytes]."""
ASK = """
import sys, guidefield
from importlib.metadata import distributions, version
from guidefield import Client, JointsGoal, PlanRequest
with Client.connect(sys.argv[1], wait=120.0) as client:
    goal = JointsGoal({"elbow_joint": 1.2})
    request = PlanRequest("ur5", "table", goal, guide_planes=[], allowed_planning_time=120.0)
    reply = client.plan(request)
    served = client.info().version
assert reply.status.name == "SUCCESS", reply.status
assert served == guidefield.__version__ == version("guidefield-client"), served
heavy = {"numpy", "pinocchio", "coal", "numba", "rerun", "typer"} & set(sys.modules)
assert not heavy, heavy
try:
    guidefield.answer
except ImportError as error:
    assert "pip install guidefield" in str(error)
else:
    raise AssertionError("the light client plans")
print(*sorted(f"{one.name} {one.version}" for one in distributions()), sep=", ")
"""


def main(light: str, whole: str, wheels: Path) -> int:
    """Ask a service for a plan with the light client."""
    with socket.socket() as held, tempfile.TemporaryDirectory() as data:
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        held.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{held.getsockname()[1]}"
        serve = [whole, "-m", "guidefield", "serve", "--listen", endpoint, "--data", data, "--workers", "1"]
        with subprocess.Popen(serve, stdout=subprocess.PIPE, text=True) as service:
            assert service.stdout is not None
            assert any(line.startswith("ready") for line in service.stdout), "the service ended before it was ready"
            try:
                installed = subprocess.run(
                    [light, "-c", ASK, endpoint], check=True, capture_output=True, text=True, cwd=data
                ).stdout.strip()
            finally:
                service.terminate()
    sizes = {file.name.split("-")[0]: file.stat().st_size for file in sorted(wheels.glob("*.whl"))}
    total = sum(sizes.values())
    print(f"the light client plans; installed are {installed}")
    print(f"{total / 1e6:.1f} MB: " + ", ".join(f"{name} {size / 1e6:.2f}" for name, size in sizes.items()))
    return int(total > MOST_BYTES)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2], Path(sys.argv[3])))
