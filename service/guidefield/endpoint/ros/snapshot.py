"""Robot and scene as ROS nodes described them at one moment; a value that is replaced, never changed."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec
import pinocchio as pin

from guidefield.endpoint.ros.allowed_collisions import NOBODY, Matrix
from guidefield.endpoint.ros.collision_objects import SceneObject
from guidefield.endpoint.ros.known_robot import KnownRobot
from guidefield.endpoint.ros.poses import wire_of
from guidefield.endpoint.ros.refusals import FrameRefused, ObjectRefused
from guidefield.messages.conditions import AttachedObject
from guidefield.messages.scene import HalfSpace, Scene
from guidefield.messages.values import Placement

SCENE = "planning_scene"
"""The name of the scene in requests; the whole scene goes with each."""


@dataclass(frozen=True)
class Held:
    """An object that a link holds: its pose is in the link's frame."""

    link: str
    thing: SceneObject
    touch_links: tuple[str, ...] = ()


@dataclass(frozen=True)
class Snapshot:
    """Robot and scene at one moment.

    Attributes:
        robot: Which robot.
        positions: Values that were heard, by joint [rad or m].
        objects: What stands in the scene, by id.
        held: What links hold, by id.
        matrix: Who may touch whom.
        colors: Of objects, as they came.
        name: Of the scene.
    """

    robot: KnownRobot
    positions: Mapping[str, float] = field(default_factory=dict)
    objects: Mapping[str, SceneObject] = field(default_factory=dict)
    held: Mapping[str, Held] = field(default_factory=dict)
    matrix: Matrix = NOBODY
    colors: Mapping[str, Any] = field(default_factory=dict)
    name: str = ""
    _places: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)

    @property
    def whole(self) -> dict[str, float]:
        """A value for each joint: those that were never heard are at rest."""
        return {**self.robot.rest, **self.positions}

    @property
    def unheard(self) -> list[str]:
        """Joints whose values nobody told."""
        return [joint for joint in self.robot.joints if joint not in self.positions]

    def link(self, name: str) -> Any:
        """Where a link is in the world, pinocchio.SE3."""
        if name not in self._places:
            (self._places[name],) = self.robot.placements(self.whole, [name])
        return self._places[name]

    def frame(self, name: str, field: str) -> tuple[Any, str | None]:
        """Where a frame is in the world, and the link with which it moves.

        Raises:
            Refused: if nothing is called so.
        """
        if self.robot.is_root(name):
            return pin.SE3.Identity(), None
        if name in self.robot.links:
            return self.link(name), name
        thing, _, own = name.partition("/") if name not in self.objects and name not in self.held else (name, "", "")
        found = self.held[thing].thing if thing in self.held else self.objects.get(thing)
        if found is None or (own and own not in found.frames):
            raise FrameRefused(
                f"`{field}` {name[:64]!r} is unknown: it is neither {self.robot.root!r}, a link of {self.robot.name},"
                " an object nor a named frame of one"
            )
        inside = found.pose * found.frames[own] if own else found.pose
        if thing in self.held:
            return self.link(self.held[thing].link) * inside, self.held[thing].link
        return inside, None

    def scene(self) -> Scene:
        """The objects as our requests have them; raises Refused if two shapes have the same name."""
        try:
            return Scene(SCENE, obstacles=[o for name, thing in self.objects.items() for o in thing.obstacles(name)])
        except ValueError as error:
            raise ObjectRefused(f"the planning scene: {error}") from None

    def attached(self) -> list[AttachedObject]:
        """What links hold, as our requests have it; raises Refused if a plane is to be held."""
        return [one for name, held in self.held.items() for one in _attached(name, held)]

    def allowed(self) -> list[tuple[str, str]]:
        """Pairs that may touch, by names of links and obstacles."""
        shapes = {name: thing.names(name) for name, thing in self.objects.items()}
        shapes |= {name: held.thing.names(name) for name, held in self.held.items()}
        names = {link: [link] for link in self.robot.links} | shapes
        return [(a, b) for first, second in self.matrix.allowed(names) for a in names[first] for b in names[second]]


def _attached(name: str, held: Held) -> Iterator[AttachedObject]:
    for (shape, there), own in zip(held.thing.shapes, held.thing.names(name), strict=True):
        if isinstance(shape, HalfSpace):
            raise ObjectRefused(f"object {name!r} has a plane: no link can hold it")
        position, quaternion = wire_of(held.thing.pose * there)
        yield AttachedObject(
            obstacle=msgspec.structs.replace(shape, name=own),
            link=held.link,
            placement=Placement(position, quaternion),
            touch_links=list(held.touch_links),
        )


class KnownScene:
    """The snapshot of now: any thread reads it, and one after the other replaces it."""

    def __init__(self, first: Snapshot) -> None:
        self._now = first
        self._changing = threading.Lock()

    @property
    def now(self) -> Snapshot:
        """The snapshot of now."""
        return self._now

    def update(self, change: Callable[[Snapshot], Snapshot]) -> None:
        """Replace it by what it becomes; where that raises, it stays."""
        with self._changing:
            self._now = change(self._now)
