"""The cheapest schedule along a path among moving obstacles, within a tube about it; and flights.

Nothing here needs a proof: the judge proves each piece. A change costs time or gives other motions; journals that are
kept replay to other pieces then.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.collision.batch.batch_collision import BatchCollision
from guidefield.kernels.collide.parts import BALL_ROW
from guidefield.kernels.stream.dodge import KeptClearances, Tube, find_schedule
from guidefield.read_only import ReadOnly
from guidefield.robot.model.joints import LocalPoint, LocalPoints
from guidefield.stream.obstacles import DriftingObstacles
from guidefield.stream.settings import STREAM
from guidefield.stream.shapes import read_only_views


@dataclass(frozen=True, eq=False)
class PathTarget(ReadOnly):
    """The next target along a path."""

    direction: np.ndarray  # from the configuration in which the robot could stand, shape (nv,)
    place: float  # place on the path next to that, in time at full speed [s]
    # the target, if it is not to be passed: the path's end, or a place to wait at, shape (nv,); else None
    last: LocalPoint | None
    left: float  # the rest of the path, in time at full speed [s]


class TimedPath:
    """A path, measured by the time that the slowest coordinate takes at full speed.

    Args:
        points: Shape (m, nv), m > 1.
        speeds: Velocity limits, shape (nv,).
        times: Earliest time at each point [s], shape (m,); None: any.

    Attributes:
        begins: Place of each point along the path [s], shape (m,).
    """

    def __init__(self, points: LocalPoints, speeds: np.ndarray, times: np.ndarray | None = None) -> None:
        self.points, self.speeds = points, speeds
        self.times = np.full(len(points), -np.inf) if times is None else times
        lengths = np.abs(np.diff(points, axis=0) / speeds).max(axis=1)
        self.begins = np.concatenate([[0.0], np.cumsum(lengths)])

    @property
    def goal(self) -> LocalPoint:
        """Its end, shape (nv,)."""
        end: LocalPoint = self.points[-1]
        return end

    @property
    def length(self) -> float:
        """Its length [s]."""
        return float(self.begins[-1])

    def at(self, place: float) -> LocalPoint:
        """The point (nv,) at a place [s]; the goal itself, to the last bit, at the end."""
        if place >= self.length:
            return self.goal
        index = int(np.clip(np.searchsorted(self.begins, place, side="right") - 1, 0, len(self.points) - 2))
        span = self.begins[index + 1] - self.begins[index]
        share = min(1.0, (place - self.begins[index]) / span) if span > 0.0 else 1.0
        point: LocalPoint = self.points[index] + share * (self.points[index + 1] - self.points[index])
        return point

    def due(self, time: float) -> float:
        """The farthest place that is allowed at a time [s]; infinite once all of it is due."""
        k = int(np.searchsorted(self.times, time, side="right"))
        if k >= len(self.times):
            return np.inf
        if k == 0:
            return 0.0
        share = (time - self.times[k - 1]) / (self.times[k] - self.times[k - 1])
        return float(self.begins[k - 1] + share * (self.begins[k] - self.begins[k - 1]))

    def aim(self, stand: LocalPoint, since: float, ahead: float, due: float = np.inf) -> PathTarget:
        """Choose the next target.

        Args:
            stand: The configuration in which the robot could stand at the soonest, shape (nv,).
            since: The place [s] from which on the nearest one is searched for; 0: on all of the path.
            ahead: Distance of the target from the nearest place [s].
            due: The farthest place that is allowed [s].
        """
        place = self.nearest(stand, since, min(due, since + 2.0 * ahead if since > 0.0 else np.inf))
        beyond = place + ahead
        if due < min(beyond, self.length):
            target = self.at(max(due, place))
            return PathTarget(target - stand, place, target, self.length - place)
        last = beyond >= self.length
        target = self.goal if last else self.at(beyond)
        return PathTarget(target - stand, place, self.goal if last else None, self.length - place)

    def rest(self, stand: LocalPoint, place: float, until: float = np.inf) -> LocalPoints:
        """From where the robot could stand, shape (nv,), along the path from a place to another one [s], (k, nv)."""
        inner = self.points[(self.begins > place) & (self.begins < until)]
        return np.concatenate([stand[None], inner, self.at(min(until, self.length))[None]])

    def nearest(self, z: LocalPoint, since: float, until: float) -> float:
        """The place [s] in a segment of the path that is nearest to a point (nv,)."""
        first = int(np.clip(np.searchsorted(self.begins, since, side="right") - 1, 0, len(self.points) - 2))
        last = max(first + 1, int(np.searchsorted(self.begins, min(until, self.length), side="left")))
        shares = self.speeds.min() / self.speeds  # at most 1: however slow joints are, nothing overflows
        a = self.points[first:last] * shares
        d = self.points[first + 1 : last + 1] * shares - a
        squares = np.maximum((d * d).sum(axis=1), 1e-300)
        share = np.clip((d * (z * shares - a)).sum(axis=1) / squares, 0.0, 1.0)
        away = ((a + share[:, None] * d - z * shares) ** 2).sum(axis=1)
        spans = self.begins[first + 1 : last + 1] - self.begins[first:last]
        places = self.begins[first:last] + share * spans
        return max(since, float(places[np.argmin(away)]))


PROBE_STEP = 4e-3  # step of a coordinate for the differences of `pressure_slope` [rad, or m at size 1]


def measure_pressures(batch: BatchCollision, boxes: np.ndarray, zs: LocalPoints, near: float) -> np.ndarray:
    """Half the squares of what boxes (k, 16) lack of a distance `near`, summed, at points (n, nv): (n,) [m²]."""
    lacks = np.maximum(near - batch.gaps(boxes, zs, near), 0.0)
    surrounding: np.ndarray = 0.5 * (lacks * lacks).sum(axis=1)
    return surrounding


def pressure_slope(batch: BatchCollision, boxes: np.ndarray, z: LocalPoint, near: float) -> np.ndarray:
    """The gradient of the pressure at local coordinates (nv,), shape (nv,): by differences, as distances have edges."""
    steps = PROBE_STEP * batch.world.group.sizes
    probes = np.concatenate([z + np.diag(steps), z - np.diag(steps)])
    above, below = measure_pressures(batch, boxes, cast(LocalPoints, probes), near).reshape(2, -1)
    slope: np.ndarray = (above - below) / (2.0 * steps)
    return slope


def draw_flights(gradient: np.ndarray, speeds: np.ndarray, rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Velocities (nv,) down the gradient (nv,) first, then in random directions that lead down as well.

    Args:
        speeds: Velocity limits, shape (nv,).
    """
    down = -gradient * speeds
    largest = float(np.abs(down).max())
    directions = [down / largest] if largest > 0.0 else []
    for drawn in rng.normal(size=(STREAM.flights - 1, len(speeds))):
        side = drawn if float(drawn @ gradient) <= 0.0 else -drawn
        directions.append(side / float(np.abs(side).max()))
    for share in STREAM.flight_speeds:
        for direction in directions:
            yield share * direction * speeds


