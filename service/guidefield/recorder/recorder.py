"""The recording of a plan, one `.rrd`: everything a person needs to see what the planner did, and why."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import chain

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.errors import Status
from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest
from guidefield.planner.quality import ClearanceProfile
from guidefield.planner.task.event_log import EventLog, LoggedTrees, evenly
from guidefield.planner.task.trace import PathRelaxed
from guidefield.recorder import field_entities, log, plan_documents, plots, robot_entities, scene_entities, search
from guidefield.recorder.along import Shown
from guidefield.recorder.chunks import PATH_TIME, STEP
from guidefield.recorder.motion import Motion, configurations_of, poses, refused_goal, shown_motion
from guidefield.recorder.place import Place
from guidefield.recorder.shared_scene import shared_scene
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.spaces import Configuration
from guidefield.scene.scene import Scene


class Recorder:
    """Writes the recording of a plan.

    With `recording: "summary"` it holds the motion among the obstacles and how it went; "full" adds the field and the
    planner's life.

    Args:
        place: Where to write.
        group: The joints that are planned for, with the limits that hold for this request.
        scene: The scene that is planned in; of a sequence, with what is carried as it is carried.
        request: The request as it came.
        run_id: Name of the run; identifies the recording.
        log: The planner's events; of a summary its steps alone, the last of which is where a failure ended.
        made_with: The packages that the plan was made with, as `versions.made_with`.
    """

    def __init__(
        self,
        place: Place,
        group: PlanningGroup,
        scene: Scene,
        request: PlanRequest,
        run_id: str,
        log: EventLog,
        made_with: str,
    ) -> None:
        self._place = place
        self._group = group
        self._scene = scene
        self._request = request
        self._run_id = run_id
        self._full = request.recording == "full"
        self._log = log
        self._made_with = made_with

    def write(self, reply: PlanReply, measured: ClearanceProfile | None) -> None:
        """Write the recording of a plan, found or not.

        Args:
            reply: The answer to the request.
            measured: The clearance along the trajectory, if there is one.

        Raises:
            OSError: if the file cannot be written; nothing is left of it.
        """
        steps = self._log.steps()
        refused = refused_goal(self._group, self._request, reply)
        motion = shown_motion(self._group, reply, measured, steps[-1][1].q if steps else None)
        if refused is not None:
            motion = Motion(np.zeros(1), refused[None], timed=False)
        landmarks = np.array([corner for plane in reply.guide_planes for corner in plane.vertices]).reshape(-1, 3)
        shown = Shown.of(self._place, self._group, self._scene, motion, landmarks)
        made = [self._moving(reply, measured, shown), self._lasting(reply, shown)]
        if self._full:
            made += [self._planning(reply, motion.configurations[0], shown.drawn.links), self._field(shown)]
        chunks = list(chain.from_iterable(made))
        timeline = STEP if self._full and steps and not motion.timed else PATH_TIME
        drawn_scene = shared_scene(self._scene, self._request, shown.eye.hiding, _colliding(reply))
        self._place.write(self._run_id, chunks, drawn_scene, self._group.robot, shown.drawn, shown.eye, timeline)

    def _moving(self, reply: PlanReply, profile: ClearanceProfile | None, shown: Shown) -> Iterator[Chunk]:
        """The motion, and what changes along it."""
        yield from shown.robot()
        if reply.path and self._full:
            waypoints = poses(self._group, configurations_of(self._group, reply.path))
            yield from robot_entities.planned_path(waypoints.tip)
        yield from shown.curves(reply.trajectory, profile, self._request.min_clearance)

    def _lasting(self, reply: PlanReply, shown: Shown) -> Iterator[Chunk]:
        """What holds for the whole run."""
        yield from shown.bodies(_colliding(reply))
        yield from scene_entities.guide_planes(reply.guide_planes)
        yield from scene_entities.goals(self._request)
        if reply.status.code != Status.SUCCESS:
            yield scene_entities.failure(reply, shown.at.tip[-1])
        remarks = [*shown.drawn.faults, *_shown_pace(shown.motion)]
        yield from plan_documents.documents_of(self._request, reply, self._group, self._scene, remarks, self._made_with)

    def _field(self, shown: Shown) -> Iterator[Chunk]:
        """The field, and what it does to the robot along the motion; along the planner's steps where that failed."""
        steps = self._log.steps()
        if shown.motion.timed or not steps:
            yield from shown.field()
        elif self._scene.obstacles:
            few = [steps[index] for index in evenly(len(steps), field_entities.MOMENTS)]
            times = rr.TimeColumn(STEP, sequence=[number for number, _ in few])
            yield from shown.field_at(None, np.array([step.q for _, step in few]), times)

    def _planning(self, reply: PlanReply, start: Configuration, links: Sequence[str]) -> Iterator[Chunk]:
        """What the planner did, over its steps."""
        steps = self._log.steps()
        yield from log.text_log(self._log, reply)
        yield from plots.step_potential(steps)
        numbered = list(self._log.numbered())
        yield from search.trees(self._group, [(n, event) for n, event in numbered if isinstance(event, LoggedTrees)])
        yield from search.relaxed(self._group, [(n, event) for n, event in numbered if isinstance(event, PathRelaxed)])
        shown = evenly(len(steps), log.MOST_FRAMES)
        times, qs = [steps[index][0] for index in shown], [steps[index][1].q for index in shown]
        if not steps:  # trees and optimised motions are told without the robot, which waits at its start
            times, qs = [0], [start]
        at = poses(self._group, qs)
        yield robot_entities.link_motion(self._group, links, at, np.array(times), STEP)
        yield plots.step_positions(self._group, np.array(qs), np.array(times))
        if steps:
            yield from log.step_points(self._log, poses(self._group, [step.q for _, step in steps]).tip)


def _colliding(reply: PlanReply) -> frozenset[str]:
    """Names of the bodies that a failure says are in collision."""
    pair = reply.status.details.get("pair")
    return frozenset(map(str, pair)) if isinstance(pair, list | tuple) else frozenset()


def _shown_pace(motion: Motion) -> list[str]:
    if motion.timed or len(motion.times) < 2:
        return []
    return ["there is no trajectory: the path is shown at an even pace, its times mean nothing"]
