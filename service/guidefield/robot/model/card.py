"""A robot card: the few defaults of a robot that its URDF and SRDF don't settle."""

from __future__ import annotations

from typing import Literal

import msgspec

from guidefield.messages.requests import Positions
from guidefield.messages.values import Positive


class RobotCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Declared in `robots/<name>.json`; everything but `urdf` only where a default must be chosen.

    Attributes:
        urdf: Path inside example-robot-data's robots folder, or beside the card.
        srdf: The same for the SRDF; null where there is none.
        tip: Frame that goals are about.
        rest: Values of the rest configuration by joint, as on the wire.
        group: Joints that are planned for by default; null: all between root and tip.
        root_joint: How the robot stands in the world.
        ball_joints: Joints that the URDF calls floating and that only turn.
        acceleration: Acceleration limits by joint [rad/s^2 or m/s^2].
        velocity: Velocity limits by joint [rad/s or m/s].
    """

    urdf: str
    srdf: str | None = None
    tip: str | None = None
    rest: Positions = {}
    group: list[str] | None = None
    root_joint: Literal["fixed", "planar", "free"] = "fixed"
    ball_joints: list[str] = []
    acceleration: dict[str, Positive] = {}
    velocity: dict[str, Positive] = {}


EMPTY = RobotCard(urdf="")
"""The card of a robot that has none."""

decode = msgspec.json.Decoder(RobotCard).decode
