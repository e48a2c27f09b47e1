"""Connections of robots with joints of several degrees of freedom: the seed's snakes, an arm on wheels, a humanoid.

Options: [--sequences N] [--seconds S] [title ..]. A snake goes to where the guided planner led it, its goal given as a
configuration; the others between random free configurations in a furnished room. Times are of the processor, of one
thread: of a whole connection, shortened and certified, and of its trees alone.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from benchmarks.posed import posed
from benchmarks.seed import SCENES, crossed, problem_of
from guidefield.collision.lanes.lanes import BatchCollision
from guidefield.deadline import Deadline
from guidefield.errors import Status
from guidefield.messages import scene as messages
from guidefield.messages.requests import UrdfFile
from guidefield.planner.connect import tree_search
from guidefield.planner.connect.connect import connect
from guidefield.planner.connect.settings import TREE
from guidefield.planner.guide.guide import ATTEMPTS
from guidefield.planner.task.problem import LastPlaneGoal, Problem
from guidefield.robot.catalog.catalog import Catalog
from guidefield.robot.group.reduced_model import select
from guidefield.robot.urdf.meshes import CATALOG_PACKAGE, catalog_share
from guidefield.scene.scene import Scene, build

SNAKES = (*SCENES, "seed_e_L_3_planar", "seed_e_L_6_planar", "seed_b_tapered_12_links", "seed_d_passage_12_links")
MOBILE = {
    "ur5 on a planar base": ("ur_description/urdf/ur5_robot.urdf", "ur_description/srdf/ur5.srdf", "planar", ""),
    "talos' right arm, floating": (
        "talos_data/robots/talos_reduced.urdf", "talos_data/srdf/talos.srdf", "free", "arm_right torso",
    ),
}  # fmt: skip
"""URDF, SRDF, root joint; what is planned for beside that: joints with one of these words in their names, or all."""

Ways = list[tuple[np.ndarray, np.ndarray]]


def room() -> Scene:
    """A wall, a table, a post and a shelf."""
    obstacles = [
        messages.Box(name="wall", size=(0.2, 2.4, 1.6), position=(1.3, 0.3, 0.8)),
        messages.Box(name="table", size=(1.0, 0.6, 0.05), position=(-1.0, 0.8, 0.7)),
        messages.Cylinder(name="post", radius=0.15, length=2.0, position=(0.3, -1.2, 1.0)),
        messages.Box(name="shelf", size=(0.4, 1.0, 0.05), position=(-1.2, -1.0, 1.1)),
    ]
    return build(messages.Scene(name="room", obstacles=obstacles))


def snake(title: str) -> tuple[Problem, Ways]:
    """A scene of the seed's, and the way from its start to where the guided planner comes to."""
    problem = problem_of(title)
    led = crossed(problem, problem.guide_planes, ATTEMPTS["projected"](problem.group)).path[-1]
    start = problem.group.chart(problem.q_start)
    return problem, [(start, problem.group.unwrapped(problem.group.chart(led), start))]


def mobile(title: str, count: int = 6) -> tuple[Problem, Ways]:
    """A robot whose root moves, in the room, and ways between free configurations."""
    urdf, srdf, root, words = MOBILE[title]
    share = catalog_share()
    robots = share / CATALOG_PACKAGE / "robots"
    reference = UrdfFile(str(robots / urdf), str(robots / srdf), [str(share), str(robots)], root)
    robot, scene = Catalog().load(reference), room()
    names = [joint.name for joint in robot.joints if joint.mimic is None]
    if words:
        names = [name for name in names if name == "root_joint" or any(word in name for word in words.split())]
    group = select(robot, names, None, robot.rest, pin.SE3.Identity())
    problem = posed(group, scene, group.q_origin, LastPlaneGoal())
    world, rng, free = problem.world, np.random.default_rng(4), []
    while len(free) < 2 * count:
        q = group.random(rng)
        if not world.in_collision(group.expand(q)):
            free.append(group.chart(q))
    return problem, list(zip(free[::2], free[1::2], strict=True))


def timed(problem: Problem, ways: Ways, sequences: int, seconds: float) -> Iterator[tuple[bool, float, float]]:
    """Of each way and sequence whether it was found, and milliseconds of all and of the trees."""
    lanes = BatchCollision.build(problem.world)
    for start, goal in ways:
        for sequence in range(sequences):
            limited = dataclasses.replace(problem, deadline=Deadline(time.monotonic() + seconds))
            limited.__dict__["lanes"] = lanes  # made once, as for requests that share a scene
            began = time.thread_time()
            found = connect(limited, start, goal[None], np.random.default_rng(sequence))
            whole = time.thread_time() - began
            rng, deadline = np.random.default_rng(sequence), Deadline(time.monotonic() + seconds)
            began = time.thread_time()
            tree_search.grow(lanes, start[None], goal[None], TREE.resolution, 0.0, rng, deadline)
            yield found.status is Status.SUCCESS, 1000.0 * whole, 1000.0 * (time.thread_time() - began)


def run(arguments: list[str]) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="tools/bench joints", description=__doc__.partition("\n")[0])
    parser.add_argument("--sequences", type=int, default=3, help="sequences of samples for each way")
    parser.add_argument("--seconds", type=float, default=10.0, help="deadline of a connection")
    parser.add_argument("titles", nargs="*", default=[*SNAKES, *MOBILE])
    asked = parser.parse_args(arguments)
    print(f"{'':28} {'nv':>3} {'found':>8} {'ms median':>10} {'worst':>8} {'trees':>8} {'worst':>8}")
    for title in asked.titles:
        problem, ways = mobile(title) if title in MOBILE else snake(title)
        rows = np.array(list(timed(problem, ways, asked.sequences, asked.seconds)))
        (_, whole, trees), (_, worst, worst_trees) = np.median(rows, axis=0), rows.max(axis=0)
        print(
            f"{title:28} {problem.group.nv:3} {int(rows[:, 0].sum()):3} / {len(rows):2}"
            f" {whole:10.1f} {worst:8.1f} {trees:8.1f} {worst_trees:8.1f}",
            flush=True,
        )
