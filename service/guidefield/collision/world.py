"""The world: a robot among obstacles, the pairs of bodies that must stay apart, and exact tests of these pairs.

Everything that decides on contact asks a `World`. Bodies and pairs go by their indices (`pairs.py`), in proofs and in
kernels too. The numbers of pairs are large: no list of them is made. `TOUCHING` must not be less, and is time
otherwise; `FIRST_PAIRS`, at least 1 (with 0 nothing touches), is memory and time.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.collision.bodies import Bodies, MotionBound, bodies, body_placements, joint_placements, motion_bound
from guidefield.collision.narrow_phase import ClosestPoints, CoalTransforms, NarrowPhase
from guidefield.collision.obstacle_boxes import ObstacleBoxes, obstacle_boxes
from guidefield.collision.pairs import Allowed, HeldContact, PairNames, Pairs, find_allowed, held_contacts
from guidefield.collision.solids import link_hulls, obstacle_hull
from guidefield.errors import SceneInvalid
from guidefield.kernels.collide.near_pairs import find_near_pairs
from guidefield.robot.group.group import PlanningGroup, memoized_for_alike
from guidefield.robot.group.kinematics import lent_data
from guidefield.robot.model.joints import ModelConfiguration
from guidefield.scene.scene import Scene

TOUCHING = 1e-6  # pairs whose balls and boxes are farther apart than this aren't tested further [m]
FIRST_PAIRS = 256  # near pairs that memory is first made for; where there are more, they are found again


@dataclass(frozen=True, eq=False)
class World:
    """A planning group among the obstacles of a scene.

    Bodies are the collision shapes of the robot, then the obstacles. Pairs are, first, the robot's own that count and
    can move relative to each other, then every body on a moving link with every obstacle; a body that stands still in
    the world, such as a base on the floor, is not tested against obstacles. Allowed collisions are left out; what a
    held object touches wherever the planned joints are is in `held_contacts`.

    A world's scratch space answers one question at a time, and is not for two threads. What SIMD batches don't need is
    made on demand. Configurations are those of the group's model: `PlanningGroup.expand` leads there.
    """

    group: PlanningGroup
    scene: Scene
    pairs: Pairs
    held_contacts: tuple[HeldContact, ...] = ()

    @classmethod
    def build(cls, group: PlanningGroup, scene: Scene, allowed_collisions: Iterable[tuple[str, str]] = ()) -> World:
        """Put a robot among obstacles; `allowed_collisions` are pairs of names of links or obstacles that may touch.

        Raises:
            RobotInvalid: if the robot has no collision geometry.
            SceneInvalid: if an obstacle has the name of a link, or of what the robot holds: pairs go by names.
            UnknownObject: if an allowed name is neither a link nor an obstacle; lists those there are.
        """
        group.robot.require_collision_geometry()
        _require_other_names(group, scene)
        allowed = find_allowed(group, scene, allowed_collisions)
        links = set() if allowed is None else allowed.links
        held = tuple(one for one in held_contacts(group) if one.pair not in links)
        return cls(group, scene, _pairs(group, scene, allowed), held)

    def among(self, obstacles: np.ndarray) -> World:
        """Return the robot among some of the obstacles, ascending indices of shape (k,), with the pairs left."""
        return World(self.group, self.scene.of(obstacles.tolist()), self.pairs.among(obstacles), self.held_contacts)

    @property
    def model(self) -> Any:
        """The group's Pinocchio model."""
        return self.group.model

    @cached_property
    def body_names(self) -> tuple[str, ...]:
        """Link or obstacle by body."""
        return (*self._links, *(one.name for one in self.scene.obstacles))

    def pair_names(self, pair: int) -> PairNames:
        """Names of a pair's bodies: a link, and a link or an obstacle."""
        first, second = self.pairs.of(pair)
        names = self._links
        return names[first], names[second] if second < self.pairs.links else self._obstacle(second).name

    @cached_property
    def _links(self) -> tuple[str, ...]:
        return _link_names(self.group)

    def rounding(self, body: int) -> float:
        """Return the radius by which a body is larger than its Coal shape all around [m]."""
        return 0.0 if body < self.pairs.links else self._obstacle(body).rounding

    def is_surface(self, body: int) -> bool:
        """Return whether Coal judges a body as a surface, which has no inside."""
        return self._surfaces[body] if body < self.pairs.links else not self._obstacle(body).convex

    @cached_property
    def _surfaces(self) -> tuple[bool, ...]:
        return _surfaces(self.group)

    def is_signed(self, pair: int) -> bool:
        """Return whether both bodies of a pair are convex, so that distances are signed."""
        return not any(map(self.is_surface, self.pairs.of(pair)))

    def is_hulled(self, pair: int) -> bool:
        """Return whether a body of a pair is a mesh that `hulls` replaces by its hull."""
        return any(map(self._has_hull, self.pairs.of(pair)))

    def _has_hull(self, body: int) -> bool:
        if body not in self._hulled:
            self._hulled[body] = self._hull(body) is not None
        return self._hulled[body]

    @cached_property
    def _hulled(self) -> dict[int, bool]:
        return {}

    @cached_property
    def boxes(self) -> ObstacleBoxes:
        """Boxes about the obstacles."""
        return obstacle_boxes(self.scene)

    @cached_property
    def bodies(self) -> Bodies:
        """Balls about the robot's bodies."""
        return bodies(self.group)

    @cached_property
    def motion_bound(self) -> MotionBound:
        """The bounds on how much closer bodies can come when the robot moves."""
        return motion_bound(self.group, self.pairs.own.tobytes())

    @cached_property
    def data(self) -> Any:
        """Scratch of `model`."""
        return lent_data(self.group, self)

    @cached_property
    def joint_placements(self) -> np.ndarray:
        """Placements of the joints in `data`, shape (njoints, 3, 4) [m]: where they stand now; copy what you keep."""
        return joint_placements(self.data)

    @cached_property
    def body_placements(self) -> np.ndarray:
        """Placements of the robot's bodies, shape (r, 3, 4) [m]: where they stand now; copy what you keep."""
        return body_placements(self._robot)

    @cached_property
    def _transforms(self) -> CoalTransforms:
        world: World = weakref.proxy(self)  # so that a world goes with its last user
        return CoalTransforms(self.body_placements, partial(World.placement, world))

    @cached_property
    def exact(self) -> NarrowPhase:
        """Coal's distances of the bodies' exact shapes, where the last `place` put them."""
        world: World = weakref.proxy(self)
        return NarrowPhase(partial(World._shape, world), self._transforms.of)

    @cached_property
    def hulls(self) -> NarrowPhase:
        """The same with the hull in place of each mesh that has one."""
        world: World = weakref.proxy(self)

        def shape(body: int) -> Any:
            return world._hull(body) or world.exact.shape(body)

        return NarrowPhase(shape, self._transforms.of)

    def place(self, q: ModelConfiguration) -> None:
        """Put the robot at a configuration of the model, shape (model.nq,)."""
        pin.forwardKinematics(self.model, self.data, q)
        self.place_bodies()

    def place_bodies(self) -> None:
        """Put the robot's bodies where the joints in `data` stand."""
        pin.updateGeometryPlacements(self.model, self.data, self.group.geometry, self._robot)
        self._transforms.forget()

    def put_bodies(self, placements: np.ndarray) -> None:
        """Put the robot's bodies where an earlier copy of `body_placements`, shape (r, 3, 4) [m], has them."""
        self.body_placements[:] = placements
        self._transforms.forget()

    def move(self, obstacle: int, placement: Any) -> None:
        """Put the body of an obstacle elsewhere, at a pinocchio.SE3, until the robot is placed anew."""
        self._transforms.move(obstacle, placement)

    def placement(self, body: int) -> Any:
        """Where a body stands, a pinocchio.SE3."""
        return self._robot.oMg[body] if body < self.pairs.links else self._obstacle(body).placement

    def distance(self, pair: int, at_most: float = math.inf) -> tuple[float, ClosestPoints]:
        """Return the distance of a pair [m] where the robot stands, signed or 0 in contact, and Coal's closest points.

        Of bodies that are farther apart than `at_most` [m] at least that is returned, and no points.

        Coal measures a rounded body without its rounding, and so are the points. A body wholly inside a mesh has the
        distance from its surface: see `clearance.find_enclosed_pair`.
        """
        first, second = self.pairs.of(pair)
        rounding = self.rounding(first) + self.rounding(second)
        result = self.exact.distance(first, second, at_most + rounding)
        distance = result.distance - rounding
        return (distance if self.is_signed(pair) else max(0.0, distance)), result

    def hull_distance(self, pair: int) -> float:
        """Return the distance of a pair by `hulls` [m], where the robot stands: at most that of the pair itself."""
        first, second = self.pairs.of(pair)
        apart = self.hulls.distance(first, second).distance
        return apart - (self.rounding(first) + self.rounding(second))

    def penetration(self, pair: int, margin: float = 0.0, *, by_hulls: bool = False) -> float | None:
        """Return how far the bodies of a pair are apart where the robot stands [m]; None if they keep a margin [m].

        See `NarrowPhase.penetration`.
        """
        return self.penetration_of(*self.pairs.of(pair), margin, by_hulls=by_hulls)

    def penetration_of(self, first: int, second: int, margin: float, *, by_hulls: bool = False) -> float | None:
        """Return `penetration` of a pair given by its bodies, one of the robot's first."""
        rounding = self.rounding(second)
        apart = (self.hulls if by_hulls else self.exact).penetration(first, second, margin + rounding)
        return None if apart is None else apart - rounding

    def touches(self, pair: int) -> bool:
        """Return whether the bodies of a pair touch where the robot stands; hulls are tested first."""
        first, second = self.pairs.of(pair)
        hulled = self._has_hull(first) or self._has_hull(second)
        if hulled and self.penetration_of(first, second, 0.0, by_hulls=True) is None:
            return False
        return self.penetration_of(first, second, 0.0) is not None

    def near(self, q: ModelConfiguration) -> list[int]:
        """Place the robot at a configuration of the model, shape (model.nq,); return the pairs that may touch there."""
        self.place(q)
        return self._near_where(self.joint_placements.copy(order="C")[None], None)[0]

    def near_each(self, qs: Sequence[ModelConfiguration], of: np.ndarray | None = None) -> list[list[int]]:
        """Return the pairs that may touch at each of some configurations of the model; the robot is left anywhere.

        With a mask `of` (r,) of the robot's bodies pairs without any of them are left out, but for those with obstacles
        if one of these is a surface.
        """
        placements = np.empty((len(qs), self.model.njoints, 3, 4))
        for row, q in enumerate(qs):
            pin.forwardKinematics(self.model, self.data, q)
            placements[row] = self.joint_placements
        return self._near_where(placements, of)

    def _near_where(self, placements: np.ndarray, of: np.ndarray | None) -> list[list[int]]:
        """Return the pairs that may touch with joints placed by (s, njoints, 3, 4) [m]; `of` is as in `near_each`."""
        own, moving = np.arange(self.pairs.n_self), np.arange(len(self.pairs.moving))
        if of is not None:
            own = own[of[self.pairs.own].any(axis=1)]
            moving = moving[of[self.pairs.moving]] if self.scene.convex else moving
        tables = self.bodies.balls, self.boxes.tables, self.pairs.table
        given = *tables, placements.reshape(*placements.shape[:2], 12), TOUCHING, own, moving
        count, found = FIRST_PAIRS, np.empty((0, 2), np.int64)
        while count > len(found):
            found = np.empty((count, 2), np.int64)
            count = find_near_pairs(*given, found)
        near: list[list[int]] = [[] for _ in placements]
        for at, pair in sorted(found[:count].tolist()):
            near[at].append(pair)
        return near

    def in_collision_each(
        self, qs: Sequence[ModelConfiguration], near: Sequence[list[int]] | None = None
    ) -> list[bool]:
        """Return whether any pair touches, at each of some configurations of the model.

        `near` is what `near_each` returned. The pair that touched at the one before is tested first.
        """
        if self.held_contacts:
            return [True] * len(qs)
        found, last = [], -1
        for q, pairs in zip(qs, self.near_each(qs) if near is None else near, strict=True):
            self.place(q)
            touching = next(filter(self.touches, [last, *pairs] if last in pairs else pairs), None)
            found.append(touching is not None)
            last = last if touching is None else touching
        return found

    def in_collision(self, q: ModelConfiguration) -> bool:
        """Return whether any pair touches at a configuration of the model, shape (model.nq,)."""
        return bool(self.held_contacts) or any(map(self.touches, self.near(q)))

    @cached_property
    def _robot(self) -> Any:
        return _remove_pairs(self.group).createData()

    def _obstacle(self, body: int) -> Any:
        return self.scene.obstacles[body - self.pairs.links]

    def _shape(self, body: int) -> Any:
        """A body's Coal shape; of very many triangles, their patches."""
        if body < self.pairs.links:
            return _link_shapes(self.group).each[body]
        obstacle = self._obstacle(body)
        patches = None if obstacle.facets is None else obstacle.facets.patches
        return obstacle.shape if patches is None else patches

    def _hull(self, body: int) -> Any | None:
        if not self.is_surface(body):
            return None
        return link_hulls(self.group)[body] if body < self.pairs.links else obstacle_hull(self._obstacle(body))


