"""Record plans and judgements, as `.rrd` files: motion, curves, obstacles, documents, field, and the planner's work.

`run.py` calls `record_plan` and `record_judgement`; a new entity has to be placed in a view (`view.py`), too.

The planner's work is drawn over the timeline of steps: its log, steps, trees, and the motion as it was optimised.
Colours and numbers (counts: from 1) may change; they cost time and file size (`LARGEST_RECORDING` of rendering.py).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.errors import Status
from guidefield.memo import memoized_by_value
from guidefield.messages.replies import PlanReply, Trajectory
from guidefield.planner.motion.submitted_motion import SubmittedMotion
from guidefield.planner.motion.trajectory import piece_accelerations
from guidefield.planner.quality import ClearanceProfile
from guidefield.planner.task.trace import (
    GROWTH_STEPS,
    MAX_ITERATIONS,
    MAX_NODES,
    EventLog,
    LoggedEvent,
    LoggedTrees,
    Note,
    PathRelaxed,
    StageEntered,
    StageLeft,
    Step,
    StepKind,
    evenly,
)
from guidefield.potential import origin_of
from guidefield.recorder import bodies, entities
from guidefield.recorder.bodies import Drawn
from guidefield.recorder.chunks import PATH_TIME, STEP, Color, make_columns, path_times, rgba, still, timed_chunk
from guidefield.recorder.documents import JudgedRun, PlanRun, Run, document_judgement, document_plan
from guidefield.recorder.motion import (
    Curves,
    Poses,
    ShownMotion,
    configurations_of,
    curves,
    frames_of,
    placed_links,
    poses,
    position_rows,
    refused_goal,
    shown_motion,
)
from guidefield.recorder.stored import RecordingPlace, shared_scene
from guidefield.recorder.view import Eye, choose_eye
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.joints import Configuration, Configurations, LocalPoint, LocalPoints, LocalRates

MOST_FRAMES = 60  # maximum number of steps at which the robot is shown, evenly chosen
STEP_COLORS = {
    StepKind.START: (240, 240, 240, 255),
    StepKind.ADVANCE: (94, 184, 255, 255),
    StepKind.DESCEND: (255, 176, 84, 255),
    StepKind.SLIDE: (120, 220, 160, 255),
    StepKind.REORIENT: (235, 150, 220, 255),
    StepKind.TREE: (150, 150, 150, 255),
}
"""Colour by kind of step (RGBA)."""
OPTIMIZE_COLOR = (190, 160, 250, 255)  # of the optimisation (RGBA)
POINT_RADIUS = 0.006  # radius of the point of a step, at size 1 [m]
OTHER_COLOR = (200, 200, 200, 255)


def text_log(log: EventLog, reply: PlanReply) -> Iterator[Chunk]:
    """Draw a line of the log per event, with the milliseconds since the planning began, and one with the outcome."""
    planes = [plane.name for plane in reply.guide_planes]
    lines = [_line(event, 1e3 * seconds, planes) for event, seconds in zip(log.events, log.seconds, strict=True)]
    numbers = [number for number, _ in log.number_events()]
    if log.dropped:
        lines.append(("WARN", f"{log.dropped} more events were not kept", (230, 160, 60, 255)))
    good = reply.status.code == Status.SUCCESS
    lines.append(("INFO" if good else "ERROR", f"{reply.status.name}: {reply.status.message}", OTHER_COLOR))
    times = [
        # The planning is over before the motion begins: on the motion's timeline all of it stands at the start.
        rr.TimeColumn(PATH_TIME, duration=np.zeros(len(lines))),
        rr.TimeColumn(STEP, sequence=numbers + [max(numbers, default=0)] * (len(lines) - len(numbers))),
    ]
    levels, texts, colors = zip(*lines, strict=True)
    yield timed_chunk("/planner/log", times, make_columns(rr.TextLog, level=levels, text=texts, color=colors))


def step_points(log: EventLog, tip: np.ndarray, size: float) -> Iterator[Chunk]:
    """Draw the tip (n, 3) [m, world] after each step, coloured by kind of step."""
    steps = log.steps()
    colors = [STEP_COLORS.get(step.kind, OTHER_COLOR) for _, step in steps]
    if colors:
        times = [rr.TimeColumn(STEP, sequence=[number for number, _ in steps])]
        radii = np.full(len(tip), POINT_RADIUS * size)
        yield timed_chunk("/planner/tip", times, make_columns(rr.Points3D, positions=tip, colors=colors, radii=radii))


def _line(event: LoggedEvent, milliseconds: float, planes: Sequence[str]) -> tuple[str, str, tuple[int, int, int, int]]:
    level, text, color = _describe(event, planes)
    return level, f"{milliseconds:8.1f} ms  {text}", color


def _describe(event: LoggedEvent, planes: Sequence[str]) -> tuple[str, str, tuple[int, int, int, int]]:
    if isinstance(event, StageEntered):
        return "INFO", f"{event.name}: {event.message}", OTHER_COLOR
    if isinstance(event, StageLeft):
        about = f" to {planes[event.plane]}" if event.plane is not None and event.plane < len(planes) else ""
        return "INFO", f"{event.name}{about}: {event.outcome}, {1e3 * event.seconds:.1f} ms", OTHER_COLOR
    if isinstance(event, Note):
        return "WARN" if event.warning else "INFO", event.text, OTHER_COLOR
    if isinstance(event, LoggedTrees):
        sizes = " and ".join(map(str, event.sizes))
        return "INFO", f"trees of {sizes} nodes", STEP_COLORS[StepKind.TREE]
    if isinstance(event, PathRelaxed):
        return "DEBUG", f"relax: objective {event.objective:.4g}", OPTIMIZE_COLOR
    return "DEBUG", f"{event.kind.value}: {event.message}", STEP_COLORS.get(event.kind, OTHER_COLOR)


MOST_WAYPOINTS = 24  # points by which a motion that is being optimised is shown
TREE_COLOR = (150, 170, 200, 140)


def trees(group: PlanningGroup, grown: Sequence[tuple[int, LoggedTrees]]) -> Iterator[Chunk]:
    """Draw the tip's motion along the edges of trees as they grew, in `GROWTH_STEPS` steps from each one's first."""
    steps: list[int] = []
    strips: list[np.ndarray] = []
    counts: list[int] = []
    for first, event in grown:
        edges = [tree_edges(group, *tree) for tree in event.trees]
        for number in range(GROWTH_STEPS):
            batch = [edge for tree in edges for edge in np.array_split(tree, GROWTH_STEPS)[number]]
            steps.append(first + number)
            counts.append(len(batch))
            strips += batch
    if strips:
        columns = make_columns(
            rr.LineStrips3D,
            counts,
            strips=strips,
            colors=[TREE_COLOR] * len(strips),
            radii=np.full(len(strips), 0.001 * group.size),
        )
        yield timed_chunk("/planner/connect/tree", [rr.TimeColumn(STEP, sequence=steps)], columns)


def tree_edges(group: PlanningGroup, points: LocalPoints, parents: np.ndarray) -> np.ndarray:
    """Return the tip at both ends of the edges among a tree's first `MAX_NODES` nodes, (edges, 2, 3) [m, world]."""
    tips = _tips(group, points[:MAX_NODES])  # a parent comes before its children
    children = np.flatnonzero(parents[:MAX_NODES] >= 0)
    return np.stack([tips[parents[children]], tips[children]], axis=1)


