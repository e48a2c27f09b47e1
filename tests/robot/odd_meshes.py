"""Meshes that no modeller should make: thin, flat, doubled, crossed, needle-like, far away; and what robots of them do.

As a program, `python -m tests.robot.odd_meshes FIRST COUNT` takes robots of such meshes, as a client may send them, as
far as a world for batches and a field: each either is refused by name or goes all the way. That nothing ends the
process is for whoever runs it to see.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import pinocchio as pin

from guidefield.collision.batch.batch_collision import BatchCollision
from guidefield.collision.world import World
from guidefield.errors import RobotInvalid, SceneInvalid
from guidefield.messages.requests import UrdfFile
from guidefield.messages.scene import Box, Mesh, Scene
from guidefield.potential import Precision, RobotField
from guidefield.robot.catalog import Catalog
from guidefield.robot.group.reduced_model import select
from guidefield.scene.scene import build

Soup = np.ndarray  # triangles that share no vertices, shape (t, 3, 3) [m]


def odd(seed: int) -> Soup:
    """A mesh of about a hand's size that is odd in one way or in several."""
    rng = np.random.default_rng(seed)
    triangles = (_plate, _needle, _tube, _fan, _noise, _shell)[seed % 6](rng)
    if rng.random() < 0.4:  # twice, the second time hardly moved
        triangles = np.concatenate([triangles, triangles + rng.normal(size=3) * 10.0 ** rng.uniform(-17, -8)])
    if rng.random() < 0.3:  # with triangles that are points or lines
        lines = triangles[rng.integers(len(triangles), size=4)].copy()
        lines[:2, 1:], lines[2:, 2] = lines[:2, :1], lines[2:, 0]
        triangles = np.concatenate([triangles, lines])
    if rng.random() < 0.4:
        triangles = triangles + rng.normal(size=triangles.shape) * 10.0 ** rng.uniform(-16, -5)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    away = rng.normal(size=3) * 10.0 ** rng.uniform(-2, 2) if rng.random() < 0.2 else np.zeros(3)
    return triangles @ (turn if rng.random() < 0.7 else np.eye(3)) + away


def _grid(count: int, surface: np.ndarray) -> Soup:
    """Two triangles for each cell of a grid of points, shape (count + 1, count + 1, 3)."""
    a, b, c, d = surface[:-1, :-1], surface[1:, :-1], surface[1:, 1:], surface[:-1, 1:]
    return np.stack([a, b, c, a, c, d], axis=2).reshape(-1, 3, 3)[: 2 * count * count]


def _plate(rng: np.random.Generator) -> Soup:
    """Front and back of a bent plate, hardly apart or not at all; it may be open at its rim."""
    count = int(rng.integers(1, 12))
    u, v = np.meshgrid(np.linspace(-0.1, 0.1, count + 1), np.linspace(-0.06, 0.06, count + 1), indexing="ij")
    bend = rng.choice([0.0, 1e-9, 1e-4, 2.0])
    front = np.stack([u, v, bend * (u**2 + 0.3 * u * v)], axis=2)
    thickness = rng.choice([0.0, 1e-12, 1e-7, 1e-4, 1e-3])
    back = (front + np.array([0.0, 0.0, thickness]))[:, ::-1]
    return np.concatenate([_grid(count, front), _grid(count, back)])


def _needle(rng: np.random.Generator) -> Soup:
    """A tetrahedron that is much longer than wide, and wider than thick."""
    corners = rng.normal(size=(4, 3)) * 10.0 ** -rng.uniform([1, 1, 2], [1, 5, 9])
    return corners[[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]]


def _tube(rng: np.random.Generator) -> Soup:
    """A wall about an axis, of one or of two sides, without ends."""
    count = int(rng.integers(3, 24))
    turns, heights = np.meshgrid(np.linspace(0, 2 * np.pi, count + 1), np.linspace(0, 0.12, count + 1), indexing="ij")
    wall = np.stack([np.cos(turns), np.sin(turns), heights / 0.03], axis=2) * 0.03
    inner = wall * (1.0 - rng.choice([1e-9, 1e-3, 0.2]), *[1.0 - 1e-3], 1.0) if rng.random() < 0.5 else wall
    return np.concatenate([_grid(count, wall), _grid(count, inner[:, ::-1])])


