"""`get_planning_scene`: what is known of robot and scene, as a moveit_msgs/PlanningScene."""

from __future__ import annotations

from typing import Any

from guidefield.endpoint.ros.cdr import Types
from guidefield.endpoint.ros.collision_objects import message_of
from guidefield.endpoint.ros.robot_messages import robot_state
from guidefield.endpoint.ros.snapshot import Snapshot

GET_RESPONSE = "moveit_msgs/srv/GetPlanningScene_Response"
APPLY_RESPONSE = "moveit_msgs/srv/ApplyPlanningScene_Response"
(SETTINGS, STATE, ATTACHED, OBJECT_NAMES, GEOMETRY, OCTOMAP, TRANSFORMS, MATRIX, PADDING, COLORS) = (
    1 << bit for bit in range(10)
)
"""Components that can be asked for; none means all."""


def scene_response(types: Types, now: Snapshot, components: int) -> Any:
    """The response with the components that are asked for."""
    wanted = components or ~0
    scene = types.new("moveit_msgs/msg/PlanningScene")
    if wanted & SETTINGS:
        scene.name, scene.robot_model_name = now.name, now.robot.name
    if wanted & (STATE | ATTACHED):
        scene.robot_state = robot_state(types, now, held=bool(wanted & ATTACHED))
    if wanted & (OBJECT_NAMES | GEOMETRY):
        scene.world.collision_objects = [
            message_of(types, name, thing, now.robot.root, geometry=bool(wanted & GEOMETRY))
            for name, thing in now.objects.items()
        ]
    if wanted & MATRIX:
        left_out = {frozenset(pair.links) for pair in now.robot.model.pairs_left_out}
        names = {*now.robot.links, *now.objects, *now.held, *(name for pair in now.matrix.pairs for name in pair)}
        scene.allowed_collision_matrix = now.matrix.message(types, names, left_out)
    if wanted & PADDING:
        scene.link_padding = [types.new("moveit_msgs/msg/LinkPadding", link_name=link) for link in now.robot.links]
        scene.link_scale = [
            types.new("moveit_msgs/msg/LinkScale", link_name=link, scale=1.0) for link in now.robot.links
        ]
    if wanted & COLORS:
        scene.object_colors = [
            types.new("moveit_msgs/msg/ObjectColor", id=name, color=color) for name, color in now.colors.items()
        ]
    return types.new(GET_RESPONSE, scene=scene)


def applied(types: Types, *, success: bool) -> Any:
    """The response of `apply_planning_scene`; it has no place for a reason, which is logged instead."""
    return types.new(APPLY_RESPONSE, success=success)
