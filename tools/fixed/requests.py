"""The fixed requests: joints of all kinds, all planners, all kinds of obstacles, constraints and questions."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

Request = dict[str, Any]

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "requests"


def _robot(name: str, root_joint: str = "fixed") -> Request:
    text = (Path(__file__).resolve().parent / f"{name}.urdf").read_text()
    return {"type": "urdf", "text": text, "root_joint": root_joint}


LIFT = _robot("lift")
"""Prismatic, continuous and revolute joints, and a finger that follows another."""
WHEELED = _robot("wheeled", "planar")
"""A foot that slides and turns on the ground, with one joint."""
FLOATER = _robot("floater", "free")
"""A body that flies, with a tail."""
FOLLOWERS = _robot("followers")
"""A revolute joint that follows another against its sense, and a continuous one that follows at half the pace."""
PATIENT = {"allowed_planning_time": 3600.0, "recording": "off"}
REFEREED = "refereed"
"""The type of a request that the referee is asked, and not `guidefield.answer`; else it is one to certify a motion."""

READY = {f"panda_joint{i}": v for i, v in enumerate((0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785), 1)}
TURNED = {**READY, "panda_joint1": 0.9}
BENT = {"panda_joint2": 0.6, "panda_joint4": -1.2, "panda_joint6": 1.8}
ASIDE = {**BENT, "panda_joint1": 1.5708}
DOWN = (1.0, 0.0, 0.0, 0.0)
HAND = "panda_hand_tcp"
BALLS = "chain_fixed_6x300_r25"
CUBE = [[x, y, z] for x in (0.0, 0.1) for y in (0.0, 0.1) for z in (0.0, 0.1)]
SIDES = [
    *([0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 4, 5], [0, 5, 1]),
    *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
]
PYRAMID = [[-0.1, -0.1, 0.0], [0.1, -0.1, 0.0], [0.1, 0.1, 0.0], [-0.1, 0.1, 0.0], [0.0, 0.0, 0.25]]
NOTCHED = [[0, 2, 1], [0, 3, 2], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
POST = {"type": "box", "name": "post", "size": [0.06, 0.06, 0.5], "position": [0.42, 0.27, 0.25]}
GATE = [
    {"name": "near", "vertices": [[0.35, -0.3, 0.3], [0.35, 0.3, 0.3], [0.35, 0.3, 0.8], [0.35, -0.3, 0.8]]},
    {"name": "far", "vertices": [[0.5, -0.3, 0.3], [0.5, 0.3, 0.3], [0.5, 0.3, 0.8], [0.5, -0.3, 0.8]]},
]


def shell(count: int, radius: float, centre: tuple[float, float, float]) -> list[list[float]]:
    """Points spread over a sphere along a spiral, to tenths of millimetres."""
    points = []
    for i in range(count):
        height = 1.0 - (2.0 * i + 1.0) / count
        around, away = 2.399963229728653 * i, math.sqrt(1.0 - height * height)
        ball = (away * math.cos(around), away * math.sin(around), height)
        points.append([round(c + radius * x, 4) for c, x in zip(centre, ball, strict=True)])
    return points


def scene(name: str, *obstacles: Request, guide_planes: list[Request] | None = None) -> Request:
    return {"name": name, "obstacles": list(obstacles), "guide_planes": guide_planes or []}


CLOUD = {"type": "point_cloud", "name": "cloud", "points": shell(3000, 0.12, (0.45, 0.3, 0.4)), "radius": 0.01}
MESHES = [
    {"type": "mesh", "name": "cube", "vertices": CUBE, "triangles": SIDES, "position": [0.4, 0.2, 0.2]},
    {"type": "mesh", "name": "pyramid", "vertices": PYRAMID, "triangles": NOTCHED, "position": [0.45, -0.3, 0.1]},
    {
        "type": "polygon",
        "name": "sheet",
        "vertices": [[0.2, 0.5, 0.0], [0.7, 0.5, 0.0], [0.7, 0.5, 0.6], [0.2, 0.5, 0.6]],
    },
]
KINDS = [
    {"type": "sphere", "name": "sphere", "radius": 0.1, "position": [0.5, 0.3, 0.6], "charge": 2.0},
    {"type": "cylinder", "name": "cylinder", "radius": 0.05, "length": 0.6, "position": [0.5, -0.3, 0.3]},
    {"type": "capsule", "name": "capsule", "radius": 0.04, "length": 0.4, "position": [0.6, 0.0, 0.9]},
    {"type": "half_space", "name": "floor", "normal": [0, 0, 1], "offset": -0.05},
    POST,
]
MOVER = {
    "type": "sphere",
    "name": "mover",
    "radius": 0.08,
    "trajectory": {
        "times": [0.0, 4.0],
        "placements": [{"position": [0.55, -0.6, 0.5]}, {"position": [0.55, 0.8, 0.5]}],
    },
}
ROD = {
    "obstacle": {"type": "box", "name": "rod", "size": [0.02, 0.02, 0.25]},
    "link": "panda_hand",
    "placement": {"position": [0, 0, 0.22]},
    "touch_links": ["panda_leftfinger", "panda_rightfinger"],
}
CONE = {"type": "orientation_cone", "frame": HAND, "axis": [0, 0, 1], "target_axis": [0, 0, -1], "half_angle": 0.25}


def joints(**positions: Any) -> Request:
    return {"type": "joints", "positions": positions}


def pose(position: list[float], **more: Any) -> Request:
    return {"type": "pose", "position": position, "quaternion_xyzw": list(DOWN), **more}


def panda(goal: Request, where: Any = "bookshelf", **more: Any) -> Request:
    return {"robot": "panda", "scene": where, "start": READY, "goal": goal, "guide_planes": [], **PATIENT, **more}


def arm(robot: Any, goal: Request, where: Any, **more: Any) -> Request:
    return {"robot": robot, "scene": where, "goal": goal, "guide_planes": [], **PATIENT, **more}


def example(name: str, **more: Any) -> Request:
    return {**json.loads((EXAMPLES / f"{name}.json").read_text()), **PATIENT, **more}


def guided() -> dict[str, Request]:
    """The seed's planner on balls, universal joints, planar and floating roots; guide planes given, derived, moving."""
    thesis = ("seed_a_gates", "seed_b_tapered", "seed_c_blocked", "seed_d_passage_6", "seed_e_S_6")
    others = ("seed_e_L_3", "seed_e_L_6_planar", "seed_e_L_3_planar", "seed_b_tapered_12_links", "seed_e_S_6_universal")
    found = {f"guided {name}": example(name) for name in (*thesis, *others)}
    found |= {f"univariate {name}": example(name, minimizer="univariate") for name in ("seed_a_gates", "seed_e_L_3")}
    found |= {f"moving {name}": example(name) for name in ("door", "conveyor")}
    found["auto planes seed_d_passage_3"] = example("seed_d_passage_3", guide_planes="auto", planner="auto")
    found["guided panda"] = panda({"type": "guide_plane"}, guide_planes=None, planner="guided", start={})
    found["guided ur5 window"] = arm("ur5", {"type": "guide_plane"}, "wall_with_window", guide_planes=None)
    found["planes then joints"] = panda(joints(**TURNED), scene("posted", POST), guide_planes=GATE)
    found["planes auto then pose"] = panda(pose([0.5, 0.2, 0.45]), scene("posted", POST), guide_planes="auto")
    found["moving sphere"] = panda({"type": "guide_plane"}, scene("moved", MOVER), guide_planes=GATE)
    return found