def draw_relaxed_paths(group: PlanningGroup, paths: Sequence[tuple[int, PathRelaxed]]) -> Iterator[Chunk]:
    """Draw the tip's path along a motion after steps of its optimisation, each with its number on the timeline."""
    if not paths:
        return
    chosen = evenly(len(paths), MAX_ITERATIONS)
    strips = []
    for index in chosen:
        path = paths[index][1].path
        strips.append(_tips(group, path[evenly(len(path), MOST_WAYPOINTS)]))
    times = rr.TimeColumn(STEP, sequence=[paths[index][0] for index in chosen])
    columns = make_columns(
        rr.LineStrips3D,
        strips=strips,
        colors=[OPTIMIZE_COLOR] * len(strips),
        radii=np.full(len(strips), 0.003 * group.size),
    )
    yield timed_chunk("/planner/relaxed", [times], columns)


def _tips(group: PlanningGroup, points: LocalPoints) -> np.ndarray:
    tip: np.ndarray = placed_links(group, group.expand_each(points), (group.tip,))[:, 0, :3]
    return tip


CLEAR_DISTANCE = 0.10  # distance [m] from which the segment to the closest obstacle is drawn in plain green
PLOTTED = 600  # numbers in a plot of all joints, about
LEAST_PLOTTED = 40  # rows in such a plot, if there are as many
OBSTACLE_COLOR = (94, 184, 255, 255)
SELF_COLOR = (190, 160, 250, 255)
REQUIRED_COLOR = (235, 87, 87, 255)
POTENTIAL_COLOR = (255, 176, 84, 255)
LIMIT_COLOR = (150, 150, 150, 255)
TRACE_COLOR = (255, 196, 61, 255)
WAYPOINT_COLOR = (120, 220, 160, 255)


