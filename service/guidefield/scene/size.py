"""Obstacles so large that their numbers are hardly metres."""

from __future__ import annotations

from guidefield.messages import scene as messages

HARDLY_METRES = 100.0
"""An obstacle that is larger was probably meant in millimetres [m]."""


def size_warnings(message: messages.Obstacle, declared_extent: float | None) -> tuple[str, ...]:
    """A warning about an obstacle that is larger than `HARDLY_METRES` along one of its axes, if it is.

    Args:
        message: Its declaration.
        declared_extent: Its largest extent along an axis [m], where it is declared by points.
    """
    if declared_extent is not None:
        extent = declared_extent
    elif isinstance(message, messages.Box):
        extent = max(message.size)
    elif isinstance(message, messages.Sphere):
        extent = 2.0 * message.radius
    elif isinstance(message, messages.Cylinder | messages.Capsule):
        extent = max(message.length, 2.0 * message.radius)
    else:  # a half-space has no size
        return ()
    if extent <= HARDLY_METRES:
        return ()
    return (f"obstacle {message.name!r} is {extent:.4g} m large: are its numbers millimetres? Lengths are in metres",)
