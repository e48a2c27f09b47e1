"""The tables of robots and of a scene hold what is declared: every triangle is in a leaf and in all about it."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from guidefield.collision.bodies import bodies
from guidefield.collision.obstacle_boxes import obstacle_boxes
from guidefield.collision.world import World
from guidefield.prove import proof
from guidefield.scene.cloud import Cloud
from guidefield.scene.scene import build
from guidefield.stores import scenes
from tests.robots import group, robot

TOOLS = Path(__file__).resolve().parents[2] / "tools"


@pytest.fixture(autouse=True)
def tools(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(TOOLS))


@pytest.mark.parametrize(("name", "scene"), [("panda", "bookshelf")])
def test_every_node_holds_what_is_below_it(name: str, scene: str) -> None:
    from doubting.tables import SINGLE, check_tables

    world = World.build(group(name), build(scenes.read_packaged(scene)))
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
    worst = max(check_tables(World.build(group("panda"), build(scenes.read_packaged("table")))).values())
    assert SINGLE < worst <= far


def test_spheres_and_boxes_hold_what_they_are_about() -> None:
    from doubting.tables import SINGLE, check_bounds, random_scene, robot_alone

    alone = check_bounds(robot_alone(robot("panda")))
    assert {f"panda_link{k}" for k in range(1, 8)} < set(alone)
    among = check_bounds(World.build(group("panda"), random_scene(np.random.default_rng(4), rounds=2)))
    assert {"many points", "the tree of obstacles", "the tree of distances"} < set(among)
    assert max(*alone.values(), *among.values()) < SINGLE


FAULTS = {
    "a sphere": lambda made: made | {"radii": 0.99 * made["radii"]},
    "smaller spheres": lambda made: made | {"part_radii": 0.9 * made["part_radii"]},
    "a box": lambda made: made | {"halves": made["halves"] - 1e-5},
    "a leaf": lambda made: made | {"nodes": np.where(made["nodes"] > 0.1, made["nodes"] - 1e-5, made["nodes"])},
    "the order": lambda made: made | {"order": np.roll(made["order"], 1)},
}
"""What spoils tables, a named tuple's or a dataclass' fields, so that they don't hold what they are about."""


@pytest.mark.parametrize("fault", FAULTS)
def test_bounds_that_are_too_small_are_seen(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from doubting import tables
    from doubting.tables import SINGLE

    def spoilt(made: Any) -> Any:
        fields = made._asdict() if hasattr(made, "_asdict") else {name: getattr(made, name) for name in vars(made)}
        return SimpleNamespace(**FAULTS[fault](fields))

    world = World.build(group("panda"), build(scenes.read_packaged("bookshelf")))
    if "sphere" in fault:
        monkeypatch.setattr(tables, "bodies", lambda of: spoilt(bodies(of)))
    else:
        monkeypatch.setattr(
            tables, "obstacle_boxes", lambda of: SimpleNamespace(tables=spoilt(obstacle_boxes(of).tables))
        )
    assert max(tables.check_bounds(world).values()) > SINGLE


@pytest.mark.parametrize("level", [0, 1, 2])
def test_points_and_boxes_of_a_cloud_that_are_moved_are_seen(level: int) -> None:
    from doubting.tables import SINGLE, _in_cloud

    points = np.random.default_rng(6).normal(size=(5000, 3))
    cloud = Cloud(points, 0.02).tables.tables
    assert max(far for _, far in _in_cloud("cloud", cloud, points)) < SINGLE
    begin, name = (0, "points") if level == 0 else (96 * int(cloud.firsts[level]), "boxes")
    moved = getattr(cloud, name).copy()
    moved[begin : begin + 16] += 1e-3  # the first x of some points, or the lower ends of boxes
    assert max(far for _, far in _in_cloud("cloud", cloud._replace(**{name: moved}), points)) > SINGLE
