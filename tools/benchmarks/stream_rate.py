"""How long the cycle of a stream takes, from an update's bytes to the bytes of its answer.

Usage: tools/bench stream_rate [--cycles N] [--only NAME]

A Panda goes to and fro among boxes that sway, each observed anew in every update: 20 near it; 200, 20 of them near;
and a cloud of 20,000 points, in binary form, that is replaced at 10 Hz. An arm of 22 joints does so among 5 boxes. Then
the judgement alone: whether what is executed is still proven, on the same data. CPU time of the cycle's own thread:
ways are planned in another one, as in a service. Nothing is cut short.
"""

from __future__ import annotations

import argparse
import gc
import os
import time
from dataclasses import dataclass

import numpy as np

from guidefield.messages import codec
from guidefield.messages.codec import Encoding
from guidefield.messages.requests import UrdfText
from guidefield.messages.scene import Box, HalfSpace, PointCloud, Scene
from guidefield.messages.streams import Observation, Piece, StreamObstacle, StreamOpen, StreamUpdate
from guidefield.messages.values import Float32Array, JointsGoal, Placement, Positions
from guidefield.robot.catalog import Catalog
from guidefield.scene.scene import build
from guidefield.stream.stream import CertifiedStream

BENT: Positions = {
    "panda_joint2": -0.5,
    "panda_joint3": 0.0,
    "panda_joint4": -2.3,
    "panda_joint5": 0.0,
    "panda_joint6": 1.8,
    "panda_joint7": 0.8,
}
JOINTS = 22
"""Of the long arm."""


@dataclass(frozen=True)
class Kind:
    """What is measured.

    Attributes:
        boxes: How many there are.
        near: How many of them are near.
        cloud: Whether there is a cloud.
        long: Whether it is the arm of `JOINTS` joints, and no Panda.
    """

    boxes: int
    near: int
    cloud: bool = False
    long: bool = False


KINDS = {
    "20 boxes": Kind(20, 20),
    "200 boxes": Kind(200, 20),
    "cloud": Kind(3, 3, cloud=True),
    f"{JOINTS} joints": Kind(5, 5, long=True),
}

WARMING = 10
"""So many cycles aren't counted."""


def run(arguments: list[str]) -> None:
    """Measure each kind, and print a row for it."""
    parser = argparse.ArgumentParser(prog="tools/bench stream_rate", description=__doc__.splitlines()[0])
    parser.add_argument("--cycles", type=int, default=300)
    parser.add_argument("--only", choices=KINDS)
    asked = parser.parse_args(arguments)
    print(f"{'ms':10s}{'cycle':>8s}{'95 %':>7s}{'99 %':>7s}{'judged':>9s}{'99 %':>7s}{'pieces':>8s}{'load':>7s}")
    for name in [asked.only] if asked.only else KINDS:
        cycles, judged, pieces = measured(KINDS[name], asked.cycles)
        told = np.percentile(1e3 * cycles, [50, 95, 99])
        alone = np.percentile(1e3 * judged, [50, 99])
        print(
            f"{name:10s}{told[0]:8.2f}{told[1]:7.2f}{told[2]:7.2f}{alone[0]:9.3f}{alone[1]:7.3f}{pieces:8d}"
            f"{os.getloadavg()[0]:7.1f}",
            flush=True,
        )


def measured(kind: Kind, cycles: int) -> tuple[np.ndarray, np.ndarray, int]:
    """CPU times of cycles and of judgements alone [s], and how many pieces there were.

    Args:
        kind: What is measured.
        cycles: How many.
    """
    rng, count = np.random.default_rng(1), kind.boxes
    robot = Catalog().load(UrdfText(long_arm()) if kind.long else "panda")
    starts = [
        {f"j{JOINTS // 2}": turn, "j1": 0.5 * turn} if kind.long else {**BENT, "panda_joint1": turn}
        for turn in (1.0, -1.0)
    ]
    goals = [JointsGoal(one) for one in starts]
    turn, far = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(2.0, 4.0, count)
    far[: kind.near] = rng.uniform(0.75, 1.0, kind.near)
    places = np.column_stack([far * np.cos(turn), far * np.sin(turn), rng.uniform(0.1, 1.2, count)])
    sways = 0.1 * rng.normal(size=(count, 3))
    obstacles = [StreamObstacle(Box(name=f"box{k}", size=(0.1, 0.1, 0.1)), 0.5) for k in range(count)]
    floor = build(Scene("floor", obstacles=[HalfSpace(name="floor", normal=(0.0, 0.0, 1.0), offset=-0.05)]))
    request = StreamOpen(robot.name, "floor", goal=goals[0], start=starts[1], obstacles=obstacles)
    spent, alone, pieces, goal = [], [], 0, 0
    with CertifiedStream(request, robot, floor) as stream:
        gc.collect()
        gc.freeze()  # as a service does
        for cycle in range(WARMING + cycles):
            now = 0.02 * cycle
            seen = [
                Observation(f"box{k}", now, Placement(tuple(where)), tuple(velocity))
                for k, (where, velocity) in enumerate(
                    zip((places + np.sin(now) * sways).tolist(), (np.cos(now) * sways).tolist(), strict=True)
                )
            ]
            declared = [_cloud(rng)] if kind.cloud and cycle % 5 == 0 else []
            seen += [Observation("cloud", now)] if kind.cloud else []
            joints = dict(zip(stream.group.position_names, stream.executing.state(now)[:, 0].tolist(), strict=True))
            payload = codec.encode(StreamUpdate(now, seen, joints, None, declared), Encoding.MSGPACK)
            began = time.thread_time()
            answer = stream.update(codec.decode(payload, StreamUpdate, Encoding.MSGPACK))
            codec.encode(answer, Encoding.MSGPACK)
            spent.append(time.thread_time() - began)
            began = time.thread_time()
            stream.judged(now)
            alone.append(time.thread_time() - began)
            if isinstance(answer, Piece):
                pieces += 1
            elif answer.reason == "at_goal" and now >= answer.stops:
                goal += 1
                stream.aim_for(goals[goal % 2])
    gc.unfreeze()
    return np.array(spent[WARMING:]), np.array(alone[WARMING:]), pieces


def long_arm() -> str:
    """The URDF of an arm of `JOINTS` joints, upright at 0: links of 6 cm that turn about y and x in turn."""
    parts = ['<robot name="long_arm"><link name="base"/>']
    for k in range(JOINTS):
        parent = f"l{k}" if k else "base"
        axis = ("0 0 1", "0 1 0", "1 0 0")[0 if k == 0 else 1 + k % 2]
        parts.append(
            f'<link name="l{k + 1}"><collision><origin xyz="0 0 0.03"/>'
            f'<geometry><box size="0.04 0.04 0.06"/></geometry></collision></link>'
            f'<joint name="j{k + 1}" type="revolute"><parent link="{parent}"/>'
            f'<child link="l{k + 1}"/><origin xyz="0 0 {0.06 if k else 0.05}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" velocity="2" effort="10"/></joint>'
        )
    return "".join([*parts, "</robot>"])


def _cloud(rng: np.random.Generator) -> StreamObstacle:
    """20,000 points in front of the robot, in binary form."""
    points = rng.uniform([0.75, -1.0, 0.0], [1.2, 1.0, 1.2], (20_000, 3)).astype("<f4")
    return StreamObstacle(PointCloud(name="cloud", points=Float32Array(points.tobytes()), radius=0.005), 0.2)
