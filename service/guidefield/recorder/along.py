"""A motion as it is shown, whoever made it: robot, tip, obstacles, curves, the closest pair, the field."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from guidefield.messages.replies import Trajectory
from guidefield.planner.quality import ClearanceProfile
from guidefield.planner.task.event_log import evenly
from guidefield.potential import origin_of
from guidefield.recorder import bodies, bodies_file, field_entities, plots, robot_entities, scene_entities
from guidefield.recorder.blueprint import Eye
from guidefield.recorder.bodies_file import Drawn
from guidefield.recorder.camera import choose_eye
from guidefield.recorder.chunks import PATH_TIME, path_times
from guidefield.recorder.motion import Motion, Poses, frames_of, poses
from guidefield.recorder.place import Place
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.spaces import Configurations
from guidefield.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class Shown:
    """A motion among its obstacles, seen from somewhere.

    Attributes:
        group: The joints that move, with their limits.
        scene: Obstacles.
        motion: The motion.
        at: Where the robot is along it.
        drawn: As what the robot is drawn.
        eye: From where to look.
    """

    group: PlanningGroup
    scene: Scene
    motion: Motion
    at: Poses
    drawn: Drawn
    eye: Eye

    @classmethod
    def of(cls, place: Place, group: PlanningGroup, scene: Scene, motion: Motion, landmarks: np.ndarray) -> Shown:
        """A motion, and points (k, 3) [m, world] that are to be in the picture too; k may be 0."""
        at = poses(group, motion.configurations)
        drawn = bodies_file.prepared(group.robot, place.bodies)
        ends = robot_entities.extent(group, drawn, motion.configurations[[0, -1]])
        robot = np.concatenate([at.placements[:, :, :3].reshape(-1, 3), ends])
        return cls(group, scene, motion, at, drawn, choose_eye(at.tip, robot, landmarks, scene.obstacles))

    def bodies(self, at_fault: Collection[str]) -> Iterator[Chunk]:
        """The bodies at fault, highlighted, and the robot's ghosts."""
        yield from bodies.highlighted(self.group.robot, at_fault)
        if (ghosts := robot_entities.ghosts(self.group, self.drawn, self.motion)) is not None:
            yield ghosts

    def robot(self) -> Iterator[Chunk]:
        """The robot and its tip along the motion, among what moves."""
        times, at = self.motion.times, self.at
        yield robot_entities.tip_axes(self.group)
        rows = evenly(len(times), frames_of(times))
        frames = Poses(at.joints, at.placements[rows], at.tip[rows])
        yield robot_entities.link_motion(self.group, self.drawn.links, frames, times[rows], PATH_TIME)
        yield robot_entities.tip_trace(at.tip)
        if self.motion.timed:
            yield from scene_entities.moving(self.scene.obstacles, times)

    def curves(
        self, trajectory: Trajectory | None, profile: ClearanceProfile | None, required: float
    ) -> Iterator[Chunk]:
        """Joints and distances over the motion.

        Args:
            trajectory: Its knots, if there are velocities.
            profile: Distances along it, if they were measured.
            required: What was to be kept from obstacles [m].
        """
        yield from plots.joints(self.group, self.motion, trajectory)
        if profile is not None and len(profile.times):
            yield plots.closest_pair(profile)
            yield from plots.clearance(profile, required)

    def field(self) -> Iterator[Chunk]:
        """The field, and what it does to the robot along the motion."""
        if not self.scene.obstacles:
            return
        motion = self.motion
        rows = evenly(len(motion.times), field_entities.MOMENTS)
        times = motion.times[rows] if motion.timed else None
        yield from self.field_at(times, motion.configurations[rows], path_times(motion.times[rows]))

    def field_at(self, times: np.ndarray | None, qs: Configurations, column: rr.TimeColumn) -> Iterator[Chunk]:
        """The field on the robot at configurations (n, nq) of times (n,), None for before all, and a picture."""
        yield from field_entities.charges(self.group, self.scene, times, qs, column)
        yield from field_entities.picture_of_plane(self.scene, self.at.tip, origin_of(self.group))
