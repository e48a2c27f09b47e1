"""The recordings of plans and judgements, `.rrd` files: all that a person needs to see what was done, and why."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.errors import Status
from guidefield.messages.replies import PlanReply, Trajectory
from guidefield.planner.motion.given_motion import GivenMotion
from guidefield.planner.motion.trajectory import piece_accelerations
from guidefield.planner.task.trace import EventLog, LoggedTrees, PathRelaxed, Step, evenly
from guidefield.potential import origin_of
from guidefield.recorder import (
    bodies,
    field_entities,
    planner_entities,
    plots,
    robot_entities,
    scene_entities,
)
from guidefield.recorder.bodies import Drawn
from guidefield.recorder.chunks import PATH_TIME, STEP, path_times
from guidefield.recorder.documents import JudgedRun, PlanRun, Run, document_judgement, document_plan
from guidefield.recorder.motion import Motion, Poses, configurations_of, frames_of, poses, refused_goal, shown_motion
from guidefield.recorder.stored import Place, shared_scene
from guidefield.recorder.view import Eye, choose_eye
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.spaces import Configuration, Configurations

EVEN_PACE = "the motion has no times: it is shown at an even pace"
NO_TRAJECTORY = "there is no trajectory: the path is shown at an even pace, its times mean nothing"


def record_plan(place: Place, run: PlanRun, log: EventLog) -> None:
    """Write the recording of a plan, found or not.

    With `recording: "summary"` it holds the motion among the obstacles and how it went; "full" adds the field and the
    planner's life.

    Args:
        place: Where to write.
        run: The plan.
        log: The planner's events; of a summary its steps alone, the last of which is where a failure ended.

    Raises:
        OSError: if the file cannot be written; nothing is left of it.
    """
    group, (request, reply) = run.group, run.seen()
    full, steps, colliding = request.recording == "full", log.steps(), _colliding(reply)
    refused = refused_goal(group, request, reply)
    motion = shown_motion(group, reply, run.measured, steps[-1][1].q if steps else None)
    if refused is not None:
        motion = Motion(np.zeros(1), refused[None], timed=False)
    landmarks = np.array([corner for plane in reply.guide_planes for corner in plane.vertices]).reshape(-1, 3)
    view = _MotionView.of(place, run, motion, landmarks)
    chunks = [*view.robot(), *view.curves(reply.trajectory), *view.bodies(colliding)]
    if reply.path and full:
        chunks += robot_entities.planned_path(poses(group, configurations_of(group, reply.path)).tip, group.size)
    chunks += [*scene_entities.guide_planes(reply.guide_planes, group.size), *scene_entities.goals(request, group.size)]
    if reply.status.code != Status.SUCCESS:
        chunks.append(scene_entities.failure(reply, view.at.tip[-1], group.size))
    remarks = [*view.drawn.faults, *([] if motion.timed or len(motion.times) < 2 else [NO_TRAJECTORY])]
    chunks += document_plan(run, remarks)
    if full:
        chunks += _planning(group, log, reply, motion.configurations[0], view.drawn.links)
        chunks += view.field() if motion.timed or not steps else _field_at_steps(view, steps)
    timeline = STEP if full and steps and not motion.timed else PATH_TIME
    view.write(place, chunks, colliding, timeline)


def record_judgement(place: Place, run: JudgedRun, given: GivenMotion) -> None:
    """Write the recording of a motion that was judged.

    With `recording: "summary"` it holds the motion among the obstacles and the verdict; "full" adds the field.

    Args:
        place: Where to write.
        run: The judgement.
        given: The motion that was judged.

    Raises:
        OSError: if the file cannot be written; nothing is left of it.
    """
    group, reply, measured = run.group, run.reply, run.measured
    assert measured is not None, "a motion that is judged is measured"
    motion = Motion(measured.times, measured.configurations, timed=given.times is not None)
    view, certificate = _MotionView.of(place, run, motion, np.empty((0, 3))), reply.certificate
    at_fault = frozenset(certificate.pair or ())
    chunks = [*view.robot(), *view.curves(_knots(group, given)), *view.bodies(at_fault)]
    if certificate.place is not None and reply.status.code != Status.SUCCESS:
        row = [certificate.place.configuration[name] for name in group.position_names]
        chunks.append(scene_entities.failure(reply, poses(group, configurations_of(group, [row])).tip[0], group.size))
    remarks = [*view.drawn.faults, *([] if motion.timed or len(motion.times) < 2 else [EVEN_PACE])]
    chunks += document_judgement(run, remarks)
    if run.request.recording == "full":
        chunks += view.field()
    view.write(place, chunks, at_fault, PATH_TIME)


@dataclass(frozen=True, eq=False)
class _MotionView:
    """A motion among its obstacles, seen from an eye.

    Attributes:
        run: The run that it is of.
        motion: The motion.
        at: Forward kinematics along it.
        drawn: The robot as it is drawn.
        eye: The eye.
    """

    run: Run
    motion: Motion
    at: Poses
    drawn: Drawn
    eye: Eye

    @classmethod
    def of(cls, place: Place, run: Run, motion: Motion, landmarks: np.ndarray) -> _MotionView:
        """View a motion, and points (k, 3) [m, world] that are to be in the picture too; k may be 0."""
        at = poses(run.group, motion.configurations)
        drawn = bodies.prepared(run.group.robot, place.bodies)
        ends = robot_entities.extent(run.group, drawn, motion.configurations[[0, -1]])
        robot = np.concatenate([at.placements[:, :, :3].reshape(-1, 3), ends])
        return cls(run, motion, at, drawn, choose_eye(at.tip, robot, landmarks, run.scene.obstacles, run.group.size))

    def bodies(self, at_fault: Collection[str]) -> Iterator[Chunk]:
        """The bodies at fault, highlighted, and the robot's ghosts."""
        yield from bodies.highlighted(self.run.group.robot, at_fault)
        if (ghosts := robot_entities.ghosts(self.run.group, self.drawn, self.motion)) is not None:
            yield ghosts

    def robot(self) -> Iterator[Chunk]:
        """The robot and its tip along the motion, among the obstacles that move."""
        times, at = self.motion.times, self.at
        yield robot_entities.tip_axes(self.run.group)
        rows = evenly(len(times), frames_of(times))
        frames = Poses(at.joints, at.placements[rows], at.tip[rows])
        yield robot_entities.link_motion(self.run.group, self.drawn.links, frames, times[rows], PATH_TIME)
        yield robot_entities.tip_trace(at.tip, self.run.group.size)
        if self.motion.timed:
            yield from scene_entities.moving(self.run.scene.obstacles, times)

    def curves(self, trajectory: Trajectory | None) -> Iterator[Chunk]:
        """Joints, given the knots if there are velocities, and distances, beside the required one."""
        yield from plots.joints(self.run.group, self.motion, trajectory)
        profile = self.run.measured
        if profile is not None and len(profile.times):
            yield plots.closest_pair(profile, self.run.group.size)
            yield from plots.clearance(profile, self.run.request.min_clearance)

    def field(self) -> Iterator[Chunk]:
        """The field, and its forces on the robot along the motion."""
        motion = self.motion
        rows = evenly(len(motion.times), field_entities.MOMENTS)
        times = motion.times[rows] if motion.timed else None
        yield from self.field_at(times, motion.configurations[rows], path_times(motion.times[rows]))

    def field_at(self, times: np.ndarray | None, qs: Configurations, column: rr.TimeColumn) -> Iterator[Chunk]:
        """The field on the robot at configurations (n, nq) of times (n,), None for before all, and a picture."""
        if self.run.scene.obstacles:
            yield from field_entities.charges(self.run.group, self.run.scene, times, qs, column)
            yield from field_entities.picture_of_plane(self.run.scene, self.at.tip, origin_of(self.run.group))

    def write(self, place: Place, chunks: Sequence[Chunk], at_fault: Collection[str], timeline: str) -> None:
        """Write chunks with the scene, in which bodies at fault are red, and a timeline to begin with."""
        run = self.run
        scene = shared_scene(run.scene, run.request, self.eye.hiding, at_fault)
        place.write(run.reply.run_id, chunks, scene, run.group.robot, self.drawn, self.eye, timeline)


