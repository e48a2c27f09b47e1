"""Find robots of the package robot_descriptions, by name.

Downloads run in a process of their own, bounded in time.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from guidefield.errors import RobotInvalid
from guidefield.memo import memoized_by_value
from guidefield.messages.faults import find_nearest
from guidefield.messages.requests import ROBOT_DESCRIPTIONS, UrdfFile

MAX_DOWNLOAD_SECONDS = 300.0  # time that the loader may take: the first time it downloads a Git repository [s]
STALLED_SECONDS = 20  # git gives up where less than 1 kB/s has come for this time [s]

_LOADER = """
import importlib, json, sys
try:
    import robot_descriptions
except ImportError as error:
    print(json.dumps({"missing": str(error)}))
    sys.exit()
name = sys.argv[1]
if name not in robot_descriptions.DESCRIPTIONS:
    print(json.dumps({"names": sorted(robot_descriptions.DESCRIPTIONS)}))
    sys.exit()
module = importlib.import_module(f"robot_descriptions.{name}")
wanted = "URDF_PATH XACRO_PATH XACRO_ARGS MJCF_PATH SRDF_PATH PACKAGE_PATH REPOSITORY_PATH".split()
print("\\n" + json.dumps({key: getattr(module, key) for key in wanted if hasattr(module, key)}))
"""
"""Runs in a process of its own, as importing a description may download it without end."""


def is_description(name: str) -> bool:
    """Tell whether a robot's name is one of robot_descriptions."""
    return name.startswith(ROBOT_DESCRIPTIONS)


@memoized_by_value(64)
def find_description(name: str) -> UrdfFile:
    """Return the files of a robot, named with the prefix, downloaded if they aren't in the cache of robot_descriptions.

    Raises:
        RobotInvalid: if the package or the name is unknown, or the files can't be downloaded.
    """
    own = name.removeprefix(ROBOT_DESCRIPTIONS)
    if not re.fullmatch(r"[A-Za-z]\w{0,99}", own):
        raise RobotInvalid(f"{own[:64]!r} is no name of robot_descriptions", robot=name[:99])
    found = _load(own)
    if "missing" in found:
        raise RobotInvalid(
            f"{name!r} needs the package robot_descriptions: pip install 'guidefield[robot_descriptions]' "
            f"({found['missing']})",
            robot=name,
        )
    if "names" in found:
        close = find_nearest(own, found["names"]) or [one for one in found["names"] if one.startswith(f"{own}_")]
        hint = f"; did you mean {' or '.join(close)}?" if close else ""
        raise RobotInvalid(f"robot_descriptions has no {own!r}{hint}", robot=name, available=found["names"])
    path = next((found[key] for key in ("URDF_PATH", "XACRO_PATH", "MJCF_PATH") if key in found), None)
    if path is None:
        raise RobotInvalid(f"{name!r} has neither URDF nor MJCF", robot=name)
    folders = [str(Path(found[key]).parent) for key in ("PACKAGE_PATH", "REPOSITORY_PATH") if key in found]
    arguments = found.get("XACRO_ARGS", {}) if path == found.get("XACRO_PATH") else {}
    return UrdfFile(path, found.get("SRDF_PATH"), list(dict.fromkeys(folders)), xacro_args=arguments)


def _load(own: str) -> dict[str, Any]:
    """Import a description in a process of its own; RobotInvalid with its last line if that fails."""
    environment = {
        **os.environ,
        "GIT_TERMINAL_PROMPT": "0",
        "GIT_HTTP_LOW_SPEED_LIMIT": "1000",
        "GIT_HTTP_LOW_SPEED_TIME": str(STALLED_SECONDS),
    }
    with subprocess.Popen(  # noqa: S603 - our interpreter, and a name that was checked
        [sys.executable, "-c", _LOADER, own],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
        start_new_session=True,
    ) as process:
        try:
            said, complaint = process.communicate(timeout=MAX_DOWNLOAD_SECONDS)
        except subprocess.TimeoutExpired:
            raise _not_delivered(own, f"it took more than {MAX_DOWNLOAD_SECONDS:g} s") from None
        finally:
            if process.poll() is None:  # it and git
                os.killpg(process.pid, signal.SIGKILL)
    if process.returncode:
        lines = [line.strip() for line in complaint.decode(errors="replace").splitlines() if line.strip()]
        causes = [line for line in lines if "fatal:" in line] or lines[-1:]
        raise _not_delivered(own, causes[-1] if causes else f"its loader ended with {process.returncode}")
    found: dict[str, Any] = json.loads(said.decode().splitlines()[-1])
    return found


def _not_delivered(own: str, reason: str) -> RobotInvalid:
    return RobotInvalid(
        f"robot_descriptions could not load {own!r}: {reason}; it downloads from Git what isn't in its cache: run "
        f"`python -m robot_descriptions pull {own}` where there is a network, or copy its cache folder",
        robot=f"{ROBOT_DESCRIPTIONS}{own}",
    )
