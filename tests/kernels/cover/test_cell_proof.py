from __future__ import annotations

import numpy as np

from guidefield.geometry.solid import solid
from guidefield.kernels.cover.inscribed import uncovered_cells
from tests.geometry import solids

MARGIN = 1e-3
ROOT = np.array([[0.0, 0.0, 0.0, 0.11]])


def uncovered(mesh: solids.Mesh, balls: np.ndarray, room: int = 1000) -> np.ndarray:
    body, cells = solid(*mesh), np.empty((room, 5))
    return cells[: uncovered_cells(np.ascontiguousarray(balls), ROOT, MARGIN, body.tables, body.spans, cells)]


def shell(half: float, step: float, radius: float) -> np.ndarray:
    """Balls about a grid on the surface of a cube."""
    axis = np.linspace(-half, half, round(2 * half / step) + 1)
    grid = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    grid = grid[np.abs(grid).max(axis=1) > half - 1e-9]
    return np.column_stack([grid, np.full(len(grid), radius)])


def test_a_ball_about_a_box_proves_it() -> None:
    cube = solids.box((0.2, 0.2, 0.2))
    assert len(uncovered(cube, np.array([[0.0, 0.0, 0.0, 0.1 * np.sqrt(3.0) + MARGIN]]))) == 0


def test_a_hole_within_a_shell_of_balls_is_found() -> None:
    cube = solids.box((0.2, 0.2, 0.2))
    balls = shell(0.1, 0.02, 0.03)
    cells = uncovered(cube, balls, 100_000)
    assert len(cells) > 0
    assert (np.abs(cells[:, :3]).max(axis=1) < 0.08).all()
    # every point of the hole is in a cell that was found
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (600, 3))
    hole = points[~solids.in_balls(points, balls)]
    near = np.abs(hole[:, None] - cells[None, :, :3]).max(axis=2) <= cells[:, 3]
    assert len(hole) > 20
    assert near.any(axis=1).all()


def test_a_hollow_need_not_be_contained() -> None:
    room = solids.together(solids.box((0.2, 0.2, 0.2)), solids.turned(solids.box((0.16, 0.16, 0.16))))
    assert len(uncovered(room, shell(0.09, 0.02, 0.021))) == 0


def test_there_are_never_more_than_there_is_room_for() -> None:
    cube = solids.box((0.2, 0.2, 0.2))
    assert len(uncovered(cube, np.array([[0.0, 0.0, 0.0, 0.05]]), 10)) == 10
