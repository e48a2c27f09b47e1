"""The world: a robot among obstacles as one Pinocchio geometry model, and every pair of bodies that must stay apart."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.collision.bodies import Bodies, bodies, joint_placements
from guidefield.collision.broad_phase import broad_phase, thickened
from guidefield.collision.hulls import with_hulls
from guidefield.collision.motion_bound import MotionBound, motion_bound
from guidefield.errors import SceneInvalid, UnknownObject
from guidefield.robot.group.alike import kept_with_alike
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.model.scratch_space import scratch_space
from guidefield.robot.model.spaces import ModelConfiguration
from guidefield.scene.scene import Scene

PairNames = tuple[str, str]


@dataclass(frozen=True, eq=False)
class World:
    """A planning group among the obstacles of a scene.

    Bodies are the collision shapes of the robot, then the obstacles. Pairs are, first, the robot's own that count and
    can move relative to each other, then every body on a moving link with every obstacle; a body that stands still in
    the world, such as a base on the floor, is not tested against obstacles. Allowed collisions are left out.

    Pinocchio's data are scratch space: a world answers one question at a time, and is not for two threads. What lanes
    don't need is made when it is asked for. Whoever asks it gives a configuration of the group's model, as Pinocchio
    takes it: `PlanningGroup.expand` and `expand_from_chart` lead there.

    Attributes:
        group: The robot's planned joints.
        scene: The scene.
        body_names: Link or obstacle by body.
        pairs: Bodies of each pair, shape (n, 2), the lower index first.
        n_self: How many pairs are the robot's own.
    """

    group: PlanningGroup
    scene: Scene
    body_names: tuple[str, ...]
    pairs: np.ndarray
    n_self: int

    @classmethod
    def build(cls, group: PlanningGroup, scene: Scene, allowed_collisions: Iterable[tuple[str, str]] = ()) -> World:
        """Put a robot among obstacles.

        Args:
            group: The robot's planned joints.
            scene: The scene.
            allowed_collisions: Pairs of names, of links or obstacles, that may touch.

        Raises:
            SceneInvalid: if an obstacle has the name of a link, or of what the robot holds: pairs go by names.
            UnknownObject: if an allowed name is neither a link nor an obstacle; lists those there are.
        """
        _require_other_names(group, scene)
        names, (pairs, n_self) = _link_names(group), _pairs(group, len(scene.obstacles))
        bodies = (*names, *[obstacle.name for obstacle in scene.obstacles])
        allowed = _allowed(group, scene, allowed_collisions)
        if allowed:
            own, mixed = (_without(some, bodies, allowed) for some in (pairs[:n_self], pairs[n_self:]))
            pairs, n_self = _frozen(np.concatenate([own, mixed])), len(own)
        return cls(group, scene, bodies, pairs, n_self)

    @property
    def model(self) -> Any:
        """The group's Pinocchio model."""
        return self.group.model

    @cached_property
    def is_obstacle_pair(self) -> np.ndarray:
        """Which pairs are of a robot's body and an obstacle, shape (n,)."""
        return _frozen(np.arange(len(self.pairs)) >= self.n_self)

    @cached_property
    def geometry(self) -> Any:
        """Pinocchio geometry model of all bodies, with the pairs."""
        geometry = self.group.geometry.copy()
        for obstacle in self.scene.obstacles:
            name = f"obstacle/{obstacle.name}"
            geometry.addGeometryObject(pin.GeometryObject(name, 0, obstacle.placement, obstacle.shape))
        geometry.removeAllCollisionPairs()
        for first, second in self.pairs.tolist():
            geometry.addCollisionPair(pin.CollisionPair(first, second))
        for body in geometry.geometryObjects:
            body.geometry = thickened(body.geometry)
        return geometry

    @cached_property
    def _are_surfaces(self) -> np.ndarray:
        """Which bodies Coal judges as surfaces."""
        return np.array([isinstance(body.geometry, coal.BVHModelBase) for body in self.geometry.geometryObjects], bool)

    @cached_property
    def signed(self) -> np.ndarray:
        """Whether both bodies of a pair are convex, so that distances are signed, shape (n,)."""
        return _frozen(~self._are_surfaces[self.pairs].any(axis=1))

    @cached_property
    def hulled(self) -> np.ndarray:
        """Whether in `hulls` a hull stands for a body of a pair, shape (n,)."""
        of_hulls = np.array([isinstance(body.geometry, coal.Convex) for body in self.hulls.geometryObjects], bool)
        return _frozen((self._are_surfaces & of_hulls)[self.pairs].any(axis=1))

    @cached_property
    def roundings(self) -> np.ndarray:
        """What the bodies of a pair are rounded by together, beyond their Coal shapes, shape (n,) [m]."""
        robot = np.zeros(self.group.geometry.ngeoms)
        radii = np.concatenate([robot, [obstacle.rounding for obstacle in self.scene.obstacles]])
        return _frozen(radii[self.pairs].sum(axis=1))

    @cached_property
    def hulls(self) -> Any:
        """The same model with the hull of each mesh that has a volume in its place."""
        return with_hulls(self.geometry, self.group, self.scene) if self._are_surfaces.any() else self.geometry

    @cached_property
    def data(self) -> Any:
        """Scratch of `model`."""
        return self.group.model.createData()

    @cached_property
    def joint_placements(self) -> np.ndarray:
        """Placements of the joints in `data`, shape (njoints, 3, 4) [m]: where they stand now, so copy what is kept."""
        return joint_placements(self.data)

    @cached_property
    def geometry_data(self) -> Any:
        """Scratch of `geometry`, for contact itself."""
        scratch = scratch_space(self.geometry)
        if self.roundings.any():
            self.set_margins(self.geometry, scratch, 0.0)
        return scratch

    @cached_property
    def margin_data(self) -> Any:
        """Scratch of `geometry`, for contact within margins."""
        return scratch_space(self.geometry)

    @cached_property
    def hull_margin_data(self) -> Any:
        """Scratch of `hulls`, for contact within margins."""
        return scratch_space(self.hulls)

    @cached_property
    def broad_phase(self) -> Any:
        """What finds bodies that touch."""
        return broad_phase(self.model, self.geometry, self.geometry_data)

    @cached_property
    def bodies(self) -> Bodies:
        """Balls and boxes about the bodies."""
        return bodies(self.group, self.scene.obstacles)

    @cached_property
    def motion_bound(self) -> MotionBound:
        """How much closer pairs can come when the robot moves."""
        return motion_bound(self.group, self.bodies, self.pairs, self.n_self)

    def set_margins(self, geometry: Any, scratch: Any, margins: np.ndarray | float) -> None:
        """Let pairs that come within margins of each other count as touching.

        Args:
            geometry: `geometry` or `hulls`.
            scratch: Its scratch space.
            margins: Of each pair, shape (n,), or of all [m].
        """
        self._margins[self.pairs[:, 0], self.pairs[:, 1]] = margins + self.roundings
        scratch.setSecurityMargins(geometry, self._margins, True, True)

    @cached_property
    def _margins(self) -> np.ndarray:
        """By two bodies."""
        return np.zeros((self.geometry.ngeoms, self.geometry.ngeoms))

    def distance(self, pair: int) -> tuple[float, Any]:
        """Distance of a pair [m] where `geometry_data` stands, signed or 0 in contact, and what Coal says of it.

        Of a rounded body Coal sees the inside only.
        """
        result = pin.computeDistance(self.geometry, self.geometry_data, pair)
        distance = float(result.min_distance) - float(self.roundings[pair])
        return (distance if self.signed[pair] else max(0.0, distance)), result

    def pair_names(self, pair: int) -> PairNames:
        """Names of a pair's bodies: a link, and a link or an obstacle."""
        first, second = self.pairs[pair]
        return self.body_names[first], self.body_names[second]

    def in_collision(self, q: ModelConfiguration) -> bool:
        """Whether any pair touches at a configuration of the model, shape (model.nq,)."""
        return bool(pin.computeCollisions(self.model, self.data, self.broad_phase, q, True))


