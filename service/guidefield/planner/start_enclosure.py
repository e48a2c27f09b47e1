"""A motion that begins with a body and an obstacle one wholly inside the other: it touches nothing, and is not free."""

from __future__ import annotations

from guidefield.collision.enclosure import enclosed
from guidefield.collision.world import World
from guidefield.planner.task.conditions import Conditions
from guidefield.prove.verdict import Reason, Verdict
from guidefield.robot.model.spaces import ChartPoint


def enclosed_start(conditions: Conditions, z: ChartPoint, time: float = 0.0) -> Verdict | None:
    """The refusal of a motion for what is wholly inside another at its start; None where nothing is, or it touches.

    A certificate of what comes after the start doesn't see it: a mesh is a surface to Coal.

    Args:
        conditions: The robot among obstacles.
        z: Chart point at the start, shape (nv,).
        time: When the motion begins, among obstacles that move [s].
    """
    world = conditions.world
    if conditions.scene.moves:
        world = World.build(conditions.group, conditions.scene.at(time), conditions.allowed_collisions)
    q = conditions.group.expand_from_chart(z)
    inside = enclosed(world, q)  # of most worlds known at once: it is asked first
    if inside is None or world.in_collision(q):
        return None
    return Verdict(Reason.CONTACT, 1, 0, 0.0, (0, 0.0), inside, z)
