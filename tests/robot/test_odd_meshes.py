"""A client's robot, however odd its meshes, is served or refused: nothing of it ends the process."""

import os
import subprocess
import sys
from pathlib import Path

from guidefield.kernels.jit.cache import cache_folder


def test_a_process_survives_them(tmp_path: Path) -> None:
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "NUMBA_CACHE_DIR": str(cache_folder().parents[1])}
    command = [sys.executable, "-X", "faulthandler", "-m", "tests.robot.odd_meshes", "2", "2"]
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "2 served\n3 served\n"
