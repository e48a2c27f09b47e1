"""Makes a small store as a service of this version keeps it: ``python -m tests.kept.make tests/kept/<version>.tar.xz``.

It is made once, by the code of the release itself, and never edited: tests read it with every later version.
`data` in it is a service's data folder, `recordings` are files that are alone.
"""

import json
import os
import signal
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path
from typing import Any

import guidefield
from guidefield import Client
from guidefield.messages.scene import Box, Scene, Sphere
from tests.examples import example
from tests.journeys.service import LONG, await_that, running_service

_LINK = '<link name="{name}"><collision><origin xyz="{at}"/><geometry>{shape}</geometry></collision></link>'
_JOINT = (
    '<joint name="{name}" type="{kind}"><origin xyz="{at}"/><parent link="{parent}"/><child link="{child}"/>'
    '<axis xyz="{axis}"/>{more}</joint>'
)
_LIMIT = '<limit lower="{0}" upper="{1}" effort="10" velocity="{2}"/>'
_FINGER = "package://lift_arm/finger.obj"
_FINGERS_FOLLOW = '<mimic joint="left_finger" multiplier="1" offset="0"/>'


def _urdf() -> str:
    """An arm on a lift with a hand of two fingers: prismatic, continuous, revolute joints and one that follows."""
    links = [
        ("base", "0 0 0.1", '<cylinder radius="0.1" length="0.2"/>'),
        ("carriage", "0 0 0", '<box size="0.1 0.1 0.1"/>'),
        ("upper", "0.15 0 0", '<box size="0.26 0.06 0.06"/>'),
        ("fore", "0.12 0 0", '<box size="0.2 0.05 0.05"/>'),
        ("hand", "0.04 0 0", '<sphere radius="0.03"/>'),
        ("left", "0.03 0 0", f'<mesh filename="{_FINGER}"/>'),
        ("right", "0.03 0 0", f'<mesh filename="{_FINGER}"/>'),
    ]
    slide = _LIMIT.format(0.0, 0.03, 0.1)
    joints = [
        ("lift", "prismatic", "0 0 0.35", "base", "carriage", "0 0 1", _LIMIT.format(0.0, 0.5, 0.5)),
        ("shoulder", "continuous", "0 0 0.1", "carriage", "upper", "0 0 1", ""),
        ("elbow", "revolute", "0.3 0 0", "upper", "fore", "0 0 1", _LIMIT.format(-2.5, 2.5, 1.5)),
        ("wrist", "revolute", "0.25 0 0", "fore", "hand", "0 1 0", _LIMIT.format(-1.5, 1.5, 2.0)),
        ("left_finger", "prismatic", "0.08 0.02 0", "hand", "left", "0 1 0", slide),
        ("right_finger", "prismatic", "0.08 -0.02 0", "hand", "right", "0 -1 0", slide + _FINGERS_FOLLOW),
    ]
    parts = [_LINK.format(name=name, at=at, shape=shape) for name, at, shape in links]
    for name, kind, at, parent, child, axis, more in joints:
        parts.append(_JOINT.format(name=name, kind=kind, at=at, parent=parent, child=child, axis=axis, more=more))
    return f'<robot name="lift_arm">{"".join(parts)}</robot>'


def _finger() -> bytes:
    """A wedge as OBJ: 60 mm long, 20 mm wide, 16 mm high at its root [m]."""
    corners = [(-0.03, y, z) for y in (-0.01, 0.01) for z in (-0.008, 0.008)] + [(0.03, -0.01, 0), (0.03, 0.01, 0)]
    faces = [(1, 2, 4), (1, 4, 3), (1, 5, 2), (3, 4, 6), (1, 3, 6), (1, 6, 5), (2, 5, 6), (2, 6, 4)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a} {b} {c}" for a, b, c in faces]
    return ("\n".join(lines) + "\n").encode()


