"""The quotas of users: a file that an operator writes."""

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
        waiting: How many requests may wait.
        per_second: How many queries a second are answered; as many may come at once. A list counts as ten.
        payload_per_second: How much comes with them a second in the long run; 256 MiB may come at once [bytes].
        processor_per_minute: Seconds of a processor in a minute, in the long run [s].
        bytes: What kept runs may take, what kept streams may, and what stored robots and scenes may together [bytes].
        streams: How many streams may be open.
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
"""Of whoever asks on keys without a user, which may be everybody: more than a service on two processors answers."""
OF_USERS = Quota(payload_per_second=16 * 2**20, bytes=4 * 2**30)


class Quotas(Message):
    """The quotas of all users.

    Attributes:
        plain: Of whoever asks on keys without a user.
        default: Of users that aren't named.
        users: Of those that are.
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