def connected() -> dict[str, Request]:
    """Connections: arms, clouds, meshes, every shape, held objects, limits, sets, groups."""
    in_air = pose([0.5, 0.0, 0.4], position_tolerance=[0.01, 0.01, 0.01], orientation_tolerance=[0.1, 0.1, None])
    limits = {name: {"velocity": 1.0, "acceleration": 3.0, "jerk": 30.0} for name in READY}
    elbow = {"shoulder_pan_joint": 1.2, "shoulder_lift_joint": -1.2, "elbow_joint": 1.2}
    board = {"type": "box", "name": "board", "size": [0.2, 0.2, 0.1], "position": [0.4, -0.4, 0.1]}
    turns = {"j2s6s200_joint_1": 2.5, "j2s6s200_joint_4": -2.0}
    return {
        "panda shelf pose": panda(pose([0.58, 0.0, 0.48], quaternion_xyzw=[0, 0.7071068, 0, 0.7071068])),
        "panda shelf tree": panda(joints(**TURNED), planner="tree"),
        "panda shelf tree as found": panda(
            pose(
                [0.58, 0.05, 0.2], quaternion_xyzw=[0, 0.7071068, 0, 0.7071068], orientation_tolerance=[0.2, 0.2, None]
            ),
            planner="tree",
            optimization_iterations=0,
        ),
        "panda shapes pose": panda(in_air, scene("shapes", *KINDS), seed=3),
        "panda meshes": panda(joints(**TURNED), scene("meshes", *MESHES)),
        "panda cloud": panda(joints(**TURNED), scene("cloud", CLOUD)),
        "panda clearance": panda(joints(**TURNED), scene("posted", POST), min_clearance=0.03),
        "panda jerk": panda(joints(**TURNED), scene("posted", POST), limits=limits),
        "panda held rod": panda(joints(**{**TURNED, "panda_joint4": -1.9}), attached_objects=[ROD]),
        "panda set": panda(
            {"type": "joint_set", "positions": [TURNED, {**READY, "panda_joint1": -0.9}]}, scene("posted", POST)
        ),
        "panda rounds": panda(joints(**TURNED), optimization_iterations=30, seed=5),
        "panda sampled": panda(joints(**TURNED), sample_rate=50.0, max_velocity_scaling_factor=0.5),
        "panda arm and hand": panda(joints(**TURNED, panda_finger_joint1=0.03), group="arm_and_hand"),
        "panda placed": panda(joints(**TURNED), robot_placement={"position": [-0.1, 0.0, 0.1]}),
        "panda allowed": panda(joints(**TURNED), scene("posted", POST), allowed_collisions=[["panda_hand", "post"]]),
        "ur5 table": arm("ur5", joints(**elbow), "table"),
        "kinova continuous": arm("kinova", joints(**turns), scene("board", board)),
        "xarm7": arm("xarm7", joints(joint1=1.0, joint4=1.0), scene("board", board)),
        "lift prismatic continuous mimic": arm(
            LIFT, joints(lift=0.3, shoulder=2.8, elbow=0.6), scene("posted", POST), tip="hand"
        ),
        "lift all joints": arm(LIFT, joints(lift=0.2, shoulder=-2.0, grip=0.02), scene("shapes", *KINDS[:2])),
        "followers": arm(FOLLOWERS, joints(j1=1.2, j3=2.5), scene("posted", POST)),
        "followers turned": arm(FOLLOWERS, joints(j1=-0.9, j3=-4.0), scene("sphere", KINDS[0]), start={"j3": 2.0}),
        "wheeled planar": arm(WHEELED, joints(root_joint=[1.4, 0.2, 1.0], turn=0.5), scene("posted", POST), tip="hand"),
        "balls": arm(BALLS, joints(ball2=[0.0, 0.6, 0.0, 0.8], ball4=[0.28, 0.0, 0.0, 0.96]), scene("far", KINDS[0])),
        "floater": arm(
            FLOATER, joints(root_joint=[0.9, 0.6, 0.4, 0.0, 0.0, 0.6, 0.8], swing=-0.4), scene("posted", POST)
        ),
    }


