"""Robots to doubt: drawn at random, of all kinds of joints and shapes, or taken from the catalog."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import random
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from tests.robot.odd_meshes import odd, stl
from tests.robot.random_chains import KINDS, WOUND, chain

from doubting import mesh_files
from doubting.meshes import closed, triangles_of
from guidefield.messages.requests import RobotReference, UrdfFile, UrdfText
from guidefield.messages.values import RootJoint

CATALOG = (
    "panda",
    "ur5",
    "xarm7",
    "z1",
    "chain_fixed_6x300_r25",
    "chain_moving_3x260_r25",
    "chain_planar_3x260_r25",
    "chain_universal_fixed_6x300_r25",
)
"""Robots of the catalog: arms with meshes, and chains of ball, universal, planar and floating joints."""

MOVING = "root_joint"
NAMES = ("universe", MOVING, "world", "l0", "l1", "j1", "j2", "l1_0", "frame 0", "joint j1", "a b/c", "tf#/")
"""Names that Pinocchio, the service or other parts of a robot have."""

MOST_JOINTS = 7
FOLDER = "MESHES/"
"""The name of the folder of meshes in a robot's text."""


@dataclass(frozen=True)
class Robot:
    """A robot as it can be kept in a file and made anew.

    Attributes:
        catalog: Its name there; None for one that is sent.
        text: Its URDF, meshes in `FOLDER`; "" for one of the catalog.
        meshes: Its mesh files by name.
        root_joint: How its root link moves.
    """

    catalog: str | None = None
    text: str = ""
    meshes: dict[str, bytes] = field(default_factory=dict)
    root_joint: RootJoint = "fixed"

    def reference(self, folder: Path) -> RobotReference:
        """Refer to the robot in a request; files that it needs are written into a folder."""
        if self.catalog is not None:
            return self.catalog
        if not self.meshes:
            return UrdfText(text=self.text, root_joint=self.root_joint)
        mine = folder / hashlib.sha256(self.text.encode()).hexdigest()[:16]
        mine.mkdir(parents=True, exist_ok=True)
        for name, data in self.meshes.items():
            (mine / name).write_bytes(data)
        path = mine / "robot.urdf"
        path.write_text(self.text.replace(FOLDER, f"{mine}/"))
        return UrdfFile(path=str(path), root_joint=self.root_joint)

    def plain(self) -> dict[str, object]:
        """As JSON's values."""
        meshes = {name: base64.b64encode(data).decode() for name, data in self.meshes.items()}
        return {"catalog": self.catalog, "text": self.text, "meshes": meshes, "root_joint": self.root_joint}

    @classmethod
    def of(cls, plain: dict[str, object]) -> Robot:
        """From `plain`."""
        meshes = {name: base64.b64decode(data) for name, data in plain["meshes"].items()}
        return cls(plain["catalog"], plain["text"], meshes, plain["root_joint"])


def draw_robot(rng: np.random.Generator) -> Robot:
    """A robot: of eight one of the catalog, the others at random; of these every other one has meshes."""
    if rng.random() < 0.125:
        return Robot(catalog=CATALOG[rng.integers(len(CATALOG))])
    kinds = KINDS if rng.random() < 0.6 else WOUND
    text = chain(random.Random(int(rng.integers(2**32))), int(rng.integers(2, MOST_JOINTS + 1)), kinds).text  # noqa: S311
    text = _thickened(text, rng)
    root: RootJoint = ("planar", "free")[rng.integers(2)] if rng.random() < 0.15 else "fixed"
    meshes: dict[str, bytes] = {}
    if rng.random() < 0.4:
        text = _with_meshes(text, rng, meshes)
    return Robot(text=_renamed(text, rng, root), meshes=meshes, root_joint=root)


def _renamed(text: str, rng: np.random.Generator, root: RootJoint) -> str:
    """Of three robots one has a link or a joint with a name that somebody else has given."""
    if rng.random() < 2 / 3:
        return text
    parts = re.findall(r'<(link|joint) name="([^"]*)"', text)
    kind, old = parts[rng.integers(len(parts))]
    taken = {name for of, name in parts if of == kind}
    names = [
        name for name in NAMES if name not in taken and not (kind == "joint" and root != "fixed" and name == MOVING)
    ]
    new = names[rng.integers(len(names))]
    if kind == "link":
        return re.sub(rf'((?:<link name|link)=)"{old}"', rf'\1"{new}"', text)
    return re.sub(rf'((?:<joint name|mimic joint)=)"{old}"', rf'\1"{new}"', text)


def change_gear(rng: np.random.Generator, robot: Robot) -> Robot | None:
    """The same robot, the multiplier of one of its mimic joints changed a little; None without one."""
    found = list(re.finditer(r'multiplier="([^"]+)"', robot.text))
    if not found:
        return None
    one = found[rng.integers(len(found))]
    value = float(one.group(1)) + float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-6.0, -1.0))
    text = f'{robot.text[: one.start()]}multiplier="{value!r}"{robot.text[one.end() :]}'
    return dataclasses.replace(robot, text=text)


def _thickened(text: str, rng: np.random.Generator) -> str:
    """Some shapes are wider, so that links come close to each other."""

    def wider(_found: re.Match[str]) -> str:
        width = round(float(rng.choice([0.002, 0.015, 0.015, 0.025, 0.04])), 4)
        return f'radius="{width}"'

    return re.sub(r'radius="0.015"', wider, text)


def _with_meshes(text: str, rng: np.random.Generator, meshes: dict[str, bytes]) -> str:
    """Some shapes are meshes: closed and convex, closed and dented, odd ones, or files of several parts."""

    def replaced(found: re.Match[str]) -> str:
        if rng.random() < 0.5:
            return found.group()
        if rng.random() < 0.4:
            suffix, content, scale = mesh_files.draw_mesh_file(rng)
            name = f"{len(meshes)}{suffix}"
            meshes[name] = content
            return f'<geometry><mesh filename="{FOLDER}{name}" scale="{scale}"/></geometry>'
        name = f"{len(meshes)}.stl"
        if rng.random() < 0.15:
            soup = odd(int(rng.integers(10_000)))
        else:
            soup = triangles_of(*closed(rng, 0.5 * float(rng.uniform(0.04, 0.12))))
        meshes[name] = stl(soup)
        return f'<geometry><mesh filename="{FOLDER}{name}"/></geometry>'

    return re.sub(r"<geometry>.*?</geometry>", replaced, text)