def _plot_clearance(profile: ClearanceProfile, required: float) -> Iterator[Chunk]:
    """Plot distances to obstacles and between links along the motion with the required one [m]; the potential [m]."""
    times = path_times(profile.times)
    names, colors = ["to obstacles", "to itself"], [OBSTACLE_COLOR, SELF_COLOR]
    distances = [profile.obstacle_distance, profile.self_distance]
    if required > 0.0:
        names, colors = [*names, "asked for"], [*colors, REQUIRED_COLOR]
        distances.append(np.full(len(profile.times), required))
    yield from _curves("/plots/clearance", times, np.column_stack(distances), names, colors)
    moments, values = profile.potential
    yield from _curves("/plots/potential", path_times(moments), values, ["U, along the motion"], [POTENTIAL_COLOR])


def _draw_closest_pair(profile: ClearanceProfile, size: float) -> Chunk:
    """Draw the segment between the robot and the obstacle closest to it along the motion: red where it is short."""
    there = np.array([pair is not None for pair in profile.obstacle_pair])
    there &= np.isfinite(profile.witness).all(axis=(1, 2)) & np.isfinite(profile.obstacle_distance)
    labels = [
        f"{1e3 * distance:.0f} mm  {pair[0]} - {pair[1]}"
        for distance, pair, shown in zip(profile.obstacle_distance, profile.obstacle_pair, there, strict=True)
        if shown and pair is not None
    ]
    hues = 0.36 * np.clip(profile.obstacle_distance[there] / CLEAR_DISTANCE, 0.0, 1.0)  # from red, 0, to green
    columns = make_columns(
        rr.LineStrips3D,
        there.astype(int),
        strips=profile.witness[there],
        colors=[rgba(hue, 0.68, 0.9) for hue in hues.tolist()],
        labels=labels,
        radii=np.full(int(there.sum()), 0.003 * size),
    )
    return timed_chunk("/path/closest_pair", [path_times(profile.times)], columns)