def _require_other_names(group: PlanningGroup, scene: Scene) -> None:
    """Refuse an obstacle with the name of a link: pairs of names would be ambiguous."""
    links = set(group.robot.links)
    if links.isdisjoint(scene.names):
        return
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.name in links:
            raise SceneInvalid(
                f"obstacle {obstacle.name!r} has the name of a link of robot {group.robot.name!r}: give it another",
                obstacle=obstacle.name,
                link=obstacle.name,
                path=f"$.scene.obstacles[{index}].name",
            )


@dataclass(frozen=True, slots=True)
class _LinkShapes:
    """Shapes of a robot's bodies: each as one object of Python, with which is kept what is known of it.

    Their memory is the robot's, so it isn't that of a memoized result: what has slots counts for nothing there.
    """

    each: tuple[Any, ...]


@memoized_for_alike
def _link_shapes(group: PlanningGroup) -> _LinkShapes:
    return _LinkShapes(tuple(one.geometry for one in group.geometry.geometryObjects))


@memoized_for_alike
def _link_names(group: PlanningGroup) -> tuple[str, ...]:
    return tuple(group.robot.link_of_geometry(index) for index in range(group.geometry.ngeoms))


@memoized_for_alike
def _remove_pairs(group: PlanningGroup) -> Any:
    """Return the robot's bodies without pairs: Pinocchio keeps scratch for each pair, milliseconds for hundreds."""
    bodies = group.geometry.copy()
    bodies.removeAllCollisionPairs()
    return bodies


