"""Whatever a URDF, an SRDF and meshes say, a robot comes of it or a sentence: never another error."""

import copy
import os
import random
import subprocess
import sys
from pathlib import Path

from lxml import etree

from guidefield.errors import RobotInvalid
from guidefield.kernels.jit.cache import cache_folder
from guidefield.messages.requests import UrdfText
from guidefield.robot.catalog import Catalog

EXAMPLES = int(os.environ.get("GUIDEFIELD_ODD_URDFS", "50"))
BODY = '<collision><origin xyz="0 0 0.1" rpy="0 0 0"/><geometry><box size="0.1 0.1 0.2"/></geometry></collision>'
MASS = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
LIMIT = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
JOINTS = (
    ("a", "base", "upper", "revolute", LIMIT),
    ("b", "upper", "fore", "continuous", '<axis xyz="0 1 0"/>'),
    ("c", "fore", "hand", "prismatic", LIMIT),
    ("d", "hand", "finger", "revolute", LIMIT + '<mimic joint="a" multiplier="2" offset="0.1"/>'),
    ("e", "hand", "tool", "fixed", ""),
    ("f", "base", "sled", "planar", '<axis xyz="0 1 0"/>'),
    ("g", "sled", "ball", "floating", ""),
)
LINKS = ("base", "upper", "fore", "hand", "finger", "tool", "sled", "ball")
URDF = (
    '<robot name="arm">'
    + "".join(f'<link name="{name}">{MASS}{BODY}</link>' for name in LINKS)
    + "".join(
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 0.25"/>{rest}</joint>'
        for name, parent, child, kind, rest in JOINTS
    )
    + "</robot>"
)
SRDF = (
    '<robot name="arm"><virtual_joint name="v" type="planar" parent_frame="world" child_link="base"/>'
    '<group name="g"><chain base_link="base" tip_link="hand"/></group>'
    '<group name="h"><joint name="d"/><group name="g"/><link name="sled"/></group>'
    '<group_state name="home" group="g"><joint name="a" value="0.3"/><joint name="v" value="0 1 2"/></group_state>'
    '<end_effector name="t" parent_link="tool" group="h"/><passive_joint name="c"/>'
    '<disable_collisions link1="base" link2="upper" reason="Adjacent"/><disable_default_collisions link="tool"/>'
    "</robot>"
)
TAGS = [
    "link",
    "joint",
    "mesh",
    "box",
    "sphere",
    "axis",
    "robot",
    "unknown",
    "Collision",
    "origin",
    "mimic",
    "limit",
    "group",
    "geometry",
    "safety_controller",
    "dynamics",
    "capsule",
    "collision_checking",
    "{http://ros.org/wiki/xacro}if",
    "{http://ros.org/wiki/xacro}grey",
]
ATTRIBUTES = [
    "name",
    "type",
    "xyz",
    "rpy",
    "link",
    "joint",
    "size",
    "radius",
    "lower",
    "upper",
    "velocity",
    "value",
    "multiplier",
    "offset",
    "version",
    "filename",
    "group",
    "base_link",
]
TEXTS = [
    "",
    "0 0 0",
    "1 1",
    "0 0 1e200",
    "0 5e-324 0",
    "a b/c",
    "0 0 0 1",
    "0 0 0 0 0 0 0",
    "9" * 400,
    *[
        "0",
        "-1",
        "1e400",
        "nan",
        "x",
        "\u0661",
        "a",
        "base",
        "file:///etc/passwd",
        "fixed",
        "floating",
        "planar",
        "continuous",
        "universe",
        "root_joint",
        "f.x",
        "${x}",
        "1e-320",
        "#J00000#",
        "1.1",
        "é/→",
    ],
]


def changed(rng: random.Random, text: str) -> str:
    root = etree.fromstring(text)
    for _ in range(rng.choice((1, 1, 2, 4))):
        element = rng.choice(list(root.iter()))
        parent = element.getparent()
        match rng.randrange(6):
            case 0 if parent is not None:
                parent.remove(element)
            case 1 if parent is not None:
                parent.append(copy.deepcopy(element))
            case 2:
                element.append(copy.deepcopy(rng.choice(list(root.iter()))))
            case 3:
                element.tag = rng.choice(TAGS)
            case _:
                name = rng.choice([*element.attrib, *element.attrib, rng.choice(ATTRIBUTES)])
                element.attrib[name] = rng.choice(TEXTS)
    changed = etree.tostring(root, encoding="unicode")
    if rng.random() < 0.1:
        return (
            changed.replace("<link", "<sensor:link", 1)
            if rng.random() < 0.5
            else changed[: rng.randrange(len(changed))]
        )
    return changed


def test_a_robot_comes_of_it_or_a_sentence() -> None:
    outcomes = {"robot": 0, "sentence": 0}
    for seed in range(EXAMPLES):
        rng = random.Random(seed)
        urdf = changed(rng, URDF) if rng.random() < 0.7 else URDF
        srdf = changed(rng, SRDF) if rng.random() < 0.5 else rng.choice((None, SRDF))
        root = rng.choice(("fixed", "fixed", "planar", "free"))
        message = refusal(UrdfText(text=urdf, srdf=srdf, root_joint=root), seed)
        outcomes["robot" if message is None else "sentence"] += 1
        assert message is None or len(message) > 20, (seed, message)
        assert message is None or "#J" not in message or "#J00000#" in urdf, (seed, message)
    assert min(outcomes.values()) > EXAMPLES // 10, outcomes


def refusal(robot: UrdfText, seed: int) -> str | None:
    """The sentence with which a robot is refused; None where it is loaded."""
    try:
        Catalog().load(robot)
    except RobotInvalid as refused:
        return refused.message
    except Exception as error:
        raise AssertionError(f"seed {seed}: {type(error).__name__}: {error}") from error
    return None


def test_a_process_survives_them(tmp_path: Path) -> None:
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "NUMBA_CACHE_DIR": str(cache_folder().parents[1])}
    command = [sys.executable, "-X", "faulthandler", "-m", "tests.robot.odd_meshes", "2", "2"]
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "2 served\n3 served\n"