def _field_at_steps(view: _MotionView, steps: Sequence[tuple[int, Step]]) -> Iterator[Chunk]:
    """The field along the planner's steps, where no motion came of them."""
    few = [steps[index] for index in evenly(len(steps), field_entities.MOMENTS)]
    column = rr.TimeColumn(STEP, sequence=[number for number, _ in few])
    return view.field_at(None, np.array([step.q for _, step in few]), column)


def _planning(
    group: PlanningGroup, log: EventLog, reply: PlanReply, start: Configuration, links: Sequence[str]
) -> Iterator[Chunk]:
    """The planner's life, over its steps."""
    steps, numbered = log.steps(), list(log.numbered())
    yield from planner_entities.text_log(log, reply)
    yield from plots.step_potential(steps)
    yield from planner_entities.trees(group, [(n, event) for n, event in numbered if isinstance(event, LoggedTrees)])
    yield from planner_entities.relaxed(group, [(n, event) for n, event in numbered if isinstance(event, PathRelaxed)])
    rows = evenly(len(steps), planner_entities.MOST_FRAMES)
    times, qs = [steps[index][0] for index in rows], [steps[index][1].q for index in rows]
    if not steps:  # trees and optimised motions are told without the robot, which waits at its start
        times, qs = [0], [start]
    yield robot_entities.link_motion(group, links, poses(group, qs), np.array(times), STEP)
    yield plots.step_positions(group, np.array(qs), np.array(times))
    if steps:
        yield from planner_entities.step_points(log, poses(group, [step.q for _, step in steps]).tip, group.size)


def _knots(group: PlanningGroup, given: GivenMotion) -> Trajectory | None:
    """The knots of a given motion, where their columns are plain coordinates and there are velocities."""
    if given.times is None or given.velocities is None or given.is_point or not group.is_euclidean:
        return None
    begins, ends = piece_accelerations(given.times, given.positions, given.velocities)
    return Trajectory(
        times=given.times.tolist(),
        positions=given.positions.tolist(),
        velocities=given.velocities.tolist(),
        accelerations=np.concatenate([begins, ends[-1:]]).tolist(),
    )


def _colliding(reply: PlanReply) -> frozenset[str]:
    """The bodies that a failure says are in collision, by name."""
    pair = reply.status.details.get("pair")
    return frozenset(map(str, pair)) if isinstance(pair, list | tuple) else frozenset()
