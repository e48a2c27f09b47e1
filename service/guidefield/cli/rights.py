"""Zenoh's access control for operators, users and onlookers: the keys that each may use.

Zenoh checks each message of each link. A client may send queries and subscriptions, and may get replies and
publications. So only the service replies, publishes or declares its liveliness: a client gets no query of another
one, and its publications reach nobody.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from guidefield.messages.identities import base_key, shared_key

ASK_MESSAGES = ["query", "declare_subscriber", "liveliness_query", "declare_liveliness_subscriber"]
"""Messages that a client sends to query and subscribe."""
ANSWER_MESSAGES = ["reply", "put", "declare_queryable", "liveliness_token"]
"""Messages that it gets."""
PRESENCE_MESSAGES = ["liveliness_token"]
"""Messages that declare a client's liveliness."""
PUT_MESSAGES, PUT_DECLARATIONS = ["put"], ["declare_subscriber"]
"""Messages that a client sends for its own stream, and the service's subscription for them."""
UPDATE_KEY = "streams/*/update"
SUBSCRIBE_MESSAGES, PUBLISHED_MESSAGES = ["declare_subscriber"], ["put"]
"""Messages that a subscriber sends and gets."""
PUBLIC_KEYS = ("guidefield/*/alive", "guidefield/*/starting")
"""Keys that everybody may read: the liveliness of services."""
LIST_KEYS = ("info", "robots", "scenes", "runs")
SHARED_KEYS = ("robots/$*:$*", "scenes/$*:$*", "runs/$*:$*", "runs/$*:$*/recording", "runs/$*:$*/proof")
"""Keys of shared things: with an owner before the name they are read-only, except for operators."""


@dataclass(frozen=True)
class Roles:
    """Names by role.

    Attributes:
        operators: They may do everything, on the keys without a user.
        users: Each has keys of its own.
        onlookers: They read lists, figures, and shared things.
    """

    operators: tuple[str, ...] = ("operator",)
    users: tuple[str, ...] = ("user",)
    onlookers: tuple[str, ...] = ("onlooker",)

    def everybody(self) -> tuple[str, ...]:
        """Return all names."""
        return (*self.operators, *self.users, *self.onlookers)


def access_control(roles: Roles) -> dict[str, Any]:
    """Make the section ``access_control`` of the service's Zenoh configuration, which denies by default."""
    published = [f"{shared_key('*')}/**"]
    rules: list[dict[str, Any]] = [
        *_make_rules("everybody", PUBLIC_KEYS),
        _make_rule("everybody listens", SUBSCRIBE_MESSAGES, "ingress", published),
        _make_rule("everybody hears", PUBLISHED_MESSAGES, "egress", published),
    ]
    policies: list[dict[str, Any]] = [{"rules": _ids(rules), "subjects": list(roles.everybody())}]
    of_roles = [
        *((name, ["guidefield/**"], base_key("*", "plain")) for name in roles.operators),
        *((name, [f"{base_key('*', name)}/**"], base_key("*", name)) for name in roles.users),
        *(
            (name, [f"{base_key('*', name)}/{key}" for key in (*LIST_KEYS, *SHARED_KEYS)], None)
            for name in roles.onlookers
        ),
    ]
    for name, keys, present in of_roles:
        own = _make_rules(f"user {name}", keys, None if present is None else f"{present}/clients/*")
        if present is not None:
            updates = [f"{present}/{UPDATE_KEY}"]
            own.append(_make_rule(f"user {name} sends updates", PUT_MESSAGES, "ingress", updates))
            own.append(_make_rule(f"user {name} may send updates", PUT_DECLARATIONS, "egress", updates))
        rules += own
        policies.append({"rules": _ids(own), "subjects": [name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "usernames": [name]} for name in roles.everybody()],
        "policies": policies,
    }


def _make_rules(who: str, keys: Sequence[str], present: str | None = None) -> list[dict[str, Any]]:
    """Make the rules by which somebody may query some keys and declare liveliness on one."""
    found = [
        _make_rule(f"{who} asks", ASK_MESSAGES, "ingress", keys),
        _make_rule(f"{who} is answered", ANSWER_MESSAGES, "egress", keys),
    ]
    return (
        found if present is None else [*found, _make_rule(f"{who} is there", PRESENCE_MESSAGES, "ingress", [present])]
    )


def _make_rule(name: str, messages: Sequence[str], flow: str, keys: Iterable[str]) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "messages": list(messages),
        "flows": [flow],
        "key_exprs": list(keys),
    }


def _ids(rules: Iterable[dict[str, Any]]) -> list[str]:
    return [rule["id"] for rule in rules]
