"""Requests that grow: a Panda's plan among many obstacles, along many steps, of many links, a motion of many rows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

import guidefield
from guidefield.messages.requests import ReadRobot
from guidefield.messages.values import Float32Array

PANDA = {f"panda_joint{i}": v for i, v in enumerate((0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785), 1)}
TURNED = {**PANDA, "panda_joint1": 0.9}
PATIENT = {"allowed_planning_time": 600.0, "recording": "off"}
SEED = 7

Made = dict[str, Any]


def plan(obstacles: list[Made]) -> Made:
    scene = {"name": "grown", "obstacles": obstacles}
    goal = {"type": "joints", "positions": TURNED}
    return {"robot": "panda", "scene": scene, "start": PANDA, "goal": goal, "guide_planes": [], **PATIENT}


def boxes(count: int, draw: int) -> list[Made]:
    rng, made = np.random.default_rng(draw), []
    for k in range(min(10, count)):
        angle = 0.2 * math.pi * k
        place = [0.75 * math.cos(angle), 0.75 * math.sin(angle), 0.05 + 0.02 * k]
        made.append({"type": "box", "name": f"near{k}", "size": [0.05, 0.05, 0.05], "position": place})
    while len(made) < count:
        place = rng.uniform(-8.0, 8.0, 3)
        if np.linalg.norm(place - [0.0, 0.0, 0.3]) > 2.2:
            size = rng.uniform(0.02, 0.1, 3).tolist()
            made.append({"type": "box", "name": f"far{len(made)}", "size": size, "position": place.tolist()})
    return made


def polygons(count: int, draw: int) -> list[Made]:
    """The boxes' places, a triangle at each."""
    made, corners = [], np.random.default_rng(draw).uniform(-0.1, 0.1, (count, 3, 3))
    for box, offsets in zip(boxes(count, draw), corners, strict=True):
        vertices = (np.array(box["position"]) + offsets).tolist()
        made.append({"type": "polygon", "name": box["name"], "vertices": vertices})
    return made


def moving(box: Made, way: Sequence[float]) -> Made:
    """A box that slides by a way and back in five seconds."""
    begin, end = box["position"], (np.array(box["position"]) + way).tolist()
    places = [{"position": place} for place in (begin, end, begin)]
    return {**box, "trajectory": {"times": [0.0, 2.5, 5.0], "placements": places}}


def movers(count: int, draw: int) -> list[Made]:
    ways = np.random.default_rng(draw).uniform(-0.1, 0.1, (count, 3)).tolist()
    return [moving(box, way) for box, way in zip(boxes(count, draw), ways, strict=True)]


def crossed(count: int, draw: int) -> list[Made]:
    across = {"type": "box", "name": "across", "size": [0.05, 0.05, 0.05], "position": [0.55, 0.9, 0.5]}
    return [*boxes(count, draw), moving(across, [0.0, -1.5, 0.0])]


def terrain(count: int, draw: int) -> list[Made]:
    """An open mesh of about so many triangles, 6 m wide, below the robot."""
    side = max(1, round(math.sqrt(0.5 * count)))
    u = np.linspace(-3.0, 3.0, side + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(u, u, indexing="ij"))
    z = -0.25 + 0.04 * np.sin(11.0 * x + draw) * np.cos(7.0 * y)
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    halves = [np.column_stack([corner, corner + side + 1, corner + 1])]
    halves.append(np.column_stack([corner + 1, corner + side + 1, corner + side + 2]))
    triangles, vertices = np.concatenate(halves).tolist(), np.column_stack([x, y, z]).tolist()
    return [{"type": "mesh", "name": "terrain", "vertices": vertices, "triangles": triangles}]


def cloud(count: int, draw: int) -> list[Made]:
    """So many points spread over the ground, sent as float32."""
    rng = np.random.default_rng(draw)
    points = np.column_stack([rng.uniform(-3.0, 3.0, (count, 2)), rng.uniform(-0.25, -0.22, count)])
    sent = Float32Array(points.astype("<f4").tobytes())
    return [{"type": "point_cloud", "name": "ground", "points": sent, "radius": 0.01}]


def steps(count: int, draw: int) -> Made:
    """So many steps to and fro among ten boxes."""
    ways = [{"goal": {"type": "joints", "positions": PANDA if k % 2 else TURNED}} for k in range(count)]
    asked = plan(boxes(10, draw))
    return {**{key: value for key, value in asked.items() if key not in ("goal", "guide_planes")}, "steps": ways}


CHAINS = {6: "6x300_r25", 10: "10x168_r22", 12: "12x155_r22", 20: "20x88_r22", 24: "24x77_r22", 48: "48x39_r13"}


def chain(links: int, draw: int) -> Made:
    """A chain of so many links, straight at first, that bends among ten boxes far away."""
    robot = f"chain_fixed_{CHAINS[links]}"
    balls = [joint.name for joint in guidefield.answer(ReadRobot(robot=robot)).joints if joint.kind == "spherical"]
    half = 0.3 / len(balls)
    bent = {name: [math.sin(half), 0.0, 0.0, math.cos(half)] for name in balls}
    far = [{**box, "position": [9.0, 0.1 * k, 0.0]} for k, box in enumerate(boxes(10, draw))]
    goal = {"type": "joints", "positions": bent}
    return {"robot": robot, "scene": {"name": "far", "obstacles": far}, "goal": goal, "guide_planes": [], **PATIENT}


def judgement(rows: int, draw: int) -> Made:
    """A motion through so many rows, to and fro, judged among a hundred boxes."""
    ends = np.array([list(PANDA.values()), list(TURNED.values())])
    shares = 0.5 - 0.5 * np.cos(np.linspace(0.0, 0.5 * math.pi * rows, rows))
    path = (ends[0] + shares[:, None] * (ends[1] - ends[0])).tolist()
    scene = {"name": "grown", "obstacles": boxes(100, draw)}
    asked = {"type": "certify", "robot": "panda", "scene": scene, "path": path}
    return {**asked, "allowed_time": 600.0, "recording": "off"}
