"""Who asks: the user that a query's key names, and the name that a client gives itself.

A payload or an attachment can say anything. A key can't, where access control lets nobody but a user use the keys of
this user. So the identity is the key: `guidefield/<i>/as/<user>/…` is the user's, and all other keys are those of one
identity, `PLAIN`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from guidefield.errors import MalformedRequest

PLAIN = "plain"
"""Whoever asks on keys without a user: operators, where there is access control; everybody, where there is none."""
USERS = "as"
"""The chunk before a user's name."""
_USER = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}")


class Asker(NamedTuple):
    """Who asks: an identity, and one of its clients, by the name that this gave itself; empty if it gave none."""

    user: str = PLAIN
    client: str = ""


SOMEBODY = Asker()
"""A client without a name on the keys without a user."""


def checked_user(user: str) -> str:
    """The name itself, if a user can have it.

    Raises:
        MalformedRequest: otherwise.
    """
    if not _USER.fullmatch(user) or user == PLAIN:
        raise MalformedRequest(
            f"user {user[:64]!r} must be 1 to 64 of the characters A-Z a-z 0-9 _ . -, must not begin with a dot, and "
            f"must not be {PLAIN!r}",
            user=user[:64],
        )
    return user


def owned(user: str, key: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    """Whose thing a key below a user's names, and the key of this thing below its owner's.

    Another user's thing has the user before its name: ``scenes/alice:shelf``.

    Raises:
        MalformedRequest: if it names one that can't be a user.
    """
    if len(key) < 2 or ":" not in key[1]:
        return user, key
    owner, _, name = key[1].partition(":")
    return owner if owner == PLAIN else checked_user(owner), (key[0], name, *key[2:])


def base_key(instance: str, user: str) -> str:
    """The key below which a user has an instance's keys."""
    return f"guidefield/{instance}" if user == PLAIN else f"guidefield/{instance}/{USERS}/{user}"


def shared_key(instance: str) -> str:
    """The key below which everybody hears of what others share."""
    return f"guidefield/{instance}/shared"


def divided(chunks: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """The user that the chunks below an instance's key name, and those below the user's.

    Raises:
        MalformedRequest: if they name one that can't be a user.
    """
    if len(chunks) > 1 and chunks[0] == USERS:
        return checked_user(chunks[1]), tuple(chunks[2:])
    return PLAIN, tuple(chunks)