def searched() -> dict[str, Request]:
    """Connections that the tree has to look for, each with several sequences of samples."""
    sideways = [0.0, 0.7071068, 0.0, 0.7071068]
    found = {}
    for seed in range(3):
        for y, z in ((-0.2, 0.48), (0.2, 0.5), (0.0, 0.83), (0.05, 0.2)):
            goal = pose([0.58, y, z], quaternion_xyzw=sideways, orientation_tolerance=[0.2, 0.2, None])
            found[f"shelf {y} {z} seed {seed}"] = panda(goal, seed=seed)
        through = pose([0.65, 0.05, 0.55], quaternion_xyzw=sideways, orientation_tolerance=[0.5, 0.5, None])
        found[f"window seed {seed}"] = arm("ur5", through, "wall_with_window", seed=seed)
        walls = scene("walls", *(_wall(f"wall{i}", x) for i, x in enumerate((-0.845, 0.845))))
        found[f"walls seed {seed}"] = panda(joints(**BENT, panda_joint1=-1.5708), walls, start=ASIDE, seed=seed)
    return found


def _wall(name: str, x: float) -> Request:
    return {"type": "box", "name": name, "size": [1.4, 0.02, 1.0], "position": [x, 0.0, 0.7]}


def constrained() -> dict[str, Request]:
    """Path constraints: a cone, a plane, a line."""
    level = {"type": "plane", "frame": HAND, "point": [0, 0, 0.487], "normal": [0, 0, 1], "tolerance": 0.02}
    line = {"type": "line", "frame": HAND, "point": [0.307, 0.0, 0.487], "direction": [0, 1, 0], "tolerance": 0.02}
    aside = pose([0.307, 0.2, 0.487], orientation_tolerance=[None, None, None])
    return {
        "cone": panda(joints(**TURNED), scene("posted", POST), path_constraints=[CONE]),
        "plane": panda(joints(**TURNED), scene("posted", POST), path_constraints=[level]),
        "line": panda(aside, scene("nothing"), tip=HAND, path_constraints=[line, CONE]),
    }


