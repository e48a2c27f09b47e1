"""Prepare a robot for its first connection: bounding spheres, convex parts, trees of meshes, points on links.

It takes about a second for an arm whose links are meshes, some seconds for a humanoid. Results are kept on disk
(`geometry/cache.py`), so that a preparation that was stopped goes on where it was, in whatever process. A further thing
that planning needs of a robot belongs here, else the first plan waits for it.
"""

from __future__ import annotations

import functools
import logging
import time
from collections.abc import Callable

import coal

from guidefield.collision.part_tables import recall_mesh_tree
from guidefield.collision.solids import hulls_of
from guidefield.deadline import UNLIMITED, Deadline
from guidefield.geometry.solid import clear_solids
from guidefield.memo import MemoSet
from guidefield.robot.bodies.bounding import COVERS, DELTA, MOST_PARTS, PARTS, ShapeTask, find_in_parallel
from guidefield.robot.bodies.charges import link_bodies, surface_samples
from guidefield.robot.model.model import RobotModel

_log = logging.getLogger(__name__)

Announce = Callable[[str], None]  # receives before each task what is prepared: ``covering link2, shape 3 of 8``

LONG = 1.0  # a preparation that takes longer is worth a line in the log [s]


def is_prepared(robot: RobotModel) -> bool:
    """Return whether `prepare` came to its end for a robot in this process."""
    return robot in _prepared


def prepare(robot: RobotModel, deadline: Deadline = UNLIMITED, told: Announce = lambda _: None) -> None:
    """Compute all that is missing; `told` hears of each task, from one thread at a time.

    Raises DeadlineExpired if time was up; what is found by then is kept.
    """
    if is_prepared(robot):
        return
    began = time.monotonic()

    def progress(task: ShapeTask) -> None:
        deadline.check(task.told)
        told(task.told)

    covers, parts = COVERS.search(robot, DELTA), PARTS.search(robot, MOST_PARTS)
    # the cover and the parts of a mesh one after the other, from the same solid
    unfound = sorted([*covers.tasks, *parts.tasks], key=lambda task: -task.extent)
    find_in_parallel(unfound, progress)
    clear_solids()
    covers.keep()
    parts.keep()
    whole = {"laying out the surfaces of": link_bodies, "spreading points on": surface_samples}
    on_links = [
        ShapeTask(f"{doing} {robot.name}", 0.0, functools.partial(find, robot)) for doing, find in whole.items()
    ]
    # if no cover or part was missing, these are probably on disk, and one thread reads them sooner than kernels load
    find_in_parallel([*_surfaces(robot), *on_links], progress, None if unfound else 1)
    hulls_of(robot)
    _prepared.add(robot)
    if time.monotonic() - began > LONG:
        _log.info("prepared robot %s in %.1f s", robot.name, time.monotonic() - began)


_prepared = MemoSet()


def _surfaces(robot: RobotModel) -> list[ShapeTask]:
    return [
        ShapeTask.of("laying out", robot, index, 0.0, functools.partial(recall_mesh_tree, shape.geometry))
        for index, shape in enumerate(robot.geometry.geometryObjects)
        if isinstance(shape.geometry, coal.BVHModelBase)
    ]