@memoized_for_alike
def _surfaces(group: PlanningGroup) -> tuple[bool, ...]:
    return tuple(isinstance(shape, coal.BVHModelBase) for shape in _link_shapes(group).each)


def _pairs(group: PlanningGroup, scene: Scene, allowed: Allowed | None) -> Pairs:
    """Return the pairs of a group's bodies, and of moving bodies with obstacles, without those allowed to touch."""
    (own, moving), count = _own_pairs(group), len(scene.obstacles)
    if allowed is None:
        return Pairs(own, group.geometry.ngeoms, moving, count, np.empty(0, np.int64))
    names = _link_names(group)
    kept = [(names[first], names[second]) not in allowed.links for first, second in own.tolist()]
    left_out = [
        row * count + np.array(allowed.obstacles[names[body]], np.int64)
        for row, body in enumerate(moving.tolist())
        if names[body] in allowed.obstacles
    ]
    none = np.empty(0, np.int64)
    return Pairs(
        own[np.array(kept, bool)], group.geometry.ngeoms, moving, count, np.unique(np.concatenate([none, *left_out]))
    )


@memoized_for_alike
def _own_pairs(group: PlanningGroup) -> tuple[np.ndarray, np.ndarray]:
    joints = [shape.parentJoint for shape in group.geometry.geometryObjects]
    own = [
        (min(pair.first, pair.second), max(pair.first, pair.second))
        for pair in group.geometry.collisionPairs
        if joints[pair.first] != joints[pair.second]
    ]
    found = np.array(own, np.int64).reshape(-1, 2), np.flatnonzero(joints)
    for array in found:
        array.setflags(write=False)
    return found
