"""The identity of a caller, and its quota: the user in a query's key, and the name that a client gives itself.

A payload or an attachment can claim anything. A key can't, if access control lets only a user use the keys of this
user. So the identity is the key: `guidefield/<i>/as/<user>/…` belongs to the user, and all other keys belong to one
identity, `PLAIN`.

Keys, and fields of quotas, are the wire and files of operators; docs/service.md repeats the default quotas. Docstrings
of messages are in the schemas: after a change, `tools/wire_page`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import msgspec

from guidefield.errors import MalformedRequest
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
"""Quota of a user whom the service's file of quotas doesn't name."""


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

PLAIN = "plain"
"""The identity of keys without a user: operators if there is access control, else everybody."""
USERS = "as"
"""The chunk before a user's name."""
_USER = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}")


class Asker(NamedTuple):
    """A caller: an identity, and one of its clients by the name that this gave itself; empty if it gave none."""

    user: str = PLAIN
    client: str = ""


ANONYMOUS = Asker()
"""A client without a name on the keys without a user."""


def check_user(user: str) -> str:
    """Return a valid user name; raises MalformedRequest if no user can have it."""
    if not _USER.fullmatch(user) or user == PLAIN:
        raise MalformedRequest(
            f"user {user[:64]!r} must be 1 to 64 of the characters A-Z a-z 0-9 _ . -, must not begin with a dot, and "
            f"must not be {PLAIN!r}",
            user=user[:64],
        )
    return user


def split_owner(user: str, key: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    """Split the owner off a key below a user's: ``scenes/alice:shelf`` is alice's; without one it is the user's."""
    if len(key) < 2 or ":" not in key[1]:
        return user, key
    owner, _, name = key[1].partition(":")
    return owner if owner == PLAIN else check_user(owner), (key[0], name, *key[2:])


def base_key(instance: str, user: str) -> str:
    """Return the prefix of a user's keys of an instance."""
    return f"guidefield/{instance}" if user == PLAIN else f"guidefield/{instance}/{USERS}/{user}"


def shared_key(instance: str) -> str:
    """Return the prefix of the keys on which changes of shared things are published."""
    return f"guidefield/{instance}/shared"


def split_user(chunks: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """Split the chunks of a key below an instance's into the user and the chunks below the user's."""
    if len(chunks) > 1 and chunks[0] == USERS:
        return check_user(chunks[1]), tuple(chunks[2:])
    return PLAIN, tuple(chunks)
