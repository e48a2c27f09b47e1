"""The quotas of users, a file that an operator writes."""

from __future__ import annotations

import math
from typing import Annotated

import msgspec

from guidefield.errors import MalformedRequest
from guidefield.messages.identities import PLAIN, check_user
from guidefield.messages.values import Message, Positive


class Quota(Message):
    """The quota of one user; null: no more than all users together.

    Attributes:
        waiting: The largest number of waiting requests.
        per_second: Queries per second, and the largest burst. A list counts as ten.
        payload_per_second: Payload per second in the long run; a burst may have 256 MiB [bytes].
        processor_per_minute: Processor time per minute, in the long run [s].
        bytes: Space for stored runs, the same for stored streams, and for robots and scenes together [bytes].
        streams: The largest number of open streams.
    """

    waiting: Annotated[int, msgspec.Meta(ge=1)] | None = None
    per_second: Positive | None = 1_000.0
    payload_per_second: Positive | None = None
    processor_per_minute: Positive | None = None
    bytes: Annotated[int, msgspec.Meta(ge=1)] | None = None
    streams: Annotated[int, msgspec.Meta(ge=1)] | None = None

    def __post_init__(self) -> None:
        for name in ("per_second", "payload_per_second", "processor_per_minute"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                raise ValueError(f"`{name}` must be a finite number, got {value}")


OF_ALL = Quota(per_second=5_000.0)
"""Quota of the keys without a user, perhaps everybody: more queries than a service on two processors answers."""
OF_USERS = Quota(payload_per_second=16 * 2**20, bytes=4 * 2**30)


class Quotas(Message):
    """The quotas of all users.

    Attributes:
        plain: Of keys without a user.
        default: Of users without a quota of their own.
        users: Quotas by user.
    """

    plain: Quota = OF_ALL
    default: Quota = OF_USERS
    users: dict[str, Quota] = {}
    schema: int = 1

    def __post_init__(self) -> None:
        for user in self.users:
            try:
                check_user(user)
            except MalformedRequest as error:
                raise ValueError(error.message) from None

    def of(self, user: str) -> Quota:
        """Return the quota of a user."""
        return self.plain if user == PLAIN else self.users.get(user, self.default)


DEFAULT_QUOTAS = Quotas()