def refused() -> dict[str, Request]:
    """Honest answers "no", and a start in contact that is left."""
    deep = {"type": "box", "name": "deep", "size": [0.3, 0.3, 0.3], "position": [0.307, 0.0, 0.5]}
    above = {"type": "sphere", "name": "above", "radius": 0.1, "position": [0.307, 0.0, 0.3]}
    lid = {"type": "box", "name": "lid", "size": [0.1, 0.3, 0.02], "position": [0.307, 0.0, 0.471]}
    return {
        "start in collision": panda(joints(**TURNED), scene("deep", deep)),
        "goal in collision": panda(joints(**READY), scene("deep", deep), start=TURNED),
        "no inverse kinematics": panda(pose([1.5, 0.0, 0.5]), scene("nothing")),
        "goal beyond limits": panda(joints(panda_joint4=1.0), scene("nothing")),
        "clearance below": panda(joints(**TURNED), scene("above", above), min_clearance=0.2),
        "unknown joint": panda(joints(panda_joint9=1.0), scene("nothing")),
        "leaves contact": panda(joints(**TURNED), scene("lid", lid), leave_start_contact=True),
    }


def judged() -> dict[str, Request]:
    """Motions that are given: a path, samples in time, knots of a base that drives, one among what moves."""
    names = list(READY)
    home, turned = list(READY.values()), list(TURNED.values())
    into = [home[0], 0.9, home[2], -1.2, *home[4:]]
    late = {"allowed_time": 3600.0, "recording": "off"}
    asked_for = {"type": "certify", "robot": "panda", "position_names": names, **late}
    drive = [[0.4 * i, 0.1 * i * i, 2.9 + 0.2 * i, 0.1 * i] for i in range(4)]
    rates = [[0.4, 0.05, 0.2, 0.1]] * 4
    base = [f"root_joint.{name}" for name in ("x", "y", "theta")]
    samples = {"positions": [home, turned, home], "times": [0.0, 1.5, 3.2]}
    return {
        "judged path": {**asked_for, "scene": "table", "path": [home, turned, into]},
        "judged near": {**asked_for, "scene": scene("posted", POST), "path": [home, turned], "min_clearance": 0.02},
        "judged samples": {**asked_for, "scene": "table", "trajectory": samples},
        "judged cone": {**asked_for, "scene": "table", "path": [home, turned, into], "path_constraints": [CONE]},
        "judged among what moves": {**asked_for, "scene": scene("moved", MOVER), "trajectory": samples},
        "judged drive": {
            "type": "certify",
            "robot": WHEELED,
            "scene": scene("posted", POST),
            "trajectory": {"positions": drive, "velocities": rates, "times": [0.0, 1.0, 2.0, 3.0]},
            "position_names": [*base, "turn"],
            **late,
        },
    }