def _fan(rng: np.random.Generator) -> Soup:
    """A cone with more sides than a vertex may have neighbours, perhaps flat."""
    count = int(rng.integers(3, 400))
    turns = np.linspace(0.0, 2.0 * np.pi, count + 1)
    rim = 0.05 * np.column_stack([np.cos(turns), np.sin(turns), np.zeros(count + 1)])
    ends = np.array([[0.0, 0.0, rng.choice([0.0, 1e-8, 0.1])], [0.0, 0.0, 0.0]])
    sides = [np.stack([np.broadcast_to(end, (count, 3)), rim[:-1], rim[1:]], axis=1) for end in ends]
    return np.concatenate([sides[0], sides[1][:, ::-1]])


def _noise(rng: np.random.Generator) -> Soup:
    """Triangles anywhere, on a lattice or not, so that many cross and share planes."""
    soup = rng.uniform(-0.05, 0.05, (int(rng.integers(1, 120)), 3, 3))
    if rng.random() < 0.5:
        soup = np.round(soup, 2)
    soup[..., 2] *= rng.choice([0.0, 1e-9, 1.0])
    return soup


def _shell(rng: np.random.Generator) -> Soup:
    """A bumpy ball about a smaller one that touches it, or nearly does."""
    count = int(rng.integers(3, 14))
    turns, heights = np.meshgrid(np.linspace(0, 2 * np.pi, count + 1), np.linspace(0, np.pi, count + 1), indexing="ij")
    ball = (
        np.stack([np.sin(heights) * np.cos(turns), np.sin(heights) * np.sin(turns), np.cos(heights)], axis=2)
        * 0.05
        * rng.uniform(0.8, 1.2, (count + 1, count + 1, 1))
    )
    return np.concatenate([_grid(count, ball), _grid(count, ball[:, ::-1] * rng.choice([0.3, 0.999999, 1.0]))])


def stl(triangles: Soup) -> bytes:
    """A binary STL file."""
    rows = np.zeros(len(triangles), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")]))
    rows["corners"] = triangles
    return bytes(80) + len(triangles).to_bytes(4, "little") + rows.tobytes()


def robot_of(folder: Path, seed: int) -> UrdfFile:
    """A robot in a folder whose two links are odd meshes."""
    joint = (
        '<joint name="j" type="revolute"><origin xyz="0 0 0.4"/><parent link="l0"/><child link="l1"/>'
        '<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>'
    )
    links = ""
    for index in range(2):
        (folder / f"{index}.stl").write_bytes(stl(odd(2 * seed + index)))
        links += (
            f'<link name="l{index}"><collision><geometry><mesh filename="{index}.stl"/></geometry></collision></link>'
        )
    (folder / "odd.urdf").write_text(f'<robot name="odd">{links}{joint}</robot>')
    return UrdfFile(path=str(folder / "odd.urdf"))


def all_the_way(seed: int) -> str:
    """What becomes of an odd robot among odd obstacles: a word about it."""
    corners = odd(seed + 3)
    mesh = Mesh(
        name="m",
        vertices=corners.reshape(-1, 3).tolist(),
        triangles=np.arange(3 * len(corners)).reshape(-1, 3).tolist(),
        position=(0.5, 0.0, 0.5),
    )
    box = Box(name="b", size=(0.1, 0.1, 0.1), position=(0.6, 0.4, 0.2))
    with tempfile.TemporaryDirectory() as folder:
        try:
            robot = Catalog().load(robot_of(Path(folder), seed))
            scene = build(Scene(name="odd", obstacles=[box, mesh]))
        except (RobotInvalid, SceneInvalid) as error:
            return f"refused: {error}"
        group = select(robot, None, None, robot.rest, pin.SE3.Identity())
        BatchCollision.build(World.build(group, scene, [])).touching(np.zeros((16, group.nv)))
        RobotField(group, scene, Precision.SINGLE)
        return "served"


if __name__ == "__main__":
    first, count = map(int, sys.argv[1:])
    for seed in range(first, first + count):
        sys.stdout.write(f"{seed} {all_the_way(seed)}\n")
        sys.stdout.flush()
