"""What a robot needs before its first connection, found once: balls, convex parts, trees of meshes, points on links.

It takes some seconds for an arm whose links are meshes, tens of seconds for a humanoid. What one call found, another
needn't find again, in whatever process: a preparation that was stopped goes on where it was.
"""

from __future__ import annotations

import logging
import time
import weakref
from collections.abc import Callable
from typing import Any

import coal

from guidefield.aside import Spent, StoppedError
from guidefield.collision.convex_parts import known_pieces, known_surface
from guidefield.robot.bodies.convex_parts import convex_parts
from guidefield.robot.bodies.link_bodies import link_bodies
from guidefield.robot.bodies.sphere_cover import coverage
from guidefield.robot.bodies.surface_samples import surface_samples
from guidefield.robot.model.model import RobotModel

_log = logging.getLogger(__name__)

Told = Callable[[str], None]
"""Told before each piece of work what is prepared: such as ``covering link2, shape 3 of 8``."""

LONG = 1.0
"""A preparation that takes longer is worth a line in the log [s]."""


def is_prepared(robot: RobotModel) -> bool:
    """Whether `prepare` came to its end for a robot in this process."""
    return robot in _prepared


def prepare(robot: RobotModel, spent: Spent = lambda: None, told: Told = lambda _: None) -> None:
    """Find all that is missing.

    Args:
        robot: The robot.
        spent: Whether time is up, asked before each piece of work; what is found by then is kept.
        told: Told what is being prepared.

    Raises:
        StoppedError: if time was up.
    """
    if is_prepared(robot):
        return
    began = time.monotonic()

    def step(doing: str) -> Callable[[int, int, str], None]:
        def before(done: int, of: int, link: str) -> None:
            what = f"{doing} {link}, shape {done + 1} of {of}"
            if spent():
                raise StoppedError(what)
            told(what)

        return before

    coverage(robot, progress=step("covering"))
    cut = convex_parts(robot, step("cutting"))
    shapes = list(robot.geometry.geometryObjects)
    before = step("sorting the triangles of")
    for index, (shape, parts) in enumerate(zip(shapes, cut, strict=True)):
        if parts is not None:
            before(index, len(shapes), _link(robot, shape))
            known_pieces(shape.geometry, parts)
    before = step("laying out")
    for index, shape in enumerate(shapes):
        if isinstance(shape.geometry, coal.BVHModelBase):
            before(index, len(shapes), _link(robot, shape))
            known_surface(shape.geometry)
    for lay_out in (link_bodies, surface_samples):
        if spent():
            raise StoppedError("its links were laid out")
        lay_out(robot)
    _prepared.add(robot)
    if time.monotonic() - began > LONG:
        _log.info("prepared robot %s in %.1f s", robot.name, time.monotonic() - began)


_prepared: weakref.WeakSet[RobotModel] = weakref.WeakSet()


def _link(robot: RobotModel, shape: Any) -> str:
    return str(robot.model.frames[shape.parentFrame].name)
