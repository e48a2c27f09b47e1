"""Read the request that opens a stream: robot, scene at rest, limits; what streams don't serve is refused here.

The judge takes world, limits and assumptions from the `StreamSetup` as it is made here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np

from guidefield.collision.clearance import contacts_at
from guidefield.collision.world import World
from guidefield.errors import InvalidConfiguration, MalformedRequest, UnknownObject
from guidefield.geometry.surfaces import se3
from guidefield.handlers.attached import holding
from guidefield.handlers.requested_group import bounds_efforts, cartesian_limits_of, jerk_limits, limit_group, start_of
from guidefield.messages.streams import Deviation, StreamOpen
from guidefield.planner.task.motion_limits import CartesianLimit
from guidefield.robot.group.group import PlanningGroup
from guidefield.robot.group.reduced_model import select
from guidefield.robot.model.configuration import limit_faults
from guidefield.robot.model.joints import LocalPoint, ModelConfiguration
from guidefield.robot.model.model import RobotModel
from guidefield.scene.scene import Scene
from guidefield.stream.commit import JointBounds
from guidefield.stream.obstacles import Assumption
from guidefield.stream.settings import RISE


@dataclass(frozen=True, eq=False)
class StreamSetup:
    """A stream's robot, limits and conditions."""

    request: StreamOpen
    group: PlanningGroup
    world: World
    bounds: JointBounds
    cartesian_limits: tuple[CartesianLimit, ...]
    start: LocalPoint  # the configuration in which it stands, shape (nv,)
    assumption: Assumption
    warnings: tuple[str, ...]
    touching: tuple[str, ...]  # a sentence for each pair in contact at the start, among the warnings too

    def bodies_met(self, name: str) -> np.ndarray:
        """Return whether each moving body must not touch an obstacle of a name, shape (m,)."""
        names, allowed = self.world.body_names, [frozenset(pair) for pair in self.request.allowed_collisions]
        moving = self.world.pairs.moving.tolist()
        return np.array([frozenset((names[body], name)) not in allowed for body in moving], bool)


def read_opening(request: StreamOpen, robot: RobotModel, scene: Scene, coarse: Sequence[str] = ()) -> StreamSetup:
    """Read a request.

    Args:
        coarse: Warnings about its coordinates, if they are far from the origin.

    Raises:
        GuidefieldError: if it is ill-posed, or asks for what isn't served; by name.
    """
    if scene.moves:
        name = next(one.name for one in scene.obstacles if one.motion is not None)
        raise MalformedRequest(
            f"`scene`: obstacle {name!r} has a `trajectory`, which a stream isn't served with: declare it in"
            " `obstacles` and send observations",
            unserved="scene.trajectory",
            path="$.scene",
        )
    robot.require_collision_geometry()
    robot = holding(robot, request.attached_objects, scene)
    q_whole, warnings = start_of(request.start, robot)
    root = request.robot_placement
    group = select(robot, request.group, request.tip, q_whole, se3(root.position, root.quaternion_xyzw))
    if bounds_efforts(request):
        raise MalformedRequest("streams don't serve limits of effort: leave `effort` out of `limits`", path="$.limits")
    for index, limit in enumerate(request.cartesian_limits):
        if limit.acceleration is not None:
            raise MalformedRequest(
                "streams don't serve limits of acceleration in space: they brake as hard as joints may. Leave"
                " `acceleration` out, or give joints lower ones in `limits`",
                unserved="acceleration",
                path=f"$.cartesian_limits[{index}].acceleration",
            )
    group = limit_group(group, request)
    turned = group.starting_at(request.start).whole_turns
    turns = np.zeros(group.nv) if turned is None else turned
    _require_one_axis(group)
    q_start = group.part_of(q_whole)
    for fault in limit_faults(group.joints, q_start):
        raise InvalidConfiguration(
            f"`start`: {fault.joint} is at {fault.value:.6g}, its limits are {fault.lower:.6g} and {fault.upper:.6g}",
            joint=fault.joint,
            value=fault.value,
            path=f"$.start.{fault.joint}",
        )
    names = {one.obstacle.name for one in request.obstacles}
    _require_known(request, group.robot, scene, names)
    allowed = [pair for pair in request.allowed_collisions if names.isdisjoint(pair)]
    jerks = jerk_limits(group, request)
    own = group.acceleration_limits / RISE
    jerks = own if jerks is None else np.where(np.isfinite(jerks), jerks, own)
    bounds = JointBounds(
        group.lower.copy(),
        group.upper.copy(),
        np.column_stack([group.velocity_limits, group.acceleration_limits, jerks]),
    )
    deviation = request.assume if isinstance(request.assume, Deviation) else None
    world = World.build(group, scene, allowed)
    if world.held_contacts:
        one, other = world.held_contacts[0].pair
        raise InvalidConfiguration(
            f"`attached_objects`: {other!r} touches {one!r} wherever the joints are, so that no motion is free:"
            " `touch_links` names the links that it may touch",
            pair=[one, other],
            path="$.attached_objects",
        )
    touching = _touching(world, group.expand(q_start))
    return StreamSetup(
        request=request,
        group=group,
        world=world,
        bounds=bounds,
        cartesian_limits=cartesian_limits_of(request, group),
        start=cast(LocalPoint, group.to_local(q_start) + turns),
        assumption=Assumption(deviation, request.min_clearance, request.clock_error),
        warnings=(*robot.warnings, *scene.warnings, *coarse, *warnings, *touching),
        touching=touching,
    )


def _require_one_axis(group: PlanningGroup) -> None:
    """Raise MalformedRequest if a joint of a group's model neither turns about one axis nor slides along one."""
    for joint, name in zip(group.model.joints[1:], list(group.model.names)[1:], strict=True):
        if joint.nv != 1:
            raise MalformedRequest(
                f"a stream isn't served for joint {name!r}, which has {joint.nv} degrees of freedom: only for joints"
                " that turn about one axis or slide along one; leave it out of the `group`",
                unserved="group",
                joint=name,
            )


def _require_known(request: StreamOpen, robot: RobotModel, scene: Scene, declared: set[str]) -> None:
    """Raise UnknownObject if an allowed name is neither a link nor an obstacle, of the scene or declared."""
    obstacles = [*scene.names, *sorted(declared)]
    known = {*robot.links, *obstacles}
    for index, pair in enumerate(request.allowed_collisions):
        for name in pair:
            if name not in known:
                raise UnknownObject(
                    f"`allowed_collisions[{index}]` names {name!r}, which is neither a link nor an obstacle;"
                    f" links: {', '.join(robot.links)}; obstacles: {', '.join(obstacles) or 'none'}; what is to be"
                    " seen later is declared in `obstacles`, and counts once it is observed",
                    object=name,
                    links=list(robot.links),
                    obstacles=obstacles,
                    path=f"$.allowed_collisions[{index}]",
                )


def _touching(world: World, q: ModelConfiguration) -> tuple[str, ...]:
    pairs = dict.fromkeys(contact.pair for contact in contacts_at(world, q))
    return tuple(f"at the start {one!r} touches {other!r}" for one, other in pairs)
