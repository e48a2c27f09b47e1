"""The recording of a motion that was judged: the motion among the obstacles, and where and why it was refused."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rerun.chunk import Chunk

from guidefield.errors import Status
from guidefield.messages.replies import CertifyReply, Trajectory
from guidefield.messages.requests import CertifyRequest
from guidefield.planner.motion.given_motion import GivenMotion
from guidefield.planner.motion.trajectory import piece_accelerations
from guidefield.planner.quality import ClearanceProfile
from guidefield.planner.task.trace import Event
from guidefield.recorder import bodies, bodies_file, documents, robot_entities, scene_entities
from guidefield.recorder.along import curves_along, field_along, robot_along
from guidefield.recorder.blueprint import Eye
from guidefield.recorder.bodies_file import Drawn
from guidefield.recorder.camera import choose_eye
from guidefield.recorder.chunks import PATH_TIME
from guidefield.recorder.given_documents import properties_of_judgement, summary_of_judgement
from guidefield.recorder.motion import Motion, configurations_of, poses
from guidefield.recorder.place import Place
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import Scene

EVEN_PACE = "the motion has no times: it is shown at an even pace"


class GivenRecorder:
    """Writes the recording of a motion that was judged, at the end.

    With `recording: "summary"` it holds the motion among the obstacles and the verdict; "full" adds the field.

    Args:
        place: Where to write.
        group: The joints that move, with the limits that hold for this request.
        scene: The scene that it moves in.
        request: The request as it came.
        run_id: Name of the run; identifies the recording.
        motion: What is judged.
    """

    def __init__(
        self,
        place: Place,
        group: PlanningGroup,
        scene: Scene,
        request: CertifyRequest,
        run_id: str,
        motion: GivenMotion,
    ) -> None:
        self._place = place
        self._group = group
        self._scene = scene
        self._request = request
        self._run_id = run_id
        self._motion = motion

    def observe(self, event: Event) -> None:
        """Nothing of what is told meanwhile is drawn."""

    def finish(self, reply: CertifyReply, profile: ClearanceProfile | None) -> None:
        """Write the recording.

        Args:
            reply: The answer to the request.
            profile: Clearance along the motion.

        Raises:
            OSError: if the file cannot be written; nothing is left of it.
        """
        group, scene, timed = self._group, self._scene, self._motion.times is not None
        assert profile is not None, "a motion that is judged is measured"
        motion = Motion(profile.times, profile.configurations, timed)
        at = poses(group, motion.configurations)
        drawn = bodies_file.prepared(group.robot, self._place.bodies)
        ends = [robot_entities.extent(group, drawn, q) for q in motion.configurations[[0, -1]]]
        robot = np.concatenate([at.placements[:, :, :3].reshape(-1, 3), *ends])
        eye = choose_eye(at.tip, robot, np.empty((0, 3)), scene.obstacles)
        chunks = [
            *robot_along(group, scene, drawn.links, motion, at),
            *curves_along(group, motion, self._trajectory(), profile, self._request.min_clearance),
            *self._lasting(reply, motion, eye, drawn),
        ]
        if self._request.recording == "full":
            chunks += field_along(group, scene, motion, at)
        self._place.write(self._run_id, chunks, group.robot, drawn, eye, PATH_TIME)

    def _trajectory(self) -> Trajectory | None:
        """The knots, where their columns are plain coordinates and there are velocities."""
        motion = self._motion
        if motion.times is None or motion.velocities is None or motion.is_point or not self._group.is_euclidean:
            return None
        begins, ends = piece_accelerations(motion.times, motion.positions, motion.velocities)
        return Trajectory(
            times=motion.times.tolist(),
            positions=motion.positions.tolist(),
            velocities=motion.velocities.tolist(),
            accelerations=np.concatenate([begins, ends[-1:]]).tolist(),
        )

    def _lasting(self, reply: CertifyReply, motion: Motion, eye: Eye, drawn: Drawn) -> Iterator[Chunk]:
        """What holds for the whole run."""
        group, scene, certificate = self._group, self._scene, reply.certificate
        at_fault = frozenset(certificate.pair or ())
        yield from bodies.highlighted(group.robot, at_fault)
        if (ghosts := robot_entities.ghosts(group, drawn, motion)) is not None:
            yield ghosts
        yield from scene_entities.obstacles(scene.obstacles, eye.hiding, at_fault)
        if certificate.place is not None and reply.status.code != Status.SUCCESS:
            row = [certificate.place.configuration[name] for name in group.position_names]
            yield scene_entities.failure(reply, poses(group, configurations_of(group, [row])).tip[0])
        remarks = [*drawn.faults, *([] if motion.timed or len(motion.times) < 2 else [EVEN_PACE])]
        yield from properties_of_judgement(self._request, reply, group, scene)
        yield summary_of_judgement(self._request, reply, group, scene, remarks)
        yield documents.message_document(documents.REQUEST, self._request)
        yield documents.message_document(documents.REPLY, reply)
