"""The first answer about one robot: one process chooses a goal, another one is timed from its start to its answer."""

from __future__ import annotations

import json
import resource
import time
from pathlib import Path
from typing import Any

TRIES = 300
"""Random configurations that are tried as goals."""

REACH = 0.5
"""A goal lies at this share of the segment from rest to a random configuration, so that most have a path."""

SEED = 39


def choose(robot: str | dict[str, Any]) -> dict[str, Any]:
    """Return a request for a plan from rest to a random free configuration in an empty scene.

    Args:
        robot: The robot as a request names it.
    """
    import numpy as np
    import pinocchio as pin

    from guidefield.collision.world import World
    from guidefield.messages.requests import UrdfFile
    from guidefield.messages.scene import Scene
    from guidefield.robot.catalog import Catalog
    from guidefield.robot.group.reduced_model import select
    from guidefield.robot.model.configuration import configuration_to_wire
    from guidefield.scene.scene import build

    named = robot if isinstance(robot, str) else UrdfFile(robot["path"], package_dirs=robot["package_dirs"])
    model = Catalog().load(named)
    group = select(model, None, None, model.rest, pin.SE3.Identity())
    world = World.build(group, build(Scene(name="empty")))
    rng, rest = np.random.default_rng(SEED), group.part_of(model.rest)
    drawn = (group.interpolate(rest, group.random(rng), REACH) for _ in range(TRIES))
    goal = next((q for q in drawn if not world.in_collision(group.expand(q))), rest)
    return {
        "robot": robot,
        "scene": {"name": "empty", "obstacles": []},
        "goal": {"type": "joints", "positions": configuration_to_wire(group.joints, goal)},
        "allowed_planning_time": 60.0,
        "recording": "off",
    }


def time_answer(request: dict[str, Any], profile: Path | None = None) -> dict[str, Any]:
    """Answer a request in this process, which has done nothing else; return the line of the table.

    Args:
        request: The request for a plan.
        profile: File for a profile of the main thread, as `pstats` reads it.
    """
    import cProfile

    profiler = cProfile.Profile() if profile is not None else None
    if profiler is not None:
        profiler.enable()
    began = time.perf_counter()
    import guidefield

    try:
        reply: Any = guidefield.answer(request)
        status, message, timing = reply.status.name, reply.status.message, reply.timing
    except guidefield.GuidefieldError as error:
        status, message, timing = error.code.name, error.message, None
    if profiler is not None and profile is not None:
        profiler.disable()
        profiler.dump_stats(profile)
    return {
        "status": status,
        "message": message,
        "clock": time.perf_counter() - began,
        "cpu": time.process_time(),
        "planning": None if timing is None else timing.total - timing.load,
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
    }


def main(argument: str) -> None:
    """Print one line of JSON about a step that is asked for as JSON: `choose` or `answer`."""
    asked = json.loads(argument)
    if "choose" in asked:
        print(json.dumps(choose(asked["choose"])))
    else:
        profile = asked.get("profile")
        print(json.dumps(time_answer(asked["answer"], None if profile is None else Path(profile))))
