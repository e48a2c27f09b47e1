"""Slices, schedules and the motions that keep them: against Coal at dense times, and against the limits."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from guidefield.collision.clearance import clearance_at, contacts_at
from guidefield.collision.world import World
from guidefield.messages import scene as messages
from guidefield.messages.values import Placement
from guidefield.planner.motion.trajectory import Trajectory, piece_accelerations
from guidefield.planner.path_so_far import time_path, time_path_ignoring_jerk
from guidefield.planner.schedule.retimed import retime
from guidefield.planner.schedule.schedule import (
    Schedule,
    Stuck,
    choose_step,
    count_slices,
    schedule_at_any_rate,
    schedule_at_one_rate,
)
from guidefield.planner.schedule.slices import SCHEDULE, Slices, find_free_from, find_meeting
from guidefield.planner.task.problem import Problem
from tests.planner.problems import closed_shell, problem, scene_of
from tests.robots import group, rest

PANDA = group("panda")
START = PANDA.chart(rest(PANDA))


def moved(*by: float) -> np.ndarray:
    """A chart point away from the start."""
    return START + np.array(by)


def flight(times: list[float], *places: tuple[float, float, float]) -> messages.ObstacleTrajectory:
    return messages.ObstacleTrajectory(times=times, placements=[Placement(position=place) for place in places])


def ball(radius: float = 0.1, **fields: Any) -> messages.Sphere:
    return messages.Sphere(name="ball", radius=radius, **fields)


PASSING = flight([0.5, 2.5], (0.35, -1.2, 0.6), (0.35, 1.2, 0.6))


def asked(*obstacles: messages.Obstacle, **options: Any) -> Problem:
    return problem(PANDA, scene_of(*obstacles), planes=(), **options)


def swing(made: Problem) -> Any:
    return time_path_ignoring_jerk(made, np.array([START, moved(1.2, 0.3, 0.0, 0.4, 0.0, 0.0, 0.0)]))


# ---- slices


@pytest.mark.parametrize("kind", ["ball", "shell", "shell as a box"])
def test_what_a_slice_says_is_free_is_free_at_all_times_in_it(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if kind == "shell as a box":
        coarse = dataclasses.replace(SCHEDULE, most_triangles=1)
        monkeypatch.setattr("guidefield.planner.schedule.slices.SCHEDULE", coarse)
    shell = closed_shell(0.15)
    mover = ball(trajectory=PASSING) if kind == "ball" else messages.Mesh(
        name="shell", vertices=shell.vertices, triangles=shell.triangles, trajectory=PASSING
    )  # fmt: skip
    made = asked(mover, min_clearance=0.01)
    slices = Slices(made, 0.05)
    zs = START + np.random.default_rng(3).uniform(-0.6, 0.6, (12, 7))
    free = 0
    for index, together in [*((index, 1) for index in range(15, 50, 12)), (4, 4), (9, 4)]:
        touching, length = slices.touching(index, zs, together), together * 0.05
        for time in index * length + np.linspace(0.0, length, 1 + 2 * together):
            world = World.build(PANDA, made.scene.at(time))
            for z in zs[~touching]:
                assert clearance_at(world, PANDA.expand_from_chart(z)).obstacle_distance >= 0.01
        free += int((~touching).sum())
        middle = made.at((index + 0.5) * length).world
        nearest = np.array([clearance_at(middle, PANDA.expand_from_chart(z)).obstacle_distance for z in zs])
        assert not touching[nearest > 0.1 * together].any(), "what is far is free"
    assert 0 < free < 5 * len(zs)


# ---- standing


def test_until_when_and_from_when_on_a_place_is_free_is_what_dense_times_say() -> None:
    made = asked(ball(trajectory=flight([0.5, 2.5], (0.35, -1.2, 0.6), (0.35, 1.2, 0.6))))
    times = np.arange(1.0, 2.2, 0.01)
    touching = [bool(contacts_at(World.build(PANDA, made.scene.at(t)), PANDA.expand_from_chart(START))) for t in times]
    first, last = times[touching][0], times[touching][-1]
    until, refusal = find_meeting(made, START)
    assert first - 0.04 <= until <= first
    assert refusal is not None
    assert refusal.pair[1] == "ball"
    assert last <= find_free_from(made, START) <= last + 0.04
    away = moved(2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert find_meeting(asked(ball(trajectory=flight([0.0, 1.0], (2.0, 0.0, 0.5), (2.0, 1.0, 0.5)))), away) == (
        np.inf,
        None,
    )


# ---- schedules


def touches(made: Problem, motion: Trajectory) -> bool:
    for time in np.arange(0.0, motion.times[-1], 0.04):
        z = motion.evaluate(np.array([time]))[0][0]
        if contacts_at(World.build(PANDA, made.scene.at(time)), PANDA.expand_from_chart(z)):
            return True
    return False


class Gate:
    """Cells of a path by slices of time, as a test has them."""

    def __init__(self, motion: Trajectory, count: int, closed: Any, length: float) -> None:
        self.count, self.leave_by, self.arrive_from = count, np.inf, 0.0
        self._motion, self._closed, self._length = motion, closed, length

    def cells(self, times: np.ndarray) -> np.ndarray:
        return np.round(np.minimum(times / self._motion.duration, 1.0) * (self.count - 1)).astype(np.int64)

    def free(self, first: int, last: int, _spent: Any) -> np.ndarray:
        rows = [
            [not self._closed(k * self._length, c / (self.count - 1)) for c in range(self.count)]
            for k in range(first, last)
        ]
        return np.array(rows, np.uint8)


@pytest.mark.parametrize("jerk", [None, 400.0])
def test_where_the_start_must_be_left_and_the_middle_is_closed_it_slows_down_within_the_limits(
    jerk: float | None,
) -> None:
    limits = None if jerk is None else np.full(7, jerk)
    made = asked(ball(trajectory=flight([0.0, 3.0], (3.0, 0.0, 0.0), (3.0, 1.0, 0.0))), jerk_limits=limits)
    path = np.array([START, moved(1.2, 0.3, 0.0, 0.4, 0.0, 0.0, 0.0), moved(1.6, 0.1, 0.3, 0.4, 0.0, 0.5, 0.0)])
    motion = time_path(made, path)
    length = choose_step(PANDA) / count_slices(choose_step(PANDA))
    half = 0.5 * motion.duration

    def closed(time: float, share: float) -> bool:
        return (share < 0.2 and time > half) or (0.45 < share < 0.55 and time < 4.0 * half)

    gate = Gate(motion, 50, closed, length)
    rooms = [schedule_at_any_rate(made, motion, room, gate) for room in SCHEDULE.rooms]
    found = [retime(made, one) for one in rooms if isinstance(one, Schedule)]
    kept = [one for one in found if one is not None]
    assert kept, "some room is enough"
    for one in kept:
        require_within(made, one)
        on_path(motion, one)
        times = np.arange(0.0, one.times[-1], 0.03)
        for time, share in zip(times, progress(motion, one, times), strict=True):
            assert not closed(time - 0.1, share + 0.03) or not closed(time + 0.1, share - 0.03)
        assert one.times[-1] > 4.0 * half


def progress(motion: Trajectory, retimed_motion: Trajectory, times: np.ndarray) -> np.ndarray:
    """The share of its own time at which a motion is nearest to another one at some times."""
    fine = np.linspace(0.0, motion.duration, 500)
    points = motion.evaluate(fine)[0]
    at = retimed_motion.evaluate(times)[0]
    nearest = [int(np.argmin(np.linalg.norm(points - one, axis=1))) for one in at]
    return fine[nearest] / motion.duration


def on_path(motion: Trajectory, other: Trajectory) -> None:
    """The other is on the curve of a motion, within 1 mrad, from one end to the other."""
    fine = motion.evaluate(np.linspace(0.0, motion.duration, 5000))[0]
    at = other.evaluate(np.linspace(0.0, other.times[-1], 60))[0]
    away = [float(np.linalg.norm(fine - one, axis=1).min()) for one in at]
    assert max(away) < 1e-3
    np.testing.assert_allclose(other.positions[[0, -1]], motion.positions[[0, -1]], atol=1e-12)


def require_within(made: Problem, motion: Trajectory) -> None:
    """Dense samples keep all limits; where jerk has one, accelerations don't jump at knots."""
    _, v, a = motion.evaluate(np.linspace(0.0, motion.times[-1], 20_001))
    assert (np.abs(v) <= made.group.velocity_limits * (1.0 + 1e-9)).all()
    assert (np.abs(a) <= made.group.acceleration_limits * (1.0 + 1e-9)).all()
    if made.jerk_limits is not None:
        start, end = piece_accelerations(motion.times, motion.positions, motion.velocities)
        assert (np.abs(end - start) / np.diff(motion.times)[:, None] <= made.jerk_limits * (1.0 + 1e-9)).all()
        np.testing.assert_allclose(end[:-1], start[1:], atol=1e-6)


def test_a_path_that_is_closed_for_good_is_told_with_how_far_it_went() -> None:
    made = asked(ball(trajectory=flight([0.0, 1.0], (3.0, 0.0, 0.0), (3.0, 1.0, 0.0))))
    motion = swing(made)
    gate = Gate(motion, 50, lambda _, share: 0.5 < share < 0.6, choose_step(PANDA) / count_slices(choose_step(PANDA)))
    for found in (schedule_at_one_rate(made, motion, gate), schedule_at_any_rate(made, motion, 0.9, gate)):
        assert isinstance(found, Stuck)
        assert 15 <= found.cell <= 26