def asked() -> dict[str, Request]:
    """Kinematics, clearance, potentials."""
    somewhere = [{}, READY, TURNED, {**TURNED, "panda_joint6": 2.4}]
    shapes, clouded, meshed = scene("shapes", *KINDS), scene("cloud", CLOUD), scene("meshes", *MESHES)
    points = shell(60, 0.5, (0.3, 0.1, 0.5))
    poses = [
        {"position": [0.45, y, 0.5], "quaternion_xyzw": list(DOWN), "orientation_tolerance": [0.0, 0.0, free]}
        for y in (-0.2, 0.0, 0.25)
        for free in (0.0, None)
    ]
    inverse = {"type": "inverse_kinematics", "robot": "panda", "poses": poses, "solutions": 4, "seed": 1}
    forward = {"type": "forward_kinematics", "frames": ["panda_hand", HAND], "configurations": somewhere}
    moved = [{"lift": 0.1 * i, "shoulder": 0.9 * i - 2.0, "elbow": 0.3 * i, "grip": 0.005 * i} for i in range(5)]
    led = [{"j1": 0.4 * i - 0.8, "j3": 1.7 * i - 4.0} for i in range(5)]
    bent = [{"ball1": [0.0, 0.6, 0.0, 0.8]}, {"ball2": [0.28, 0.0, 0.0, 0.96], "ball3": [0.0, 0.0, 0.6, 0.8]}]
    return {
        "fk panda": {**forward, "robot": "panda", "robot_placement": {"position": [0.1, 0.2, 0.3]}},
        "fk lift": {"type": "forward_kinematics", "robot": LIFT, "frames": ["left", "right"], "configurations": moved},
        "fk balls": {"type": "forward_kinematics", "robot": BALLS, "frames": ["link6"], "configurations": bent},
        "fk followers": {**forward, "robot": FOLLOWERS, "frames": ["l4"], "configurations": led},
        "ik panda": inverse,
        "ik panda free": {**inverse, "scene": shapes, "collision_free": True},
        "ik ur5": {**inverse, "robot": "ur5"},
        "ik kinova": {**inverse, "robot": "kinova", "seed": 2},
        "clearance panda shapes": {"type": "clearance", "robot": "panda", "scene": shapes, "configurations": somewhere},
        "clearance panda cloud": {"type": "clearance", "robot": "panda", "scene": clouded, "configurations": somewhere},
        "clearance panda meshes": {"type": "clearance", "robot": "panda", "scene": meshed, "configurations": somewhere},
        "clearance lift": {"type": "clearance", "robot": LIFT, "scene": shapes, "configurations": moved},
        "potential at points": {"type": "potential", "scene": shapes, "points": points},
        "potential of a cloud": {"type": "potential", "scene": clouded, "points": points},
        "potential of meshes": {"type": "potential", "scene": meshed, "points": points},
        "potential on panda": {
            "type": "potential",
            "scene": "bookshelf",
            "robot": "panda",
            "configurations": somewhere,
        },
        "potential on lift": {"type": "potential", "scene": shapes, "robot": LIFT, "configurations": moved},
        "potential on balls": {"type": "potential", "scene": shapes, "robot": BALLS, "configurations": bent},
    }


def refereed() -> dict[str, Request]:
    """Motions that are given, and judged by the second certifier."""
    there = {name: request for name, request in judged().items() if name in ("judged near", "judged drive")}
    return {f"refereed {name.partition(' ')[2]}": {**one, "type": REFEREED} for name, one in there.items()}


def told() -> dict[str, Request]:
    """All about robots that were connected by then: their covers and parts are known."""
    return {f"robot {name}": {"type": "robot", "robot": name} for name in ("panda", "ur5", "kinova", "xarm7")}


REQUESTS: dict[str, Request] = {
    **{name: {**one, "allowed_time": 3600.0} for name, one in asked().items()},
    **guided(),
    **connected(),
    **searched(),
    **constrained(),
    **refused(),
    **judged(),
    **refereed(),
    **told(),
}
"""By name, in the order in which they are answered."""
