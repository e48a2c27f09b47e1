"""An observer that writes one `.rrd` per run: everything a person needs to see what the planner did, and why."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.messages.replies import PlanReply
from guidefield.messages.requests import PlanRequest
from guidefield.planner.quality import ClearanceProfile
from guidefield.planner.trace import Event
from guidefield.recorder import bodies, documents, field_entities, log, plots, robot_entities, scene_entities
from guidefield.recorder.blueprint import layout
from guidefield.recorder.bodies import RobotBodies
from guidefield.recorder.camera import Eye, choose_eye
from guidefield.recorder.chunks import PATH_TIME, STEP, path_times
from guidefield.recorder.motion import Motion, Poses, configurations_of, poses, shown_motion
from guidefield.recorder.writing import write_recording
from guidefield.robot.group import PlanningGroup
from guidefield.scene.scene import Scene


class Recorder:
    """Watches one plan being made and writes its recording at the end.

    While the plan is made, events are only kept; drawing and writing wait for `finish`.

    Args:
        path: File to write.
        group: The joints that are planned for, with the limits that hold for this request.
        scene: The scene that is planned in.
        request: The request as it came.
        run_id: Name of the run; identifies the recording.
    """

    def __init__(self, path: Path, group: PlanningGroup, scene: Scene, request: PlanRequest, run_id: str) -> None:
        self._path = path
        self._group = group
        self._scene = scene
        self._request = request
        self._run_id = run_id
        self._log = log.EventLog()

    def observe(self, event: Event) -> None:
        """Keep what the planner tells."""
        self._log.add(event)

    def finish(self, reply: PlanReply, profile: ClearanceProfile | None) -> None:
        """Write the recording of a plan, found or not.

        Args:
            reply: The answer to the request.
            profile: Clearance along the trajectory, if there is one and it was measured.

        Raises:
            OSError: if the file cannot be written; nothing is left of it.
        """
        steps = self._log.steps()
        motion = shown_motion(self._group, reply, profile, steps[-1].q if steps else None)
        at = poses(self._group, motion.configurations)
        landmarks = np.array([corner for plane in reply.guide_planes for corner in plane.vertices]).reshape(-1, 3)
        joints = at.placements[:, :, :3].reshape(-1, 3)
        eye = choose_eye(at.tip, joints, landmarks, self._scene.obstacles)
        drawn = bodies.prepare(self._group.robot)
        chunks = [
            *self._moving(reply, profile, motion, at, drawn),
            *self._lasting(reply, motion, eye, drawn),
            *self._planning(reply),
            *field_entities.picture_of_plane(self._scene, at.tip),
        ]
        timeline = STEP if steps and not motion.timed else PATH_TIME
        present = frozenset(chunk.entity_path for chunk in chunks)
        write_recording(self._path, self._run_id, chunks, layout(eye, timeline, present))

    def _moving(
        self, reply: PlanReply, profile: ClearanceProfile | None, motion: Motion, at: Poses, drawn: RobotBodies
    ) -> Iterator[Chunk]:
        """The motion, and what changes along it."""
        yield from robot_entities.link_frames(self._group, drawn)
        yield from robot_entities.joint_motion(self._group, at, path_times(motion.times))
        yield robot_entities.tip_trace(at.tip)
        if reply.path:
            waypoints = poses(self._group, configurations_of(self._group, reply.path))
            yield from robot_entities.planned_path(waypoints.tip)
        yield from plots.joints(self._group, motion, reply.trajectory)
        if profile is not None and len(profile.times):
            yield plots.closest_pair(profile)
            yield from plots.clearance(profile, self._request.min_clearance)

    def _lasting(self, reply: PlanReply, motion: Motion, eye: Eye, drawn: RobotBodies) -> Iterator[Chunk]:
        """What holds for the whole run."""
        at_fault = _colliding(reply)
        yield from drawn.chunks
        yield from bodies.highlighted(drawn, at_fault)
        if (ghosts := robot_entities.ghosts(self._group, drawn, motion)) is not None:
            yield ghosts
        yield from scene_entities.obstacles(self._scene.obstacles, eye.hiding, at_fault)
        yield from scene_entities.guide_planes(reply.guide_planes)
        yield from documents.properties(self._request, reply, self._group, self._scene)
        yield documents.summary_document(
            self._request, reply, self._group, self._scene, [*drawn.faults, *_shown_pace(motion)]
        )
        yield documents.message_document("/documents/request", self._request)
        yield documents.message_document("/documents/reply", reply)

    def _planning(self, reply: PlanReply) -> Iterator[Chunk]:
        """What the planner did, over its steps."""
        steps = self._log.steps()
        yield from log.text_log(self._log, reply)
        yield from plots.step_potential([step.potential for step in steps])
        if not steps:
            return
        at = poses(self._group, [step.q for step in steps])
        yield from log.step_points(self._log, at.tip)
        shown = log.shown_steps(len(steps))
        times = rr.TimeColumn(STEP, sequence=shown)
        frames = Poses(at.joints, at.placements[shown], at.tip[shown])
        yield from robot_entities.joint_motion(self._group, frames, times)
        yield plots.step_positions(self._group, np.array([steps[index].q for index in shown]), times)


def _colliding(reply: PlanReply) -> frozenset[str]:
    """Names of the bodies that a failure says are in collision."""
    pair = reply.status.details.get("pair")
    return frozenset(map(str, pair)) if isinstance(pair, list | tuple) else frozenset()


def _shown_pace(motion: Motion) -> list[str]:
    if motion.timed or len(motion.times) < 2:
        return []
    return ["there is no trajectory: the path is shown at an even pace, its times mean nothing"]
