"""Obstacles that a way found goes close by: a wall that it grazes, a post that it just misses."""

import functools

import numpy as np

from guidefield.collision.clearance import clearance_at
from guidefield.messages import scene as messages
from guidefield.planner.connect import connect
from guidefield.planner.task.problem import Problem
from guidefield.robot.group.group import PlanningGroup
from tests.planner.problems import problem, scene_of
from tests.robots import rest


@functools.cache
def over_the_wall() -> tuple[Problem, np.ndarray]:
    """A Panda, a wall between start and goal, and a way over it that was found by the tree: it grazes the wall."""
    wall = messages.Box(name="wall", size=(0.5, 0.04, 0.7), position=(0.55, 0.0, 0.35))
    made = problem("panda", scene_of(wall), planes=())
    start, goal = made.group.chart(rest(made.group)), made.group.chart(rest(made.group))
    start[0], goal[0] = 0.9, -0.9
    start[1] = goal[1] = 0.3
    rng = np.random.default_rng(1)
    path = connect(made, start, goal[None], rng).path
    path.setflags(write=False)
    return made, path


def resampled(path: np.ndarray, step: float = 0.03) -> np.ndarray:
    """A path with a point every so much of its length."""
    lengths = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
    places = np.linspace(0.0, lengths[-1], int(np.ceil(lengths[-1] / step)) + 1)
    return np.column_stack([np.interp(places, lengths, column) for column in path.T])


def smallest_clearance(made: Problem, path: np.ndarray, ends: float = 0.0) -> float:
    """Exact smallest distance to obstacles along a polyline, some of it left out at both ends."""
    points = resampled(path)
    step = np.linalg.norm(points[1] - points[0])
    skip = int(np.ceil(ends / step))
    inner = points[skip : len(points) - skip]
    return min(clearance_at(made.world, made.group.expand_from_chart(z)).obstacle_distance for z in inner)


def beside_the_way(planned: PlanningGroup, path: np.ndarray) -> Problem:
    """A post that the straight motion just misses, and that both ends are far from."""
    middle = problem(planned, scene_of(), planes=()).kinematics.tip_position(
        planned.expand_from_chart(path.mean(axis=0))
    )
    rng = np.random.default_rng(0)
    for _ in range(1000):
        place = middle + 0.15 * rng.normal(size=3)
        post = messages.Sphere(name="post", radius=0.03, position=tuple(place.tolist()))
        made = problem(planned, scene_of(post), planes=())
        ends = [clearance_at(made.world, planned.expand_from_chart(z)).obstacle_distance for z in path]
        if min(ends) > 0.06 and 0.003 < smallest_clearance(made, path) < 0.02:
            return made
    raise AssertionError("no place for a post")