def _require_other_names(group: PlanningGroup, scene: Scene) -> None:
    """Refuse an obstacle that is named as a link: in pairs, given or told, nobody could say which is meant."""
    links = set(group.robot.links)
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.name in links:
            raise SceneInvalid(
                f"obstacle {obstacle.name!r} has the name of a link of robot {group.robot.name!r}: give it another",
                obstacle=obstacle.name,
                link=obstacle.name,
                path=f"$.obstacles[{index}].name",
            )


def _allowed(group: PlanningGroup, scene: Scene, allowed_collisions: Iterable[tuple[str, str]]) -> set[frozenset[str]]:
    pairs = list(allowed_collisions)
    allowed: set[frozenset[str]] = set()
    if not pairs:
        return allowed
    obstacles = [obstacle.name for obstacle in scene.obstacles]
    known = {*group.robot.links, *obstacles}
    for index, pair in enumerate(pairs):
        for name in pair:
            if name not in known:
                raise UnknownObject(
                    f"`allowed_collisions[{index}]` names {name!r}, which is neither a link nor an obstacle;"
                    f" links: {', '.join(group.robot.links)}; obstacles: {', '.join(obstacles) or 'none'}",
                    object=name,
                    links=list(group.robot.links),
                    obstacles=obstacles,
                )
        allowed.add(frozenset(pair))
    return allowed


@kept_with_alike
def _link_names(group: PlanningGroup) -> tuple[str, ...]:
    """The link of each of the robot's bodies."""
    return tuple(group.robot.link_of_geometry(index) for index in range(group.geometry.ngeoms))


@kept_with_alike
def _pairs(group: PlanningGroup, obstacles: int) -> tuple[np.ndarray, int]:
    """All pairs among so many obstacles, shape (n, 2), the lower index first; how many are the robot's own.

    Those are the pairs that count and move relative to each other; the others are of a body that moves.
    """
    joints = [shape.parentJoint for shape in group.geometry.geometryObjects]
    own = [
        (min(pair.first, pair.second), max(pair.first, pair.second))
        for pair in group.geometry.collisionPairs
        if joints[pair.first] != joints[pair.second]
    ]
    moving = np.flatnonzero(joints)
    first = np.repeat(moving, obstacles)
    mixed = np.column_stack([first, len(joints) + np.tile(np.arange(obstacles), len(moving))])
    return _frozen(np.concatenate([np.array(own, int).reshape(-1, 2), mixed])), len(own)


def _without(pairs: np.ndarray, names: tuple[str, ...], allowed: set[frozenset[str]]) -> np.ndarray:
    """Pairs of bodies but those whose names are allowed to touch."""
    kept = [frozenset((names[first], names[second])) not in allowed for first, second in pairs.tolist()]
    left: np.ndarray = pairs[np.array(kept, bool)]
    return left


def _frozen(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array