def _plot_joints(group: PlanningGroup, motion: ShownMotion, trajectory: Trajectory | None) -> Iterator[Chunk]:
    names, rates = group.position_names, group.velocity_names
    if trajectory is None or not trajectory.times:
        positions = position_rows(group, motion.configurations)
        yield from _curves("/plots/position", path_times(motion.times), positions, names, _palette(len(names)))
        return
    curve = curves(group, trajectory)
    rows = evenly(len(curve.times), max(PLOTTED // len(names), LEAST_PLOTTED))
    curve = Curves(curve.times[rows], curve.positions[rows], curve.velocities[rows], curve.accelerations[rows])
    times = path_times(curve.times)
    yield from _curves("/plots/position", times, curve.positions, names, _palette(len(names)))
    shares = {}
    if group.is_euclidean and np.isfinite(group.upper - group.lower).any():
        with np.errstate(invalid="ignore"):  # joints without limits have no share of them
            shares["position"] = (2.0 * curve.positions - group.lower - group.upper) / (group.upper - group.lower)
    for kind, values, limits in (
        ("velocity", curve.velocities, group.velocity_limits),
        ("acceleration", curve.accelerations, group.acceleration_limits),
    ):
        yield from _curves(f"/plots/{kind}", times, values, rates, _palette(len(rates)))
        shares[kind] = values / limits
    for kind, share in shares.items():
        bounded = np.column_stack([share, np.tile([-1.0, 1.0], (len(share), 1))])
        colors = [*_palette(len(rates)), LIMIT_COLOR, LIMIT_COLOR]
        yield from _curves(f"/plots/use/{kind}", times, bounded, [*rates, "lower limit", "upper limit"], colors)


def _plot_step_potential(steps: Sequence[tuple[int, Step]]) -> Iterator[Chunk]:
    known = [(number, step.potential) for number, step in steps if step.potential is not None]
    if known:
        numbers, values = zip(*known, strict=True)
        times = rr.TimeColumn(STEP, sequence=numbers)
        yield from _curves("/planner/potential", times, np.array(values), ["U, after the step"], [POTENTIAL_COLOR])


def _palette(count: int) -> list[Color]:
    """Return colours (RGBA) that differ clearly as thin lines on a dark ground."""
    colors: list[Color] = []
    for number in range(count):
        hue, lightness = (0.56 + number / count) % 1.0, 0.66 if number % 2 else 0.60
        colors.append(rgba(hue, lightness, 0.75))
    return colors


def _curves(
    path: str, times: rr.TimeColumn, values: np.ndarray, names: Sequence[str], colors: Sequence[Color]
) -> Iterator[Chunk]:
    columns = np.asarray(values, float).reshape(len(values), -1)
    yield _lines(path, tuple(names), tuple(colors))
    yield _values(path, times, np.where(np.isfinite(columns), columns, np.nan))


def _values(path: str, times: rr.TimeColumn, values: np.ndarray) -> Chunk:
    return timed_chunk(
        path, [times], make_columns(rr.Scalars, np.full(len(values), values.shape[1]), scalars=values.ravel())
    )


@memoized_by_value(256)
def _lines(path: str, names: tuple[str, ...], colors: tuple[Color, ...]) -> Chunk:
    """Return the names and colours of curves, memoized because many recordings have the same joints."""
    return still(path, rr.SeriesLines(names=names, colors=colors))


EVEN_PACE = "the motion has no times: it is shown at an even pace"
NO_TRAJECTORY = "there is no trajectory: the path is shown at an even pace, its times mean nothing"


def record_plan(place: RecordingPlace, run: PlanRun, log: EventLog) -> None:
    """Write the recording of a plan, found or not; raises OSError, and leaves nothing, if the file can't be written.

    With `recording: "summary"` it holds the motion among the obstacles and how it went, and its log only steps, the
    last of which is where a failure ended; "full" adds the field and the planner's life.
    """
    group, (request, reply) = run.group, run.as_drawn()
    full, steps, pair = request.recording == "full", log.steps(), reply.status.details.get("pair")
    colliding = frozenset(map(str, pair)) if isinstance(pair, list | tuple) else frozenset()
    refused = refused_goal(group, request, reply)
    motion = shown_motion(group, reply, run.measured, steps[-1][1].q if steps else None)
    if refused is not None:
        motion = ShownMotion(np.zeros(1), refused[None], timed=False)
    landmarks = np.array([corner for plane in reply.guide_planes for corner in plane.vertices]).reshape(-1, 3)
    view = _MotionView.of(place, run, motion, landmarks)
    chunks = [*view.robot(), *view.curves(reply.trajectory), *view.bodies(colliding)]
    if reply.path and full:
        tip = poses(group, configurations_of(group, reply.path)).tip  # before it became a trajectory
        line = rr.LineStrips3D([tip], colors=[WAYPOINT_COLOR], radii=[0.0015 * group.size])
        points = rr.Points3D(tip, colors=[WAYPOINT_COLOR], radii=[0.005 * group.size])
        chunks.append(still("/path/planned", line, points))
    chunks += [*entities.guide_planes(reply.guide_planes, group.size), *entities.goals(request, group.size)]
    if reply.status.code != Status.SUCCESS:
        chunks.append(entities.failure(reply, view.at.tip[-1], group.size))
    remarks = [*view.drawn.faults, *([] if motion.timed or len(motion.times) < 2 else [NO_TRAJECTORY])]
    chunks += document_plan(run, remarks)
    if full:
        chunks += _planning(group, log, reply, motion.configurations[0], view.drawn.links)
        if motion.timed or not steps:
            chunks += view.field()
        else:  # the planner's steps, of which no motion came
            numbers, few = zip(*(steps[index] for index in evenly(len(steps), entities.MOMENTS)), strict=True)
            chunks += view.field_at(None, np.array([s.q for s in few]), rr.TimeColumn(STEP, sequence=numbers))
    timeline = STEP if full and steps and not motion.timed else PATH_TIME
    view.write(place, chunks, colliding, timeline)


def record_judgement(
    place: RecordingPlace, run: JudgedRun, given: SubmittedMotion, planned: SubmittedMotion | None
) -> None:
    """Write the recording of a submitted motion, as `record_plan`; "full" adds the field to the summary.

    The planned motion that it was to follow, if there is one, is drawn over it.
    """
    group, reply, measured = run.group, run.reply, run.measured
    assert measured is not None, "every submitted motion is measured"
    motion = ShownMotion(measured.times, measured.configurations, timed=given.times is not None)
    view, certificate = _MotionView.of(place, run, motion, np.empty((0, 3))), reply.certificate
    at_fault = frozenset(certificate.pair or ())
    over = [] if planned is None else _lay_over(group, given, planned)
    chunks = [*view.robot(), *view.curves(_knots(group, given)), *view.bodies(at_fault), *over]
    if certificate.place is not None and reply.status.code != Status.SUCCESS:
        row = [certificate.place.configuration[name] for name in group.position_names]
        chunks.append(entities.failure(reply, poses(group, configurations_of(group, [row])).tip[0], group.size))
    remarks = [*view.drawn.faults, *([] if motion.timed or len(motion.times) < 2 else [EVEN_PACE])]
    chunks += document_judgement(run, remarks)
    if run.request.recording == "full":
        chunks += view.field()
    view.write(place, chunks, at_fault, PATH_TIME)


def _lay_over(group: PlanningGroup, given: SubmittedMotion, planned: SubmittedMotion) -> Iterator[Chunk]:
    """Draw the tip's path along a planned motion, and plot how far each joint is from it at the same time."""
    names = group.position_names
    times = np.union1d(given.scheduled.times, planned.scheduled.times)
    times = times[evenly(len(times), max(PLOTTED // len(names), LEAST_PLOTTED))]
    here, there = (
        np.array(one.scheduled.evaluate(np.clip(times, *one.scheduled.times[[0, -1]]))[0]) for one in (given, planned)
    )
    tip = poses(group, [group.from_local(cast(LocalPoint, z)) for z in there]).tip
    yield still("/path/to_follow", rr.LineStrips3D([tip], colors=[WAYPOINT_COLOR], radii=[0.003 * group.size]))
    yield from _curves("/plots/deviation", path_times(times), here - there, names, _palette(len(names)))


@dataclass(frozen=True, eq=False)
class _MotionView:
    run: Run
    motion: ShownMotion
    at: Poses
    drawn: Drawn
    eye: Eye

    @classmethod
    def of(cls, place: RecordingPlace, run: Run, motion: ShownMotion, landmarks: np.ndarray) -> _MotionView:
        at = poses(run.group, motion.configurations)
        drawn = bodies.load_drawn(run.group.robot, place.bodies)
        ends = entities.extent(run.group, drawn, motion.configurations[[0, -1]])
        robot = np.concatenate([at.placements[:, :, :3].reshape(-1, 3), ends])
        return cls(run, motion, at, drawn, choose_eye(at.tip, robot, landmarks, run.scene.obstacles, run.group.size))

    def bodies(self, at_fault: Collection[str]) -> Iterator[Chunk]:
        yield from bodies.highlight(self.run.group.robot, at_fault)
        if (ghosts := entities.ghosts(self.run.group, self.drawn, self.motion)) is not None:
            yield ghosts

    def robot(self) -> Iterator[Chunk]:
        times, at = self.motion.times, self.at
        yield entities.tip_axes(self.run.group)
        rows = evenly(len(times), frames_of(times))
        frames = Poses(at.joints, at.placements[rows], at.tip[rows])
        yield entities.link_motion(self.run.group, self.drawn.links, frames, times[rows], PATH_TIME)
        yield still("/path/tip", rr.LineStrips3D([at.tip], colors=[TRACE_COLOR], radii=[0.004 * self.run.group.size]))
        if self.motion.timed:
            yield from entities.moving(self.run.scene.obstacles, times)

    def curves(self, trajectory: Trajectory | None) -> Iterator[Chunk]:
        yield from _plot_joints(self.run.group, self.motion, trajectory)
        profile = self.run.measured
        if profile is not None and len(profile.times):
            yield _draw_closest_pair(profile, self.run.group.size)
            yield from _plot_clearance(profile, self.run.request.min_clearance)

    def field(self) -> Iterator[Chunk]:
        motion = self.motion
        rows = evenly(len(motion.times), entities.MOMENTS)
        times = motion.times[rows] if motion.timed else None
        yield from self.field_at(times, motion.configurations[rows], path_times(motion.times[rows]))

    def field_at(self, times: np.ndarray | None, qs: Configurations, column: rr.TimeColumn) -> Iterator[Chunk]:
        """Draw the field on the robot at configurations (n, nq) of times (n,), None: at first, and a picture of it."""
        if self.run.scene.obstacles:
            yield from entities.charges(self.run.group, self.run.scene, times, qs, column)
            yield from entities.picture_of_plane(self.run.scene, self.at.tip, origin_of(self.run.group))

    def write(self, place: RecordingPlace, chunks: Sequence[Chunk], at_fault: Collection[str], timeline: str) -> None:
        run = self.run
        scene = shared_scene(run.scene, run.request, self.eye.hiding, at_fault)
        place.write(run.reply.run_id, chunks, scene, run.group.robot, self.drawn, self.eye, timeline)


def _planning(
    group: PlanningGroup, log: EventLog, reply: PlanReply, start: Configuration, links: Sequence[str]
) -> Iterator[Chunk]:
    steps, numbered = log.steps(), list(log.number_events())
    yield from text_log(log, reply)
    yield from _plot_step_potential(steps)
    yield from trees(group, [(n, event) for n, event in numbered if isinstance(event, LoggedTrees)])
    yield from draw_relaxed_paths(group, [(n, event) for n, event in numbered if isinstance(event, PathRelaxed)])
    rows = evenly(len(steps), MOST_FRAMES)
    times, qs = [steps[index][0] for index in rows], [steps[index][1].q for index in rows]
    if not steps:  # trees and optimised motions are shown without the robot, which waits at its start
        times, qs = [0], [start]
    yield entities.link_motion(group, links, poses(group, qs), np.array(times), STEP)
    yield _values("/plots/position", rr.TimeColumn(STEP, sequence=times), position_rows(group, np.array(qs)))
    if steps:
        yield from step_points(log, poses(group, [step.q for _, step in steps]).tip, group.size)


def _knots(group: PlanningGroup, given: SubmittedMotion) -> Trajectory | None:
    if given.times is None or given.velocities is None or given.is_point or not group.is_euclidean:
        return None
    rises = given.accelerations
    if given.quintic is None or rises is None:
        begins, ends = piece_accelerations(given.times, given.positions, given.velocities)
        rises = cast(LocalRates, np.concatenate([begins, ends[-1:]]))
    return Trajectory(
        times=given.times.tolist(),
        positions=given.positions.tolist(),
        velocities=given.velocities.tolist(),
        accelerations=rises.tolist(),
    )
