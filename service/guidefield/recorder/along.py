"""What is drawn along a motion, whoever made it: robot, tip, obstacles, curves, the closest pair, the field."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import rerun as rr
from rerun.chunk import Chunk

from guidefield.messages.replies import Trajectory
from guidefield.planner.quality import ClearanceProfile
from guidefield.recorder import field_entities, plots, robot_entities, scene_entities
from guidefield.recorder.chunks import PATH_TIME, evenly, path_times
from guidefield.recorder.motion import Motion, Poses, frames_of
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.spaces import Configurations
from guidefield.scene.scene import Scene


def robot_along(group: PlanningGroup, scene: Scene, links: Sequence[str], motion: Motion, at: Poses) -> Iterator[Chunk]:
    """The robot and its tip along a motion, among what moves.

    Args:
        group: The joints that move.
        scene: Obstacles.
        links: Links that are drawn.
        motion: The motion.
        at: Where the robot is along it.
    """
    yield robot_entities.tip_axes(group)
    rows = evenly(len(motion.times), frames_of(motion.times))
    frames = Poses(at.joints, at.placements[rows], at.tip[rows])
    yield robot_entities.link_motion(group, links, frames, motion.times[rows], PATH_TIME)
    yield robot_entities.tip_trace(at.tip)
    if motion.timed:
        yield from scene_entities.moving(scene.obstacles, motion.times)


def curves_along(
    group: PlanningGroup,
    motion: Motion,
    trajectory: Trajectory | None,
    profile: ClearanceProfile | None,
    required: float,
) -> Iterator[Chunk]:
    """Joints and distances over a motion.

    Args:
        group: The joints that move, with their limits.
        motion: The motion.
        trajectory: Its knots, if there are velocities.
        profile: Distances along it, if they were measured.
        required: What was to be kept from obstacles [m].
    """
    yield from plots.joints(group, motion, trajectory)
    if profile is not None and len(profile.times):
        yield plots.closest_pair(profile)
        yield from plots.clearance(profile, required)


def field_along(group: PlanningGroup, scene: Scene, motion: Motion, at: Poses) -> Iterator[Chunk]:
    """The field, and what it does to the robot along a motion; arguments as those of `robot_along`."""
    if not scene.obstacles:
        return
    most = field_entities.MOMENTS_AMONG_MOVING if scene.moves else field_entities.MOMENTS
    rows = evenly(len(motion.times), most)
    scenes = [scene.at(time) if motion.timed else scene for time in motion.times[rows].tolist()]
    yield from field_at(group, scene, scenes, motion.configurations[rows], path_times(motion.times[rows]), at)


def field_at(
    group: PlanningGroup, scene: Scene, scenes: Sequence[Scene], qs: Configurations, times: rr.TimeColumn, at: Poses
) -> Iterator[Chunk]:
    """The field on the robot at configurations (n, nq), among the obstacles as they then stand, and a picture of it."""
    yield from field_entities.charges(group, scenes, qs, times)
    yield from field_entities.picture_of_plane(scene, at.tip)
