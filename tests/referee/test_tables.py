"""The tables of robots and of a scene hold what is declared: every triangle is in a leaf and in all about it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from guidefield.collision.world import World
from guidefield.prove import proof
from guidefield.scene import library
from guidefield.scene.scene import build
from tests.robots import group

TOOLS = Path(__file__).resolve().parents[2] / "tools"


@pytest.fixture(autouse=True)
def tools(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(TOOLS))


@pytest.mark.parametrize(("robot", "scene"), [("panda", "bookshelf")])
def test_every_node_holds_what_is_below_it(robot: str, scene: str) -> None:
    from doubting.tables import SINGLE, check_tables

    world = World.build(group(robot), build(library.read(scene)))
    out = check_tables(world)
    assert {one.name for one in world.scene.obstacles} < set(out)
    assert max(out.values()) < SINGLE


@pytest.mark.parametrize(("share", "far"), [(0.5, np.inf), (1.0 - 1e-4, 2e-4)])
def test_spheres_that_are_too_small_are_seen(share: float, far: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half a sphere loses triangles of its link; one that is little smaller is told with by how much."""
    from doubting.tables import SINGLE, check_tables

    right = proof._Nodes.shape

    def smaller(nodes: proof._Nodes, node: int, part: int) -> proof._Shape:
        shape = right(nodes, node, part)
        return shape._replace(ball=share * shape.ball) if part < 0 else shape

    monkeypatch.setattr(proof._Nodes, "shape", smaller)
    worst = max(check_tables(World.build(group("panda"), build(library.read("table")))).values())
    assert SINGLE < worst <= far
