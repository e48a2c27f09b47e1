"""A robot card: the few defaults of a robot that its URDF and SRDF don't settle.

Its fields are those of the files `robots/<name>.card.json`. It is read without loading Pinocchio.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from guidefield.messages.requests import Positions
from guidefield.messages.values import Positive


class RobotCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Declared in `robots/<name>.card.json`; everything but `urdf` only where a default must be chosen."""

    urdf: str  # path inside example-robot-data's robots folder, or beside the card
    srdf: str | None = None  # the same for the SRDF; null where there is none
    tip: str | None = None  # frame that goals are about
    rest: Positions = {}  # values of the rest configuration by joint, as on the wire
    group: list[str] | None = None  # joints that are planned for by default; null: all between root and tip
    root_joint: Literal["fixed", "planar", "free"] = "fixed"  # how the robot stands in the world
    ball_joints: list[str] = []  # joints that the URDF calls floating and that only turn
    acceleration: dict[str, Positive] = {}  # acceleration limits by joint [rad/s^2 or m/s^2]
    velocity: dict[str, Positive] = {}  # velocity limits by joint [rad/s or m/s]


EMPTY = RobotCard(urdf="")  # the card of a robot that has none

decode = msgspec.json.Decoder(RobotCard).decode
