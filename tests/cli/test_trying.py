"""The page on which a goal and obstacles are dragged: it plans at each change, and a browser shows it."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator

import numpy as np
import pytest
import viser
from typer.testing import CliRunner

from guidefield.cli import app
from guidefield.cli.serving import free_port
from guidefield.cli.trying import TryPage
from guidefield.messages.values import Placement
from guidefield.viewer import LOOPBACK

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
TIME_MS = 300_000  # time that a browser without a graphics card may take [ms]
ARGUMENTS = [
    *("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"),
    *("--disable-quic", "--no-first-run", "--disable-background-networking", "--disable-component-update"),
]


@pytest.fixture(scope="module")
def page() -> Iterator[tuple[TryPage, str]]:
    """The page of a UR5 at a table, and its address."""
    with free_port() as port:
        server = viser.ViserServer(host=LOOPBACK, port=port, verbose=False)
        yield TryPage(server, "ur5", "table"), f"http://{LOOPBACK}:{port}"
        server.stop()


def test_a_goal_that_is_dragged_is_planned_for(page: tuple[TryPage, str]) -> None:
    trying, _ = page
    trying._handle.position = trying._handle.position + np.array([0.0, 0.15, 0.1])
    trying._aim()
    trying._plan()
    assert "SUCCESS" in trying._report.content
    assert "free: the trajectory" in trying._report.content
    assert len(trying._frames) > 10
    np.testing.assert_allclose(trying._frames[-1][-1, :3], trying._handle.position, atol=1e-3)


def test_a_goal_out_of_reach_is_told(page: tuple[TryPage, str]) -> None:
    trying, _ = page
    before = trying._handle.position.copy()
    trying._handle.position = np.array([9.0, 0.0, 0.5])
    trying._aim()
    trying._plan()
    assert "NO_IK_SOLUTION" in trying._report.content
    trying._handle.position = before
    trying._aim()


def test_an_obstacle_that_is_moved_counts(page: tuple[TryPage, str]) -> None:
    trying, _ = page
    trying._add_box()
    assert trying._chosen.value == "box 1"
    trying._move("box 1", Placement(tuple(trying._handle.position.tolist())))
    trying._plan()
    assert "GOAL_IN_COLLISION" in trying._report.content
    assert "box 1" in trying._report.content


def test_a_browser_shows_the_page_and_plans(page: tuple[TryPage, str]) -> None:
    browser_path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser_path is None:
        pytest.skip("there is no Chromium (Debian: apt install chromium)")
    driving = pytest.importorskip("playwright.sync_api", reason="there is no playwright: it is in the extra gallery")
    trying, address = page
    threading.Thread(target=trying.run, daemon=True).start()
    trying._tell("")
    faults: list[str] = []
    with driving.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=browser_path, args=ARGUMENTS)
        shown = browser.new_page(viewport={"width": 800, "height": 500})
        shown.on("pageerror", lambda error: faults.append(str(error)))
        shown.goto(address, timeout=TIME_MS)
        shown.get_by_text("Add a box").click(timeout=TIME_MS)
        shown.get_by_text("ur5").first.wait_for(timeout=TIME_MS)
        shown.get_by_text("in contact").or_(shown.get_by_text("collision")).first.wait_for(timeout=TIME_MS)
        assert shown.locator("canvas").count() >= 1
        browser.close()
    assert faults == []


def test_a_run_or_the_page_has_to_be_named() -> None:
    done = CliRunner().invoke(app, ["show"])
    assert "name a run" in str(done.exception)
