"""A recording as a person sees it: drawn by the real viewer, from where nothing hides the motion."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings, strategies as st
from PIL import Image

from guidefield.messages import scene as messages
from guidefield.recorder.view import choose_eye
from guidefield.scene.scene import build
from tests.recorder.runs import made_up

SCREENSHOT = Path(__file__).parents[2] / "tools" / "screenshot"
NO_GRAPHICS = 3


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    folder = tmp_path_factory.mktemp("picture")
    run = made_up("xarm7")
    run.record(folder / "run.rrd")
    command = [sys.executable, str(SCREENSHOT), str(folder / "run.rrd"), str(folder / "run.png"), "--time", "0.5"]
    taken = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    if taken.returncode == NO_GRAPHICS:
        reason = f"no graphics driver: {taken.stderr.strip()}"
        sys.stderr.write(f"{reason}\n")
        pytest.skip(reason)
    assert taken.returncode == 0, taken.stderr  # a missing transform, or any other complaint of a view
    return np.asarray(Image.open(folder / "run.png").convert("RGB"), int)


def test_shows_a_scene_and_not_a_blank(picture):
    height, width, _ = picture.shape
    motion = picture[height // 8 : -height // 8, : width // 2]
    assert len(np.unique(motion.reshape(-1, 3), axis=0)) > 500
    assert motion.std() > 20.0


def test_shows_the_robot_and_an_obstacle(picture):
    motion = picture[:, : picture.shape[1] * 6 // 10]
    white = (motion.min(axis=2) > 170).mean()
    spread = motion.max(axis=2) - motion.min(axis=2)
    assert white > 0.002
    assert (spread > 25).mean() > 0.01


WAY = np.linspace([0.3, 0.0, 0.5], [0.7, 0.0, 0.5], 30)
NONE = np.empty((0, 3))
JOINTS = np.linspace([0.0, 0.0, 0.0], [0.3, 0.0, 0.5], 5)


def walls(*boxes: tuple[str, tuple, tuple]) -> tuple:
    """Obstacles: boxes by name, size and position."""
    obstacles = [messages.Box(name=name, size=size, position=position) for name, size, position in boxes]
    return build(messages.Scene(name="walls", obstacles=obstacles)).obstacles


def hidden(eye: np.ndarray, points: np.ndarray, obstacles: tuple) -> dict[str, np.ndarray]:
    """Which points (n, 3) each obstacle hides from an eye, by trimesh's rays."""
    found = {}
    for obstacle in obstacles:
        mesh = trimesh.Trimesh(obstacle.vertices, obstacle.triangles, process=False)
        rays = points - eye
        places, index, _ = trimesh.ray.ray_triangle.RayMeshIntersector(mesh).intersects_location(
            np.tile(eye, (len(points), 1)), rays
        )
        before = (
            np.linalg.norm(np.reshape(places, (-1, 3)) - eye, axis=1)
            < np.linalg.norm(rays[index.astype(int)], axis=1) - 1e-6
        )
        found[obstacle.name] = np.bincount(index[before].astype(int), minlength=len(points)) > 0
    return found


@settings(max_examples=12)
@given(seed=st.integers(0, 2**32 - 1))
def test_what_hides_nothing_is_not_named(seed):
    rng = np.random.default_rng(seed)
    boxes = [(f"b{i}", tuple(rng.uniform(0.05, 0.4, 3)), tuple(rng.uniform(-0.8, 1.2, 3))) for i in range(8)]
    obstacles = walls(*boxes)
    eye = choose_eye(WAY, JOINTS, NONE, obstacles)
    assert np.isfinite(eye.position).all()
    assert eye.position[2] > eye.target[2]
    seen = np.vstack([WAY, JOINTS])
    assert (eye.target >= seen.min(axis=0)).all()
    assert (eye.target <= seen.max(axis=0)).all()
    shares = {name: points.mean() for name, points in hidden(eye.position, WAY, obstacles).items()}
    assert all(shares[name] > 0.0 for name in eye.hiding)
