"""Frames by name: links and joints may share one, and then the link is meant."""

from __future__ import annotations

from typing import Any

import pinocchio as pin


def joint_indices(model: Any) -> dict[str, int]:
    """Pinocchio's index of each joint by name.

    The world, which Pinocchio calls `universe`, is no joint: a joint of that name isn't taken for it.
    """
    return {name: index for index, name in enumerate(model.names) if index}


def frame_index(model: Any, name: str) -> int | None:
    """Pinocchio's index of a link's frame, else of any other frame of that name; None if there is none."""
    if model.existFrame(name, pin.FrameType.BODY):
        return int(model.getFrameId(name, pin.FrameType.BODY))
    for index, frame in enumerate(model.frames):
        if frame.name == name and index:
            return index
    return None


def moving_joint(model: Any, name: str) -> int:
    """Index of the joint that moves a frame; 0 if it stands still or there is none of that name."""
    index = frame_index(model, name)
    return 0 if index is None else int(model.frames[index].parentJoint)
