"""Settings of the offer to ROS 2 nodes."""

from __future__ import annotations

import enum
from dataclasses import dataclass

IDENTITY = "ros"  # the user that all nodes are together
LATCHING = ("timestamping/enabled", "true")
"""What Zenoh's configuration needs, so that a message is kept for who comes later."""


class Distribution(enum.StrEnum):
    """A distribution whose nodes find the service by its type hashes."""

    JAZZY = "jazzy"
    KILTED = "kilted"
    LYRICAL = "lyrical"
    ROLLING = "rolling"


@dataclass(frozen=True)
class RosSettings:
    """How the service is offered to ROS 2 nodes."""

    robot: str  # the one robot that is offered; a name that the service knows
    domain: int = 0  # ROS domain
    distribution: Distribution = Distribution.JAZZY  # of the nodes
    # zenoh endpoint of a router, rmw_zenohd's, that nodes are reached through, in a session of its own as its client;
    # None: nodes reach the service's own session
    connect: str | None = None
