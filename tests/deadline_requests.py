"""Requests that are as large as may be, each in another way; long lists in them are arrays."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

Made = dict[str, Any]

JOINTS = [f"panda_joint{k + 1}" for k in range(7)]

REST = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]


def _plan(scene: Any = "table", **more: Any) -> Made:
    goal = {"type": "joints", "positions": {"panda_joint1": 0.4}}
    return {"robot": "panda", "scene": scene, "goal": goal, "guide_planes": [], "recording": "off", **more}


def _certify(**more: Any) -> Made:
    return {"type": "certify", "robot": "panda", "scene": "table", "position_names": JOINTS, "recording": "off", **more}


def _among(*obstacles: Made, **more: Any) -> Made:
    return _plan({"name": "many", "obstacles": list(obstacles), **more})


def _box(name: str, position: list[float], **more: Any) -> Made:
    return {"type": "box", "name": name, "size": [0.05, 0.04, 0.03], "position": position, **more}


def _away(count: int) -> list[list[float]]:
    """Places, all but ten of them out of reach."""
    places = np.random.default_rng(7).uniform([2.0, -9.0, -9.0], [9.0, 9.0, 9.0], (count, 3))
    places[:10] = [[0.75 * math.cos(0.6 * k), 0.75 * math.sin(0.6 * k), 0.05] for k in range(min(10, count))]
    return places.tolist()


def boxes(count: int) -> Made:
    """Small boxes, all but ten of them out of reach."""
    return _among(*(_box(f"b{k}", at) for k, at in enumerate(_away(count))))


def _terrain(count: int, name: str = "terrain", width: float = 3.0, below: float = -0.25) -> Made:
    """An open mesh, twice as wide."""
    side = max(1, math.isqrt(count // 2))
    u = np.linspace(-width, width, side + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(u, u, indexing="ij"))
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    halves = [np.column_stack([corner, corner + side + 1, corner + 1])]
    halves.append(np.column_stack([corner + 1, corner + side + 1, corner + side + 2]))
    corners = np.column_stack([x, y, below + width / 75.0 * np.sin(11.0 * x) * np.cos(7.0 * y)])
    return {"type": "mesh", "name": name, "vertices": corners, "triangles": np.concatenate(halves)}


def triangles(count: int) -> Made:
    """An open mesh, 6 m wide, below the robot."""
    return _among(_terrain(count))


def meshes(count: int) -> Made:
    """Many meshes of a thousand triangles."""
    placed = enumerate(_away(count))
    return _among(*({**_terrain(1000, f"m{k}", 0.03, 0.0), "position": at} for k, at in placed))


def points(count: int) -> Made:
    """A cloud over the ground."""
    rng = np.random.default_rng(7)
    spread = np.column_stack([rng.uniform(-3.0, 3.0, (count, 2)), rng.uniform(-0.25, -0.22, count)])
    return _among({"type": "point_cloud", "name": "ground", "points": spread, "radius": 0.01})


def _round(corners: int, middle: list[float], radius: float) -> np.ndarray:
    """A polygon that stands upright."""
    angles = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    return middle + radius * np.column_stack([np.zeros(corners), np.cos(angles), np.sin(angles)])


def polygons(count: int) -> Made:
    """Walls of ten thousand corners each."""
    placed = enumerate(_away(count))
    return _among(*({"type": "polygon", "name": f"p{k}", "vertices": _round(10_000, at, 0.2)} for k, at in placed))


def _planes(count: int) -> list[Made]:
    return [{"name": f"g{k}", "vertices": _round(1000, [0.4, 0.0, 0.4], 0.1 + 1e-4 * k)} for k in range(count)]


def planes(count: int) -> Made:
    """Guide planes of a thousand corners each."""
    return _plan(guide_planes=_planes(count))


def scene_planes(count: int) -> Made:
    """The same in the scene."""
    return _among(guide_planes=_planes(count)) | {"guide_planes": None}


def _moving(places: int, at: list[float]) -> Made:
    turned = np.linspace(0.0, 1.0, places)
    position = np.asarray(at) + np.column_stack([np.zeros(places), 0.1 * np.sin(9.0 * turned), 0.1 * turned])
    quaternion = np.column_stack([np.zeros((places, 2)), np.sin(turned), np.cos(turned)])
    both = zip(position.tolist(), quaternion.tolist(), strict=True)
    placements = [{"position": p, "quaternion_xyzw": q} for p, q in both]
    return {"times": 5.0 * np.linspace(0.0, 1.0, places), "placements": placements}


def places(count: int) -> Made:
    """A box that moves, with many places."""
    return _among(_box("moving", [0.0, 0.0, 0.0], trajectory=_moving(count, [0.7, 0.5, 0.4])))


def moving_mesh(count: int) -> Made:
    """A mesh of as many triangles that moves."""
    return _among(_terrain(count) | {"trajectory": _moving(3, [0.0, 0.0, -0.2])})


def moving_cloud(count: int) -> Made:
    """A cloud of as many points that moves."""
    asked = points(count)
    asked["scene"]["obstacles"][0]["trajectory"] = _moving(3, [0.0, 0.0, -0.2])
    return asked


def movers(count: int) -> Made:
    """Boxes that move."""
    return _among(*(_box(f"b{k}", at, trajectory=_moving(3, at)) for k, at in enumerate(_away(count))))


def crowd(count: int) -> Made:
    """Boxes that move, all of them within reach."""
    places = np.random.default_rng(3).uniform([-1.0, -1.0, 0.0], [1.0, 1.0, 1.2], (3 * count, 3))
    chosen = places[np.hypot(places[:, 0], places[:, 1]) > 0.35][:count].tolist()
    return _among(*(_box(f"b{k}", at, trajectory=_moving(3, at)) for k, at in enumerate(chosen)))


def _held(obstacle: Made) -> Made:
    return {"obstacle": obstacle, "link": "panda_hand", "touch_links": ["panda_leftfinger", "panda_rightfinger"]}


def held(count: int) -> Made:
    """A mesh in the hand."""
    return _plan(attached_objects=[_held(_terrain(count, "held", 0.06, 0.1))])


def held_cloud(count: int) -> Made:
    """A cloud in the hand."""
    spread = np.random.default_rng(7).uniform([-0.05, -0.05, 0.15], [0.05, 0.05, 0.25], (count, 3))
    cloud = {"type": "point_cloud", "name": "held", "points": spread, "radius": 0.002}
    return _plan(attached_objects=[_held(cloud)])


def holds(count: int) -> Made:
    """Spheres in the hand."""
    spread = np.random.default_rng(7).uniform([-0.05, -0.05, 0.12], [0.05, 0.05, 0.2], (count, 3)).tolist()
    balls = [{"type": "sphere", "name": f"s{k}", "radius": 0.002, "position": at} for k, at in enumerate(spread)]
    return _plan(attached_objects=[_held(one) for one in balls])


def _waves(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times and a slow motion of seven joints in them: positions and velocities."""
    times = 1e-2 * np.arange(count)
    phase, rate = 0.3 * times[:, None] + np.arange(7.0), 0.3
    return times, REST + 0.2 * np.sin(phase), 0.2 * rate * np.cos(phase)


