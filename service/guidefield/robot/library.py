"""Find robots by name, as files and defaults: those that come with guidefield, and those of robot_descriptions.

Names, and the fields of `robots/<name>.card.json`, are the public API's. Nothing here loads Pinocchio or MuJoCo, so
that lists of names stay light. Robots of the package robot_descriptions may be downloaded, in a process of their own;
`MAX_DOWNLOAD_SECONDS` and `STALLED_SECONDS` decide when that is given up.
"""

from __future__ import annotations

import functools
import importlib.resources
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec

from guidefield.errors import RobotInvalid
from guidefield.memo import memoized_by_value
from guidefield.messages.faults import find_nearest
from guidefield.messages.requests import ROBOT_DESCRIPTIONS, Positions, UrdfFile
from guidefield.messages.values import Positive, RootJoint
from guidefield.robot.urdf.meshes import CATALOG_PACKAGE, catalog_share

OURS = "guidefield"  # the source of robots whose URDF is ours
_PACKAGE = "guidefield.robots"
_CARD = ".card.json"

MAX_DOWNLOAD_SECONDS = 300.0  # time for the loader, which may download a repository; a request may allow less [s]
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


class RobotCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Declared in `robots/<name>.card.json`; everything but `urdf` only where a default must be chosen."""

    urdf: str  # path inside example-robot-data's robots folder, or beside the card
    srdf: str | None = None  # the same for the SRDF; null where there is none
    tip: str | None = None  # frame that goals are about
    rest: Positions = {}  # values of the rest configuration by joint, as on the wire
    group: list[str] | None = None  # joints that are planned for by default; null: all between root and tip
    root_joint: Literal["fixed", "planar", "free"] = "fixed"  # how the robot stands in the world
    ball_joints: list[str] = []  # joints that the URDF calls floating and that only turn
    acceleration: dict[str, Positive] = {}  # acceleration limits by joint [rad/s^2 or m/s^2]
    velocity: dict[str, Positive] = {}  # velocity limits by joint [rad/s or m/s]


NO_CARD = RobotCard(urdf="")  # the card of a robot that has none

_decode_card = msgspec.json.Decoder(RobotCard).decode


@dataclass(frozen=True)
class SentRobot:
    """A robot as a client sent it."""

    name: str  # the client's name of it
    content: str  # hash of all that was sent; the same content is the same robot
    urdf: str  # text of its URDF
    srdf: str | None  # text of its SRDF
    meshes: Mapping[str, Path]  # files on disk by the URIs that the URDF has for them
    root_joint: RootJoint  # how it stands in the world


@dataclass(frozen=True)
class Entry:
    """One name of the catalog."""

    name: str
    card: RobotCard  # its files and defaults
    folder: Path  # folder of the card's paths
    source: str  # the package that it comes from
    family: str  # short name of the folder that its URDF is in; several URDFs of one are variants of a robot


@functools.cache
def entries() -> dict[str, Entry]:
    """Return every name, in alphabetical order: found URDFs, and our cards, which take precedence."""
    return dict(sorted({**_find_entries(), **_find_our_entries()}.items()))


def _robots_folder() -> Path:
    return catalog_share() / CATALOG_PACKAGE / "robots"


def _find_entries() -> dict[str, Entry]:
    """Find the URDFs of example-robot-data by the names of their files, or of packages where files share a name."""
    robots = _robots_folder()
    urdfs = sorted(robots.glob("*/*/*.urdf"))
    stems = [path.stem for path in urdfs]
    found: dict[str, Entry] = {}
    for path in urdfs:
        family = _family_of(path.relative_to(robots))
        name = path.stem.removesuffix("_robot").lower()
        if stems.count(path.stem) > 1:
            name = family
        elif name in found:
            name = path.stem.lower()
        srdf = _srdf_of(path, sorted((robots / path.parts[-3] / "srdf").glob("*.srdf")))
        card = RobotCard(str(path.relative_to(robots)), str(srdf.relative_to(robots)) if srdf else None)
        found[name] = Entry(name, card, robots, CATALOG_PACKAGE, family)
    return found


def _find_our_entries() -> dict[str, Entry]:
    robots, ours = _robots_folder(), importlib.resources.files(_PACKAGE)
    found = {}
    for resource in ours.iterdir():
        if resource.name.endswith(_CARD):
            name, card = resource.name.removesuffix(_CARD), _decode_card(resource.read_bytes())
            if (robots / card.urdf).is_file():
                found[name] = Entry(name, card, robots, CATALOG_PACKAGE, _family_of(Path(card.urdf)))
            else:
                found[name] = Entry(name, card, Path(str(ours)), OURS, name)
    return found


def _family_of(urdf: Path) -> str:
    return urdf.parts[0].removesuffix("_description").removesuffix("_data").lower()


def _srdf_of(urdf: Path, srdfs: Iterable[Path]) -> Path | None:
    """Find the SRDF of a package named most like a URDF: `arm` and `arm_manipulation` describe `arm_with_hand` too."""
    names = {srdf: srdf.stem.removesuffix("_manipulation") for srdf in srdfs}
    fitting = [srdf for srdf, name in names.items() if f"{urdf.stem}_".startswith(f"{name}_")]
    return max(fitting, key=lambda srdf: (len(names[srdf]), -len(srdf.stem)), default=None)


@memoized_by_value(64)
def find_description(name: str) -> UrdfFile:
    """Return the files of a robot, named with the prefix, downloaded if they aren't in the cache of robot_descriptions.

    Raises:
        RobotInvalid: if the package or the name is unknown, or the files can't be downloaded.
    """
    own = name.removeprefix(ROBOT_DESCRIPTIONS)
    if not re.fullmatch(r"[A-Za-z]\w{0,99}", own):
        raise RobotInvalid(f"{own[:64]!r} is no name of robot_descriptions", robot=name[:99])
    found = _run_loader(own)
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


def _run_loader(own: str) -> dict[str, Any]:
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
            raise _loading_fault(own, f"it took more than {MAX_DOWNLOAD_SECONDS:g} s") from None
        finally:
            if process.poll() is None:  # it and git
                os.killpg(process.pid, signal.SIGKILL)
    if process.returncode:
        lines = [line.strip() for line in complaint.decode(errors="replace").splitlines() if line.strip()]
        causes = [line for line in lines if "fatal:" in line] or lines[-1:]
        raise _loading_fault(own, causes[-1] if causes else f"its loader ended with {process.returncode}")
    found: dict[str, Any] = json.loads(said.decode().splitlines()[-1])
    return found


def _loading_fault(own: str, reason: str) -> RobotInvalid:
    return RobotInvalid(
        f"robot_descriptions could not load {own!r}: {reason}; it downloads from Git what isn't in its cache: run "
        f"`python -m robot_descriptions pull {own}` where there is a network, or copy its cache folder",
        robot=f"{ROBOT_DESCRIPTIONS}{own}",
    )
