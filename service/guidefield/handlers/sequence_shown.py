"""What a recording of a sequence shows: the objects as they are carried, and distances along all steps."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import msgspec
import numpy as np

from guidefield.handlers.situation import CARRIED, Standing
from guidefield.handlers.steps import Steps
from guidefield.messages import scene as messages
from guidefield.messages.values import IDENTITY, Placement
from guidefield.planner.quality import Clearance, ClearanceProfile, clearance_profile
from guidefield.planner.sequence.embedding import whole_configuration
from guidefield.planner.sequence.sequence import SequencePlan
from guidefield.planner.sequence.stretches import Stretch
from guidefield.scene import scene as scenes
from guidefield.scene.scene import Scene

RATE = 30.0
"""How often it is told where a carried object is [Hz]."""

MOST = 3000
"""Most such times, over all steps."""


def carried_scene(course: Steps, made: SequencePlan[Standing]) -> Scene:
    """The obstacles at first, and what is held at first, each object that is carried moving as it is.

    Args:
        course: The steps.
        made: What came of them.
    """
    start = course.start
    if made.trajectory is None:
        return start.scene
    most = max(MOST // len(made.legs), 1)
    ways: dict[str, list[tuple[float, Placement]]] = {}
    for leg in made.legs:
        begin, end = leg.span
        times = np.linspace(begin, end, int(np.clip(np.ceil((end - begin) * RATE), 1, most)) + 1)
        zs = made.trajectory.evaluate(times)[0]
        for time, z in zip(times.tolist(), zs, strict=True) if leg.at.objects else ():
            q = whole_configuration(course.whole, course.whole.from_chart(z))
            there = dataclasses.replace(leg.at, q=q)
            for held in there.objects:
                ways.setdefault(held.name, []).append((time, _placement(there.place(held))))
    at_first = [
        *start.scene.message.obstacles,
        *(start.place(one) for one in start.objects if _shown(one.attached.obstacle)),
    ]
    moving = [_moving(one, ways[one.name]) if one.name in ways else one for one in at_first]
    return scenes.build(msgspec.structs.replace(start.scene.message, obstacles=moving))


def profile_of(measured: Sequence[tuple[Stretch, Clearance]]) -> ClearanceProfile | None:
    """Distances along all steps, one stretch after the other."""
    if not measured:
        return None
    parts = [clearance_profile(one, stretch, stretch.scene) for stretch, one in measured]
    starts = [0, *([1] * (len(parts) - 1))]
    travelled = np.cumsum([0.0, *(float(one.lengths[-1]) for one in parts)])

    def joined(name: str) -> np.ndarray:
        return np.concatenate([getattr(one, name)[first:] for one, first in zip(parts, starts, strict=True)])

    def listed(name: str) -> tuple[tuple[str, str] | None, ...]:
        return tuple(pair for one, first in zip(parts, starts, strict=True) for pair in getattr(one, name)[first:])

    return ClearanceProfile(
        times=joined("times"),
        configurations=joined("configurations"),
        lengths=np.concatenate(
            [(before + one.lengths)[first:] for before, one, first in zip(travelled, parts, starts, strict=False)]
        ),
        obstacle_distance=joined("obstacle_distance"),
        obstacle_pair=listed("obstacle_pair"),
        witness=joined("witness"),
        self_distance=joined("self_distance"),
        self_pair=listed("self_pair"),
        potentials=lambda: joined("potential"),
    )


def _shown(one: messages.Obstacle) -> bool:
    return isinstance(one, CARRIED)


def _placement(one: messages.Obstacle) -> Placement:
    assert isinstance(one, CARRIED), "only these are carried"
    return Placement(one.position, getattr(one, "quaternion_xyzw", IDENTITY))


def _moving(one: messages.Obstacle, way: Sequence[tuple[float, Placement]]) -> messages.Obstacle:
    """An obstacle that is carried: at rest where it is until the first of some times, and after the last."""
    later = {round(time, 9): placement for time, placement in way}
    trajectory = messages.ObstacleTrajectory(list(later), list(later.values()))
    moving: messages.Obstacle = msgspec.structs.replace(one, trajectory=trajectory)
    return moving