def path(count: int) -> Made:
    """A path of many rows, to be judged."""
    return _certify(path=_waves(count)[1])


def trajectory(count: int) -> Made:
    """A motion in time of many rows, to be judged."""
    times, positions, velocities = _waves(count)
    return _certify(trajectory={"times": times, "positions": positions, "velocities": velocities})


def samples(count: int) -> Made:
    """The same without velocities."""
    return _certify(trajectory={"positions": _waves(count)[1]}, time_step=1e-2)


def goals(count: int) -> Made:
    """Configurations, any of which is to be reached."""
    rows = _waves(count)[1].tolist()
    return _plan(goal={"type": "joint_set", "positions": [dict(zip(JOINTS, row, strict=True)) for row in rows]})


def blocked_goals(count: int) -> Made:
    """Configurations that all touch something."""
    asked = goals(count)
    asked["scene"] = {"name": "blocked", "obstacles": [{"type": "sphere", "name": "all", "radius": 0.2}]}
    asked["scene"]["obstacles"][0]["position"] = [0.4, 0.0, 0.55]
    asked["start"] = {"panda_joint1": 2.5}
    for one in asked["goal"]["positions"]:
        one["panda_joint1"] *= 0.1
    return asked


def steps(count: int) -> Made:
    """A sequence."""
    rows = _waves(count)[1].tolist()
    goal = [{"goal": {"type": "joints", "positions": dict(zip(JOINTS, row, strict=True))}} for row in rows]
    asked = _plan(steps=goal)
    del asked["goal"], asked["guide_planes"]
    return asked


