"""The world: a robot among obstacles as one Pinocchio geometry model, and every pair of bodies that must stay apart."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from guidefield.collision.bodies import Bodies, bodies
from guidefield.collision.broad_phase import broad_phase, scratch_space, thickened
from guidefield.collision.clearance import ClearanceAt, clearance
from guidefield.collision.contact import Contact, contacts
from guidefield.collision.enclosure import enclosed
from guidefield.collision.hulls import with_hulls
from guidefield.collision.motion_bound import MotionBound, motion_bound
from guidefield.errors import UnknownObject
from guidefield.robot.group import PlanningGroup
from guidefield.scene.scene import Scene

PairNames = tuple[str, str]


@dataclass(frozen=True, eq=False)
class World:
    """A planning group among the obstacles of a scene.

    Bodies are the collision shapes of the robot, then the obstacles. Pairs are, first, the robot's own that count and
    can move relative to each other, then every body on a moving link with every obstacle; a body that stands still in
    the world, such as a base on the floor, is not tested against obstacles. Allowed collisions are left out.

    Pinocchio's data are scratch space: a world answers one question at a time, and is not for two threads.

    Attributes:
        group: The robot's planned joints.
        scene: The scene.
        model: The group's Pinocchio model.
        geometry: Pinocchio geometry model of all bodies, with the pairs.
        data: Scratch of `model`.
        hulls: The same with convex hulls in the place of meshes; `geometry` itself where there are none.
        geometry_data: Scratch of `geometry`, for contact itself.
        margin_data, hull_margin_data: Scratch of `geometry` and of `hulls`, for contact within margins.
        broad_phase, hull_broad_phase: What finds close bodies first, for contact, and for hulls within margins.
        bodies: Balls and boxes about the bodies.
        motion_bound: How much closer pairs can come when the robot moves.
        body_names: Link or obstacle by body.
        pairs: Bodies of each pair, shape (n, 2), the lower index first.
        n_self: How many pairs are the robot's own.
        is_obstacle_pair: Shape (n,).
        signed: Whether both bodies of a pair are convex, so that distances are signed, shape (n,).
    """

    group: PlanningGroup
    scene: Scene
    model: Any
    geometry: Any
    hulls: Any
    data: Any
    geometry_data: Any
    margin_data: Any
    hull_margin_data: Any
    broad_phase: Any
    hull_broad_phase: Any
    bodies: Bodies
    motion_bound: MotionBound
    body_names: tuple[str, ...]
    pairs: np.ndarray
    n_self: int
    is_obstacle_pair: np.ndarray
    signed: np.ndarray

    @classmethod
    def build(cls, group: PlanningGroup, scene: Scene, allowed_collisions: Iterable[tuple[str, str]] = ()) -> World:
        """Put a robot among obstacles.

        Args:
            group: The robot's planned joints.
            scene: The scene.
            allowed_collisions: Pairs of names, of links or obstacles, that may touch.

        Raises:
            UnknownObject: if an allowed name is neither a link nor an obstacle; lists those there are.
        """
        allowed = _allowed(group, scene, allowed_collisions)
        geometry = group.geometry.copy()
        names = [group.robot.link_of_geometry(index) for index in range(geometry.ngeoms)]
        own, mixed = _pairs(group, scene, names, allowed)
        for obstacle in scene.obstacles:
            name = f"obstacle/{obstacle.name}"
            geometry.addGeometryObject(pin.GeometryObject(name, 0, obstacle.placement, obstacle.shape))
            names.append(obstacle.name)
        geometry.removeAllCollisionPairs()
        for first, second in own + mixed:
            geometry.addCollisionPair(pin.CollisionPair(first, second))
        for body in geometry.geometryObjects:
            body.geometry = thickened(body.geometry)
        pairs = np.array(own + mixed, int).reshape(-1, 2)
        is_obstacle_pair = np.arange(len(pairs)) >= len(own)
        surfaces = np.array([isinstance(shape.geometry, coal.BVHModelBase) for shape in geometry.geometryObjects], bool)
        signed = ~surfaces[pairs].any(axis=1)
        for array in (pairs, is_obstacle_pair, signed):
            array.setflags(write=False)
        measured = bodies(group, scene.obstacles)
        hulls = with_hulls(geometry, group, scene) if surfaces.any() else geometry
        geometry_data, hull_margin_data = scratch_space(geometry), scratch_space(hulls)
        return cls(
            group=group,
            scene=scene,
            model=group.model,
            geometry=geometry,
            hulls=hulls,
            data=group.model.createData(),
            geometry_data=geometry_data,
            margin_data=scratch_space(geometry),
            hull_margin_data=hull_margin_data,
            broad_phase=broad_phase(group.model, geometry, geometry_data),
            hull_broad_phase=broad_phase(group.model, hulls, hull_margin_data),
            bodies=measured,
            motion_bound=motion_bound(group, measured, pairs, len(own)),
            body_names=tuple(names),
            pairs=pairs,
            n_self=len(own),
            is_obstacle_pair=is_obstacle_pair,
            signed=signed,
        )

    def pair_names(self, pair: int) -> PairNames:
        """Names of a pair's bodies: a link, and a link or an obstacle."""
        first, second = self.pairs[pair]
        return self.body_names[first], self.body_names[second]

    def in_collision(self, q: np.ndarray) -> bool:
        """Whether any pair touches at a configuration (group.nq,)."""
        return bool(pin.computeCollisions(self.model, self.data, self.broad_phase, self.group.expand(q), True))

    def contacts(self, q: np.ndarray) -> list[Contact]:
        """Every pair that touches at a configuration (group.nq,)."""
        return contacts(self, q)

    def clearance(self, q: np.ndarray) -> ClearanceAt:
        """Exact smallest distances at a configuration (group.nq,)."""
        return clearance(self, q)

    def enclosed(self, q: np.ndarray) -> PairNames | None:
        """A pair of which one body lies wholly inside the other, a closed mesh that Coal judges as a surface; or None.

        A motion without contact can't change this: it is asked once, at the start.
        """
        return enclosed(self, q)


def _allowed(group: PlanningGroup, scene: Scene, allowed_collisions: Iterable[tuple[str, str]]) -> set[frozenset[str]]:
    obstacles = [obstacle.name for obstacle in scene.obstacles]
    known = {*group.robot.links, *obstacles}
    allowed = set()
    for index, pair in enumerate(allowed_collisions):
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


def _pairs(
    group: PlanningGroup, scene: Scene, links: list[str], allowed: set[frozenset[str]]
) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Pairs of robot bodies, and pairs of a robot body with an obstacle."""
    joints = [shape.parentJoint for shape in group.geometry.geometryObjects]
    own = [
        (min(pair.first, pair.second), max(pair.first, pair.second))
        for pair in group.geometry.collisionPairs
        if joints[pair.first] != joints[pair.second]
        and frozenset((links[pair.first], links[pair.second])) not in allowed
    ]
    mixed = [
        (body, len(links) + index)
        for body, joint in enumerate(joints)
        for index, obstacle in enumerate(scene.obstacles)
        if joint != 0 and frozenset((links[body], obstacle.name)) not in allowed
    ]
    return own, mixed
