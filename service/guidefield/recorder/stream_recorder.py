"""Record a stream: how robot and obstacles moved, where the robot would have stopped, latency and reasons.

`stream/shown.py` writes it from a journal, or sends it to a viewer in parts. `_figures` has the values of `PLOTS`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk

from guidefield.recorder import bodies, entities, surface
from guidefield.recorder.chunks import PATH_TIME, encode_recording, from_time, make_columns, path_times, timed_chunk
from guidefield.recorder.motion import configurations_of, poses
from guidefield.recorder.view import SWITCHED_OFF, Eye, blueprint, choose_eye, scene_view
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.obstacle import Obstacle
from guidefield.scene.scene import Scene

STOP_COLOR = (235, 87, 87, 255)  # of the tip where the robot would stand (RGBA)
PLOTS = (
    ("/plots/horizon", "From each update to the proven stop [s]"),
    ("/plots/latency", "How long each update was worked on [ms]"),
)


@dataclass(frozen=True, eq=False)
class MovingBody:
    """An observed obstacle."""

    obstacle: Obstacle  # its shape, in its own frame
    times: np.ndarray  # of its observations, shape (n,) [s]
    placements: np.ndarray  # position and quaternion (x, y, z, w) then, shape (n, 7) [m, world]
    appears: np.ndarray  # times at which it appeared, shape (k,) [s]
    gone: np.ndarray  # times at which it was removed, shape (m,) [s]


@dataclass(frozen=True, eq=False)
class StreamMotion:
    """The motion of a stream as its recording shows it, by the client's clock."""

    times: np.ndarray  # of the updates, shape (n,) [s]
    rows: np.ndarray  # the robot's configuration then, in position columns, shape (n, k) [rad or m]
    stops: np.ndarray  # its configuration at the proven stop, in the same columns
    horizon: np.ndarray  # time from each update to that stop, shape (n,) [s]
    latency: np.ndarray  # time of working on each update, shape (n,) [s]
    reasons: Sequence[tuple[float, str]]  # times of updates without a piece, and why, in words
    moving: Sequence[MovingBody]


def stream_recording(name: str, group: PlanningGroup, scene: Scene, motion: StreamMotion) -> bytes:
    """Return the self-contained recording of a stream in a scene at rest: the content of an `.rrd` file."""
    still, views = stream_scene(group, scene, motion)
    return encode_recording(name, [*still, *stream_chunks(group, motion)], views)


def stream_scene(group: PlanningGroup, scene: Scene, motion: StreamMotion) -> tuple[list[Chunk], rrb.Blueprint]:
    """Draw the scene at rest, and the robot's meshes; lay out views with an eye for a motion."""
    drawn = bodies.load_drawn(group.robot, bodies.cache_folder())
    at = poses(group, configurations_of(group, motion.rows.tolist()))
    robot = at.placements[:, :, :3].reshape(-1, 3)
    eye = choose_eye(at.tip, robot, np.empty((0, 3)), scene.obstacles, group.size)
    obstacles = entities.obstacles(scene.obstacles, eye.hiding, ())
    return [entities.tip_axes(group), *obstacles, *bodies.meshes(group.robot, drawn)], _layout(eye)


def stream_chunks(group: PlanningGroup, motion: StreamMotion) -> Iterator[Chunk]:
    """Draw the robot, its stops and observed obstacles over time, and the plots."""
    links = bodies.load_drawn(group.robot, bodies.cache_folder()).links
    at = poses(group, configurations_of(group, motion.rows.tolist()))
    yield entities.link_motion(group, links, at, motion.times, PATH_TIME)
    yield from _stops(group, motion)
    for number, one in enumerate(motion.moving):
        yield from _moving(number, one)
    yield from _figures(motion)


def _stops(group: PlanningGroup, motion: StreamMotion) -> Iterator[Chunk]:
    stops = poses(group, configurations_of(group, motion.stops.tolist())).tip
    now = poses(group, configurations_of(group, motion.rows.tolist())).tip
    times = [path_times(motion.times)]
    lines = np.stack([now, stops], axis=1)
    count = len(motion.times)
    points = make_columns(rr.Points3D, positions=stops, colors=[STOP_COLOR] * count, radii=[0.012 * group.size] * count)
    yield timed_chunk("/path/stop", times, points)
    strips = make_columns(
        rr.LineStrips3D, strips=lines, colors=[STOP_COLOR] * count, radii=[0.003 * group.size] * count
    )
    yield timed_chunk("/path/to_stop", times, strips)


def _moving(number: int, one: MovingBody) -> Iterator[Chunk]:
    path, color = entities.single(one.obstacle.name), entities.obstacle_color(one.obstacle, number)
    if one.obstacle.cloud is not None:
        cloud = one.obstacle.cloud
        drawn: Any = rr.Points3D(cloud.points, radii=[cloud.radius], colors=[color])
    else:
        drawn = bodies.mesh(surface.shade(one.obstacle.vertices, one.obstacle.triangles), color)
    for time in one.appears.tolist():
        yield from_time(path, time, drawn)
    if len(one.gone):
        yield timed_chunk(path, [path_times(one.gone)], make_columns(rr.Clear, is_recursive=[False] * len(one.gone)))
    if len(one.times):
        columns = make_columns(rr.Transform3D, translation=one.placements[:, :3], quaternion=one.placements[:, 3:])
        yield timed_chunk(path, [path_times(one.times)], columns)


def _figures(motion: StreamMotion) -> Iterator[Chunk]:
    for (path, _), values in zip(PLOTS, (motion.horizon, 1e3 * motion.latency), strict=True):
        yield timed_chunk(path, [path_times(motion.times)], make_columns(rr.Scalars, scalars=values))
    if motion.reasons:
        times, texts = zip(*motion.reasons, strict=True)
        yield timed_chunk("/stream/log", [path_times(np.array(times))], make_columns(rr.TextLog, text=texts))


def _layout(eye: Eye) -> rrb.Blueprint:
    scene = scene_view("Motion, and where the robot would stand", eye, ["/robot/**", "/path/**"], SWITCHED_OFF)
    plots = [rrb.TimeSeriesView(origin=path, name=name) for path, name in PLOTS]
    log = rrb.TextLogView(origin="/stream/log", name="Why there was no piece")
    return blueprint(rrb.Horizontal(scene, rrb.Vertical(*plots, log), column_shares=[1.75, 1.0]), PATH_TIME)
