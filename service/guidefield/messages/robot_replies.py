"""Replies about robots."""

from __future__ import annotations

from guidefield.messages.requests import Positions
from guidefield.messages.values import Reply


class JointInfo(Reply):
    """One joint.

    Attributes:
        name: Its name.
        kind: What it can do, such as revolute or planar. A continuous joint with a follower that is elsewhere after a
            whole turn of it (one that slides, has limits, or turns half as far) is revolute: its turns count.
        lower, upper: Limits of its coordinates [rad or m]; null where there is none.
        velocity: Limits [rad/s or m/s].
        acceleration: Limits [rad/s^2 or m/s^2].
        velocity_source, acceleration_source: Where those come from.
        mimics: The joint that it follows, if it does; where that is a follower too, the one at the end of the chain.
        multiplier, offset: Then its value is multiplier * that joint's, whose turns count, + offset [rad or m].
    """

    name: str
    kind: str
    lower: list[float | None]
    upper: list[float | None]
    velocity: list[float]
    acceleration: list[float]
    velocity_source: str
    acceleration_source: str
    mimics: str | None = None
    multiplier: float = 1.0
    offset: float = 0.0


class PairLeftOut(Reply):
    """A pair of links that is not tested for collision, and why."""

    links: list[str]
    reason: str


class CoverInfo(Reply):
    """Spheres that contain a shape, by how much they leave it at most [m], and how many balls are inside of it."""

    spheres: int
    overhang: float
    inner_balls: int


class PartsInfo(Reply):
    """Convex parts that together contain a mesh, and how far they stand off it at most [m]."""

    count: int
    stand_off: float


class GeometryInfo(Reply):
    """One collision shape of a link, and as what it is judged; how far a hull stands off the mesh at most [m].

    Cover and parts are told once they are known: the first plan that needs them finds them.
    """

    name: str
    link: str
    shape: str
    judged_as: str
    stand_off: float = 0.0
    cover: CoverInfo | None = None
    parts: PartsInfo | None = None


class RobotReply(Reply):
    """Everything a client needs to know to plan for a robot.

    Attributes:
        rest: Values of joints that a request leaves out.
        rest_state: Name of the SRDF's state that `rest` is made of; null where it is made of none.
    """

    name: str
    joints: list[JointInfo]
    frames: list[str]
    links: list[str]
    groups: dict[str, list[str]]
    tip: str
    rest: Positions
    geometry: list[GeometryInfo]
    collision_pairs: list[list[str]]
    pairs_left_out: list[PairLeftOut]
    warnings: list[str]
    rest_state: str | None = None
    schema: int = 1


class RobotSummary(Reply):
    """One line of the list of robots; those of one family are variants. `dof` is without joints that mimic others."""

    name: str
    source: str
    family: str
    dof: int | None = None
    joint_kinds: dict[str, int] = {}
    mimics: int = 0
    groups: list[str] = []
    tip: str | None = None
    problem: str | None = None


class RobotsReply(Reply):
    """The robots that can be named."""

    robots: list[RobotSummary]
    schema: int = 1