@dataclass(frozen=True, eq=False)
class ScheduledPath(ReadOnly):
    """A path with times among what moves."""

    cost: float  # the time of arrival, and `STREAM.dear` times the distances that are too small along it [s]
    points: LocalPoints  # shape (m, nv), m > 1
    times: np.ndarray  # time at each point, since its beginning [s], shape (m,)


def draw_sides(count: int, speeds: np.ndarray) -> np.ndarray:
    """Random directions, the same each time, shape (count, nv), as far as one goes at full speed within a step.

    Args:
        speeds: Velocity limits, shape (nv,).
    """
    drawn = np.random.default_rng(0).normal(size=(count, len(speeds)))
    sides: np.ndarray = STREAM.step * speeds * drawn / np.abs(drawn).max(axis=1, keepdims=True)
    return sides


def choose_sides(batch: BatchCollision, drifting: DriftingObstacles, path: TimedPath, drawn: np.ndarray) -> np.ndarray:
    """Choose sidesteps from a path: `drawn` (k, nv), back, and away from obstacles that come close; shape (d, nv)."""
    back, speeds, near = path.at(0.0) - path.at(STREAM.back), path.speeds, STREAM.pressed * batch.world.group.size
    directions = [back / speeds]
    for after, place in STREAM.sidesteps:
        boxes = drifting.after(after)
        directions.append(-speeds * pressure_slope(batch, boxes, path.at(place), near))
    largest = [float(np.abs(one).max()) for one in directions]
    led = [STREAM.step * speeds * one / most for one, most in zip(directions, largest, strict=True) if most > 0.0]
    return np.concatenate([drawn, np.array(led).reshape(-1, len(speeds))])


