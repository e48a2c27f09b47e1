"""Replies about robots."""

from __future__ import annotations

from guidefield.messages.requests import Positions
from guidefield.messages.values import Reply


class JointInfo(Reply):
    """One joint.

    Attributes:
        name: Its name.
        kind: Its type, such as revolute or planar. A continuous joint is revolute, with whole turns that count, if one
            of its mimic joints is elsewhere after a turn: it slides, has limits, or turns half as far.
        lower, upper: Limits of its coordinates [rad or m]; null for none.
        velocity: Limits [rad/s or m/s].
        acceleration: Limits [rad/s^2 or m/s^2].
        velocity_source, acceleration_source: Sources of those limits.
        mimics: Its source joint, if it is a mimic joint; at the end of a chain of mimic joints.
        multiplier, offset: Its value is then multiplier * the source joint's, with whole turns, + offset [rad or m].
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
    """A pair of links that isn't tested for collision, and the reason."""

    links: list[str]
    reason: str


class CoverInfo(Reply):
    """Bounding spheres of a shape, their largest distance beyond it [m], and the number of inscribed spheres."""

    spheres: int
    overhang: float
    inner_balls: int


class PartsInfo(Reply):
    """Convex parts that together contain a mesh, and their one-sided Hausdorff distance to it [m]."""

    count: int
    stand_off: float


class GeometryInfo(Reply):
    """One collision shape of a link, its form in collision checks, and a hull's Hausdorff distance to the mesh [m].

    Cover and parts are null until the first plan that needs them computes them.
    """

    name: str
    link: str
    shape: str
    judged_as: str
    stand_off: float = 0.0
    cover: CoverInfo | None = None
    parts: PartsInfo | None = None


class RobotReply(Reply):
    """All facts about a robot that a client needs to plan for it.

    Attributes:
        rest: Values of joints that a request leaves out.
        rest_state: Name of the SRDF's state in `rest`; null if there is none.
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
    """One line of the list of robots; those of one family are variants. `dof` excludes mimic joints."""

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
    """All robots of the catalog and the store."""

    robots: list[RobotSummary]
    schema: int = 1
