"""The interfaces of each distribution of ROS 2 that is spoken."""

from __future__ import annotations

import functools

from guidefield.endpoint.ros.cdr import Types
from guidefield.endpoint.ros.interfaces import MESSAGES, SERVICES
from guidefield.endpoint.ros.options import Distribution


@functools.cache
def types_of(distribution: Distribution) -> Types:
    """The types of a distribution; each has a table, and at present all tables are the same."""
    return Types(*_TABLES[distribution])


_TABLES = {
    Distribution.JAZZY: (MESSAGES, SERVICES),
    Distribution.KILTED: (MESSAGES, SERVICES),
    Distribution.ROLLING: (MESSAGES, SERVICES),
}