URDF, FINGER = _urdf(), _finger()
CELL = Scene(
    "cell",
    obstacles=[
        Box(name="post", size=(0.08, 0.08, 0.9), position=(0.45, 0.12, 0.45)),
        Sphere(name="ball", radius=0.08, position=(0.0, 0.55, 0.5)),
    ],
)
RIGHT = {"lift": 0.1, "shoulder": -0.5, "elbow": -0.3}
LEFT = {"lift": 0.2, "shoulder": 1.2, "elbow": 0.4}


def _planar_arm() -> str:
    """A foot that slides and turns on the ground, with one joint."""
    links = [("foot", "0 0 0.1", '<box size="0.2 0.2 0.2"/>'), ("hand", "0.2 0 0", '<box size="0.3 0.05 0.05"/>')]
    parts = [_LINK.format(name=name, at=at, shape=shape) for name, at, shape in links]
    limit = _LIMIT.format(-1.0, 1.0, 1.0)
    joint = {"name": "turn", "kind": "revolute", "at": "0.1 0 0.3", "parent": "foot", "child": "hand"}
    return f'<robot name="sent">{"".join(parts)}{_JOINT.format(**joint, axis="0 0 1", more=limit)}</robot>'


PLANAR = {"type": "urdf", "text": _planar_arm(), "root_joint": "planar"}
ARM: dict[str, Any] = {
    "robot": "lift_arm",
    "scene": "cell",
    "start": RIGHT,
    "goal": {"type": "joints", "positions": LEFT},
    "group": ["lift", "shoulder", "elbow", "wrist"],
    "tip": "hand",
    "guide_planes": [],
    "allowed_planning_time": 60.0,
}
_CUBE = [[x, y, z] for x in (0.0, 0.06) for y in (0.0, 0.06) for z in (0.0, 0.06)]
_SIDES = [
    *([0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 4, 5], [0, 5, 1]),
    *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
]
RICH = {
    "name": "rich",
    "obstacles": [
        {"type": "mesh", "name": "cube", "vertices": _CUBE, "triangles": _SIDES, "position": [0.6, 0.0, 0.3]},
        {"type": "point_cloud", "name": "scan", "points": [[0.3, 0.1 * i, 0.3] for i in range(5)], "radius": 0.02},
        {"type": "capsule", "name": "rail", "radius": 0.02, "length": 0.3, "position": [-0.4, 0.0, 0.5]},
        {"type": "half_space", "name": "floor", "normal": [0, 0, 1], "offset": -0.01},
        {"type": "polygon", "name": "wall", "vertices": [[-0.8, -1, 0], [-0.8, 1, 0], [-0.8, 1, 1], [-0.8, -1, 1]]},
    ],
}
LEVEL = {"type": "plane", "frame": "hand", "point": [0, 0, 0.6], "normal": [0, 0, 1], "tolerance": 0.02}
UPRIGHT = {"type": "orientation_cone", "frame": "hand", "axis": [0, 0, 1], "target_axis": [0, 0, 1], "half_angle": 0.3}
HELD = {"obstacle": {"type": "sphere", "name": "egg", "radius": 0.02, "position": [0, 0, 0]}, "link": "hand"}


