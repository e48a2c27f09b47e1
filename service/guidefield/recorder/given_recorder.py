"""The recording of a motion that was judged: the motion among the obstacles, and where and why it was refused."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

import numpy as np
from rerun.chunk import Chunk

from guidefield.errors import Status
from guidefield.messages.replies import CertifyReply, Trajectory
from guidefield.messages.requests import CertifyRequest
from guidefield.planner.motion.given_motion import GivenMotion
from guidefield.planner.motion.trajectory import piece_accelerations
from guidefield.planner.quality import ClearanceProfile
from guidefield.recorder import given_documents, scene_entities
from guidefield.recorder.along import Shown
from guidefield.recorder.chunks import PATH_TIME
from guidefield.recorder.motion import Motion, configurations_of, poses
from guidefield.recorder.place import Place
from guidefield.recorder.shared_scene import shared_scene
from guidefield.robot.group.group import PlanningGroup
from guidefield.scene.scene import Scene

EVEN_PACE = "the motion has no times: it is shown at an even pace"


class GivenRecorder:
    """Writes the recording of a motion that was judged.

    With `recording: "summary"` it holds the motion among the obstacles and the verdict; "full" adds the field.

    Args:
        place: Where to write.
        group: The joints that move, with the limits that hold for this request.
        scene: The scene that it moves in.
        request: The request as it came.
        run_id: Name of the run; identifies the recording.
        motion: The motion that was judged.
        made_with: The packages that judged it, as `versions.made_with`.
    """

    def __init__(
        self,
        place: Place,
        group: PlanningGroup,
        scene: Scene,
        request: CertifyRequest,
        run_id: str,
        motion: GivenMotion,
        made_with: str,
    ) -> None:
        self._place = place
        self._group = group
        self._scene = scene
        self._request = request
        self._run_id = run_id
        self._motion = motion
        self._made_with = made_with

    def write(self, reply: CertifyReply, measured: ClearanceProfile) -> None:
        """Write the recording.

        Args:
            reply: The answer to the request.
            measured: The clearance along the motion.

        Raises:
            OSError: if the file cannot be written; nothing is left of it.
        """
        motion = Motion(measured.times, measured.configurations, timed=self._motion.times is not None)
        shown = Shown.of(self._place, self._group, self._scene, motion, np.empty((0, 3)))
        made = [
            shown.robot(),
            shown.curves(self._trajectory(), measured, self._request.min_clearance),
            self._lasting(reply, shown),
        ]
        if self._request.recording == "full":
            made.append(shown.field())
        chunks = list(chain.from_iterable(made))
        at_fault = reply.certificate.pair or ()
        scene = shared_scene(self._scene, self._request, shown.eye.hiding, at_fault)
        self._place.write(self._run_id, chunks, scene, self._group.robot, shown.drawn, shown.eye, PATH_TIME)

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

    def _lasting(self, reply: CertifyReply, shown: Shown) -> Iterator[Chunk]:
        """What holds for the whole run."""
        group, motion, certificate = self._group, shown.motion, reply.certificate
        yield from shown.bodies(frozenset(certificate.pair or ()))
        if certificate.place is not None and reply.status.code != Status.SUCCESS:
            row = [certificate.place.configuration[name] for name in group.position_names]
            yield scene_entities.failure(reply, poses(group, configurations_of(group, [row])).tip[0])
        remarks = [*shown.drawn.faults, *([] if motion.timed or len(motion.times) < 2 else [EVEN_PACE])]
        yield from given_documents.documents_of(self._request, reply, group, self._scene, remarks, self._made_with)
