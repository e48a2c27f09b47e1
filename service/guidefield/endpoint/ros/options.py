"""Settings with which a service is offered to ROS 2 nodes; without any import of ROS's types."""

from __future__ import annotations

import enum
from dataclasses import dataclass

IDENTITY = "ros"  # the one user as whom all nodes ask
LATCHING = ("timestamping/enabled", "true")
"""The setting of Zenoh with which a latched message is kept for later subscribers."""


class Distribution(enum.StrEnum):
    """A distribution whose nodes find the service by its type hashes; `STORES` of `cdr.py` has the types of each."""

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
