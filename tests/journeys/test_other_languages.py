"""Clients in other languages: the examples run against a real service, as far as a package registry has what they need.

The one in TypeScript needs `npm install` in `tools/examples/typescript` once, or in a copy that GUIDEFIELD_TYPESCRIPT
names; it talks to a stand-in for the router's plugin. The one in Rust is not run: no registry that the project's tests
can count on has its crates.
"""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

import guidefield
from tests.journeys.service import ANSWERED_WITHIN, Service

EXAMPLES = Path(__file__).resolve().parents[2] / "tools" / "examples"
INSTALLED = Path(os.environ.get("GUIDEFIELD_TYPESCRIPT", EXAMPLES / "typescript"))
NODE = ["node", "--experimental-websocket", "--experimental-wasm-modules"]
"""Node 20 needs both; later versions have them."""


@pytest.fixture
def built(tmp_path: Path) -> Path:
    """The example, compiled: its types are checked against those of Zenoh's client."""
    if shutil.which("node") is None or not (INSTALLED / "node_modules").is_dir():
        pytest.skip("`npm install` in tools/examples/typescript installs what the example needs")
    folder = tmp_path / "typescript"
    shutil.copytree(EXAMPLES / "typescript", folder, ignore=shutil.ignore_patterns("node_modules", "build"))
    (folder / "node_modules").symlink_to(INSTALLED / "node_modules")
    done = subprocess.run(["node_modules/.bin/tsc"], check=False, capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stdout
    return folder / "build" / "plan.js"


def test_typescript_plans(built: Path, service: Service) -> None:
    pytest.importorskip("websockets", reason="it carries the stand-in for a router")
    from tests.journeys.remote_api import remote_api

    with remote_api(service.endpoint) as where:
        done = subprocess.run(
            [*NODE, built, where], check=False, capture_output=True, text=True, timeout=ANSWERED_WITHIN
        )
    assert done.returncode == 0, done.stdout + done.stderr
    goal = {"type": "joints", "positions": {"elbow_joint": 1.2}}
    here = guidefield.answer({"robot": "ur5", "scene": "table", "goal": goal, "guide_planes": []})
    assert f"SUCCESS: {here.status.message}" in done.stdout
    assert f"{here.trajectory.times[-1]:.3f} s long; the elbow is at 1.200000 then" in done.stdout
    assert f"{1e3 * here.clearance.minimum:.1f} mm between {' and '.join(here.clearance.pair)}" in done.stdout
    assert re.search(r"^\d+\.\d\d s: load$", done.stdout, re.MULTILINE)
    assert "refused, as it should be: MALFORMED_REQUEST (-107)" in done.stdout


def test_typescript_says_that_no_service_is_there(built: Path, tmp_path: Path) -> None:
    pytest.importorskip("websockets", reason="it carries the stand-in for a router")
    import zenoh

    from guidefield.cli.serving import free_port
    from tests.journeys.remote_api import remote_api

    with free_port() as port:
        config = zenoh.Config()
        config.insert_json5("listen/endpoints", f'["tcp/127.0.0.1:{port}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        with zenoh.open(config), remote_api(f"tcp/127.0.0.1:{port}") as where:
            done = subprocess.run(
                [*NODE, built, where], check=False, capture_output=True, text=True, timeout=ANSWERED_WITHIN
            )
    assert (done.returncode, done.stderr.strip().splitlines()[-1]) == (2, "no service is alive")


def test_rust_is_well_formed() -> None:
    """Its form alone: the example says itself that it isn't compiled here."""
    source = EXAMPLES / "rust" / "src" / "main.rs"
    assert "don't compile it" in source.read_text()
    if shutil.which("rustfmt") is None:
        pytest.skip("rustfmt isn't here")
    done = subprocess.run(
        ["rustfmt", "--edition", "2021", "--check", source], check=False, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


def test_the_request_in_rust_is_one() -> None:
    """The JSON in its source is read by the real codec."""
    from guidefield.messages import codec
    from guidefield.messages.requests import PlanRequest

    source = (EXAMPLES / "rust" / "src" / "main.rs").read_text()
    (text,) = re.findall(r"let request = json!\((\{.*?\})\);", source, re.DOTALL)
    (seconds,) = re.findall(r"const PLANNING_TIME: u64 = (\d+);", source)
    plain = re.sub(r",(\s*\})", r"\1", text.replace("PLANNING_TIME", seconds))
    request = codec.decode_request(plain.encode())
    assert isinstance(request, PlanRequest)
    assert request.allowed_planning_time == float(seconds)
