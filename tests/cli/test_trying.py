"""The page on which a goal and obstacles are dragged: it plans at each change."""

import html
import io
import socket
import urllib.request
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import viser
from rich.console import Console

from guidefield.cli import trying
from guidefield.cli.serving import free_port
from guidefield.cli.trying import TryPage
from guidefield.errors import MalformedRequest
from guidefield.messages.scene import Box
from guidefield.messages.values import Placement
from guidefield.viewer import LOOPBACK


@pytest.fixture(scope="module")
def page() -> Iterator[tuple[TryPage, str]]:
    """The page of a UR5 at a table, and its address."""
    with free_port() as port:
        server = viser.ViserServer(host=LOOPBACK, port=port, verbose=False)
        yield TryPage(server, "ur5", "table"), f"http://{LOOPBACK}:{port}"
        server.stop()


def test_a_goal_that_is_dragged_is_planned_for(page: tuple[TryPage, str]) -> None:
    tried, _ = page
    tried._handle.position = tried._handle.position + np.array([0.0, 0.15, 0.1])
    tried._aim()
    tried._plan()
    assert "SUCCESS" in tried._report.content
    assert "free: the trajectory" in tried._report.content
    assert len(tried._frames) > 10
    np.testing.assert_allclose(tried._frames[-1][-1, :3], tried._handle.position, atol=1e-3)


def test_an_obstacle_may_be_dragged_while_a_plan_is_asked_for(page, monkeypatch):
    tried, _ = page
    obstacle: Any = next(one for one in tried._message.obstacles if hasattr(one, "position"))
    asked: list[Any] = []

    class LookedUp(str):
        """A name at whose look-up another obstacle is dragged."""

        def __hash__(self) -> int:
            if len(tried._state.moved) == 1:
                tried._move(obstacle.name, Placement(obstacle.position))
            return super().__hash__()

    def refuse(request: Any) -> None:
        asked.append(request)
        raise MalformedRequest("asked")

    monkeypatch.setattr(tried, "_engine", SimpleNamespace(answer=refuse))
    tried._state.moved = {LookedUp("box"): Placement((0.0, 0.0, 0.0))}
    tried._plan()
    assert obstacle.name in tried._state.moved
    tried._state.moved.clear()
    assert [list(request.scene.move) for request in asked] == [["box"]]


def test_a_goal_out_of_reach_is_told(page: tuple[TryPage, str]) -> None:
    tried, _ = page
    before = tried._handle.position.copy()
    tried._handle.position = np.array([9.0, 0.0, 0.5])
    tried._aim()
    tried._plan()
    assert "NO_IK_SOLUTION" in tried._report.content
    tried._handle.position = before
    tried._aim()


def _put_box_at_goal(tried: TryPage) -> None:
    if not tried._state.added:
        tried._add_box()
    tried._move("box 1", Placement(tuple(tried._handle.position.tolist())))


def test_an_obstacle_that_is_moved_counts(page: tuple[TryPage, str]) -> None:
    tried, _ = page
    _put_box_at_goal(tried)
    assert tried._chosen.value == "box 1"
    tried._plan()
    assert "GOAL_IN_COLLISION" in tried._report.content
    assert "box 1" in tried._report.content


def test_names_are_shown_as_they_are(page: tuple[TryPage, str]) -> None:
    tried, _ = page
    name = "<img src=x>|`a`"
    tried._state.added.append(Box(name=name, size=(0.2, 0.2, 0.2), position=tuple(tried._handle.position.tolist())))
    tried._plan()
    tried._state.added.pop()
    assert "GOAL_IN_COLLISION" in tried._report.content
    assert name not in tried._report.content
    assert name in html.unescape(tried._report.content)


def test_the_page_tells_where_it_is_if_its_port_is_occupied(monkeypatch, capsys):
    def interrupt(*_arguments: object) -> None:
        urllib.request.urlopen(find_address(out.getvalue())).close()
        raise KeyboardInterrupt

    def find_address(told: str) -> str:
        return next(word for word in told.split() if word.startswith("http://"))

    out, opened = io.StringIO(), list[str]()
    monkeypatch.setattr(trying, "has_display", lambda: True)
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr(trying, "TryPage", lambda *_: SimpleNamespace(run=interrupt))
    with socket.create_server((LOOPBACK, 0)) as other:
        port = other.getsockname()[1]
        trying.serve_page("ur5", "table", port, Console(file=out))
    assert not find_address(out.getvalue()).endswith(f":{port}")
    assert out.getvalue().startswith(f"port {port} is occupied; the page is at ")
    assert opened == [find_address(out.getvalue())]
    assert capsys.readouterr().out == ""