def requests() -> dict[str, dict[str, Any]]:
    """What is asked of the service, by run."""
    far = {"lift": 0.15, "shoulder": 2.4, "elbow": 0.5, "wrist": 0.1}
    pose = {"type": "pose", "position": [0.2, -0.5, 0.7], "quaternion_xyzw": [0, 0, 0, 1]}
    pose |= {"position_tolerance": [0.005, 0.005, 0.005], "orientation_tolerance": [None, None, None]}
    within = {"lift": 0.2, "shoulder": 0.2, "elbow": 0.1}
    kept_level = {
        **ARM,
        "scene": RICH,
        "start": {**RIGHT, "lift": 0.15},
        "goal": {"type": "joint_set", "positions": [far, {**far, "shoulder": -2.4}]},
        "path_constraints": [LEVEL, UPRIGHT],
        "min_clearance": 0.004,
        "attached_objects": [{**HELD, "placement": {"position": [0.1, 0, 0]}, "touch_links": ["left", "right"]}],
        "allowed_collisions": [["base", "floor"]],
        "limits": {"elbow": {"velocity": 1.0, "acceleration": 2.0, "jerk": 40.0}},
        "max_velocity_scaling_factor": 0.8,
        "optimization_iterations": 20,
        "recording": "off",
        "seed": 7,
    }
    return {
        "guided": json.loads(example("seed_e_L_3_planar")),
        "conveyor": {**json.loads(example("conveyor")), "recording": "off"},
        "joints": {**ARM, "recording": "summary"},
        "refused": {**ARM, "goal": {"type": "joints", "positions": within}},
        "constrained": kept_level,
        "pose": {**ARM, "goal": pose, "planner": "tree", "recording": "off", "sample_rate": 20.0},
        "sent": {
            "robot": PLANAR,
            "tip": "hand",
            "goal": {"type": "joints", "positions": {"root_joint": [0.2, 0.0, 0.5], "turn": 0.5}},
            "scene": {"name": "empty", "obstacles": []},
            "allowed_planning_time": 60.0,
            "recording": "off",
        },
    }


def alone() -> dict[str, Any]:
    """What is asked without a service."""
    goal = {"type": "joints", "positions": {"root_joint": [-0.1, 0.9, 0.5], "turn": 0.5}}
    far_off = {"position": [0.9, -0.6, 0.0], "quaternion_xyzw": [0, 0, 0, 1]}
    return {
        "robot": PLANAR,
        "robot_placement": far_off,
        "scene": RICH,
        "goal": goal,
        "tip": "hand",
        "guide_planes": [],
        "allowed_collisions": [["foot", "floor"]],
        "limits": {"turn": {"jerk": 40.0}},
        "allowed_planning_time": 60.0,
    }


def make(folder: Path) -> None:
    """Fill `data` and `recordings` in a folder."""
    data, recordings = folder / "data", folder / "recordings"
    recordings.mkdir(parents=True)
    with running_service(data, "--workers", "1") as service, Client.connect(service.endpoint) as client:
        client.store_robot("lift_arm", URDF, meshes={_FINGER: FINGER})
        client.store_scene(CELL)
        for run_id, request in requests().items():
            _tell(client.plan({**request, "run_id": run_id}))
        (recordings / "refused.rrd").write_bytes(client.recording("refused"))
    _interrupt(data)
    with running_service(data, "--workers", "1"):
        """It ends the run that was interrupted."""
    os.chdir(recordings)  # a reply names its recording as it was given
    _tell(guidefield.answer(alone(), record_to=Path("alone.rrd")))


def _interrupt(data: Path) -> None:
    """Kill a service while it works on a run."""
    with running_service(data, "--workers", "1") as service, tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "long.json"
        file.write_text(json.dumps({**LONG, "run_id": "interrupted"}))
        query = [sys.executable, "-m", "guidefield", "query", str(file), "--connect", service.endpoint]
        with subprocess.Popen(query, stderr=subprocess.DEVNULL) as asking:
            await_that((data / "runs" / "interrupted").is_dir)
            for pid in (asking.pid, service.process.pid, *service.workers()):
                os.kill(pid, signal.SIGKILL)


def pack(folder: Path, archive: Path) -> None:
    """Write what a folder holds, with its times, and without whose it was."""

    def anybodys(entry: tarfile.TarInfo) -> tarfile.TarInfo:
        entry.uid = entry.gid = 0
        entry.uname = entry.gname = ""
        return entry

    with tarfile.open(archive, "w:xz", preset=9) as file:
        for part in ("data", "recordings"):
            file.add(folder / part, part, filter=anybodys)


def _tell(reply: guidefield.PlanReply) -> None:
    sys.stdout.write(f"{reply.run_id}: {reply.status.name}: {reply.status.message}\n")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        archive = Path(sys.argv[1]).resolve()
        make(Path(made))
        pack(Path(made), archive)
