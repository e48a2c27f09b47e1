"""Where a recording goes, whole or for a store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rerun.chunk import Chunk

from guidefield.recorder import bodies_file
from guidefield.recorder.blueprint import Eye, layout
from guidefield.recorder.bodies_file import Drawn
from guidefield.recorder.chunks import shown
from guidefield.recorder.shared_scene import SharedScene
from guidefield.recorder.whole import LINK, left_out
from guidefield.recorder.writing import write_recording
from guidefield.robot.model.model import RobotModel


@dataclass(frozen=True)
class Place:
    """Where a recording goes.

    Attributes:
        file: The recording.
        bodies: Folder of robots that are kept prepared (bodies_file.py).
        whole: Whether the robot's meshes and the layout are put into the recording; else it is for a store (whole.py).
    """

    file: Path
    bodies: Path
    whole: bool

    def write(
        self,
        run_id: str,
        chunks: Sequence[Chunk],
        scene: SharedScene,
        robot: RobotModel,
        drawn: Drawn,
        eye: Eye,
        timeline: str,
    ) -> None:
        """Write a recording.

        Args:
            run_id: Name of the run; identifies the recording.
            chunks: What is in it, but for scene and robot.
            scene: The scene.
            robot: The robot.
            drawn: As what it is drawn.
            eye: From where to look at the scene.
            timeline: The timeline to begin with.

        Raises:
            OSError: if the file cannot be written; nothing is left of it.
        """
        if not self.whole:
            linked = scene.is_large and scene.link(self.file, self.bodies)
            rest = [] if linked else scene.chunks()
            lacking = left_out(drawn.file.name, eye, timeline, scene_too=linked)
            try:
                write_recording(self.file, run_id, [*chunks, *rest, lacking], None)
            except OSError:
                self.file.with_suffix(LINK).unlink(missing_ok=True)
                raise
            return
        present = shown(chunks)
        every = [*chunks, *scene.chunks(), *bodies_file.meshes(robot, drawn)]
        write_recording(self.file, run_id, every, layout(eye, timeline, present))
