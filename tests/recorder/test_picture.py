"""A recording as a person sees it: drawn by the real viewer, in software where there is no graphics hardware."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

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