def build_tube(
    path: TimedPath, sides: np.ndarray, speeds: np.ndarray, taken: Callable[[LocalPoints], np.ndarray], foreseen: int
) -> Tube:
    """The tube about a path with sides (d, nv), for a given number of steps.

    `taken` says of local coordinates (n, nv) whether the robot can't be there, (n,).
    """
    places = [path.at(min(STREAM.step * k, path.length)) for k in range(math.ceil(path.length / STREAM.step) + 1)]
    places.extend([path.goal] * STREAM.stays)
    rows: LocalPoints = np.array(places)
    steps = np.arange(1, STREAM.levels + 1)
    offsets = (sides[:, None] * steps[:, None]).reshape(-1, rows.shape[1])
    beside = cast(LocalPoints, (rows[: foreseen + 1, None] + offsets).reshape(-1, rows.shape[1]))
    blocked = np.zeros((len(rows), 1 + len(sides) * STREAM.levels), np.int64)
    blocked[: foreseen + 1, 1:] = taken(beside).reshape(-1, blocked.shape[1] - 1)
    return read_only_views(Tube(rows, sides, blocked, speeds, STREAM.step, STREAM.stays))


def schedule_path(
    batch: BatchCollision, drifting: DriftingObstacles, kept: np.ndarray, tube: Tube, path: TimedPath, foreseen: int
) -> ScheduledPath:
    """Find the cheapest timed path in a tube, with the rest of the path behind it.

    Args:
        kept: Distances to keep from each obstacle on the move, while waiting, and at the end, shape (3, k) [m].
    """
    steps, reached = np.empty((foreseen + 1, tube.places.shape[1])), np.empty(foreseen + 1, np.int64)
    boxes, balls = max(STREAM.few, len(drifting.boxes)), max(STREAM.plain, len(batch.robot.bodies.cover) // BALL_ROW)
    width = STREAM.beside * STREAM.few * STREAM.plain // (boxes * balls)
    size = batch.world.group.size
    wanted = read_only_views(KeptClearances(kept, STREAM.widening * size, STREAM.dear / size))
    rows, cost = find_schedule(batch.words, drifting.boxes, drifting.drifts, wanted, tube, width, steps, reached)
    points, times = _along(path, tube, steps[:rows], reached[:rows])
    while len(points) > 2 and (points[-2] == points[-1]).all():
        points, times = points[:-1], times[:-1]
    times[-1] = times[-2] + float((np.abs(points[-1] - points[-2]) / tube.speeds).max())
    return ScheduledPath(float(cost), points, times)


def _along(path: TimedPath, tube: Tube, steps: LocalPoints, reached: np.ndarray) -> tuple[LocalPoints, np.ndarray]:
    """The points and times of a schedule, with the corners of the path between them: straight past them isn't free."""
    places, columns = np.divmod(reached, tube.taken.shape[1])
    at = np.minimum(tube.step * places, path.length)
    points, times = [steps[:1]], [np.zeros(1)]
    for i in range(1, len(steps)):
        if columns[i - 1] == columns[i] == 0 and at[i - 1] != at[i]:
            passed = np.flatnonzero((path.begins > min(at[i - 1], at[i])) & (path.begins < max(at[i - 1], at[i])))
            passed = passed if at[i - 1] < at[i] else passed[::-1]
            points.append(path.points[passed])
            times.append(tube.step * (i - 1 + (path.begins[passed] - at[i - 1]) / (at[i] - at[i - 1])))
        points.append(steps[i : i + 1])
        times.append(np.array([tube.step * i]))
    since, now = float(at[-1]), tube.step * (len(steps) - 1)
    if columns[-1] > 0:  # from beside the path to its next place
        now, since = now + tube.step, min(since + tube.step, path.length)
        points.append(path.at(since)[None])
        times.append(np.array([now]))
    ahead = path.begins > since
    points.append(path.points[ahead])
    times.append(now + path.begins[ahead] - since)
    return cast(LocalPoints, np.concatenate(points)), np.concatenate(times)