def step_planes(count: int) -> Made:
    """A step with guide planes of a thousand corners each."""
    asked = steps(1)
    asked["steps"][0]["guide_planes"] = _planes(count)
    return asked


def constraints(count: int) -> Made:
    """What the hand has to keep, again and again."""
    one = {"type": "orientation_cone", "frame": "panda_hand", "axis": [0.0, 0.0, 1.0], "target_axis": [0.0, 0.0, -1.0]}
    return _plan(path_constraints=[{**one, "half_angle": 1.0 + 1e-6 * k} for k in range(count)])


def pairs(count: int) -> Made:
    """What may touch, again and again."""
    return _plan(allowed_collisions=[["panda_hand", "panda_link1"]] * count)


def touching(count: int) -> Made:
    """Boxes, with each of which the hand may be in touch."""
    return boxes(count) | {"allowed_collisions": [["panda_hand", f"b{k}"] for k in range(count)]}


def _configurations(count: int) -> list[dict[str, float]]:
    return [dict(zip(JOINTS, row, strict=True)) for row in _waves(count)[1].tolist()]


def _work(kind: str, **more: Any) -> Made:
    return {"type": kind, "robot": "panda", **more}


def frames(count: int) -> Made:
    """Where the hand is at configurations."""
    return _work("forward_kinematics", frames=["panda_hand"], configurations=_configurations(count))


def clearances(count: int) -> Made:
    """How near obstacles are at configurations."""
    return _work("clearance", scene="table", configurations=_configurations(count))


def poses(count: int) -> Made:
    """What reaches poses."""
    spread = np.random.default_rng(7).uniform([0.3, -0.3, 0.3], [0.5, 0.3, 0.6], (count, 3)).tolist()
    turned = [1.0, 0.0, 0.0, 0.0]
    return _work("inverse_kinematics", poses=[{"position": at, "quaternion_xyzw": turned} for at in spread])


def field(count: int) -> Made:
    """The field at points."""
    spread = np.random.default_rng(7).uniform(-1.0, 1.0, (count, 3))
    return {"type": "potential", "scene": "table", "points": spread}


def links(count: int) -> Made:
    """A robot of many links, given as text."""
    made = ['<robot name="long"><link name="l0"/>']
    for k in range(count):
        made.append(
            f'<link name="l{k + 1}"><collision><geometry><box size="0.01 0.01 0.01"/></geometry></collision></link>'
            f'<joint name="j{k}" type="{"revolute" if k < 6 else "fixed"}">'
            f'<parent link="l{k}"/><child link="l{k + 1}"/>'
            '<origin xyz="0 0 0.02"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
        )
    made.append("</robot>")
    goal = {"type": "joints", "positions": {"j1": 0.4}}
    return _plan(robot={"type": "urdf", "text": "".join(made)}, goal=goal)


MAKERS: dict[str, tuple[Callable[[int], Made], int]] = {
    "boxes": (boxes, 100_000),
    "triangles": (triangles, 1_000_000),
    "points": (points, 1_000_000),
    "meshes": (meshes, 1_000),
    "polygons": (polygons, 100),
    "planes": (planes, 1_000),
    "scene_planes": (scene_planes, 1_000),
    "step_planes": (step_planes, 1_000),
    "places": (places, 100_000),
    "movers": (movers, 2_000),
    "crowd": (crowd, 2_000),
    "moving_mesh": (moving_mesh, 1_000_000),
    "moving_cloud": (moving_cloud, 1_000_000),
    "held": (held, 30_000),
    "held_cloud": (held_cloud, 3_000),
    "holds": (holds, 1_000),
    "path": (path, 400_000),
    "trajectory": (trajectory, 200_000),
    "samples": (samples, 400_000),
    "goals": (goals, 10_000),
    "blocked_goals": (blocked_goals, 10_000),
    "steps": (steps, 200),
    "constraints": (constraints, 100),
    "pairs": (pairs, 100_000),
    "touching": (touching, 100_000),
    "frames": (frames, 100_000),
    "clearances": (clearances, 100_000),
    "poses": (poses, 10_000),
    "field": (field, 1_000_000),
    "links": (links, 1_999),
}
"""Requests by what they have many of, and how many are tried at most."""
